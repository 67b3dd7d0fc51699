"""Compare our numbers with torch's, layer by layer."""

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.configuration import Seed, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.report import check_report
from neurosym_jax.interop.checkpoint import load_torch_checkpoint
from neurosym_jax.interop.parity import run_parity, run_torch
from neurosym_jax.interop.parity_rows import TOLERANCE, Parity
from neurosym_jax.runtime.files import new_folder, write_json

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Compare our networks with a torch module that runs now, or with stored torch cases."""

    directory: Annotated[Path | None, tyro.conf.Positional] = None
    """Stored cases: a folder with manifest.json and one .npz for each of its rows."""
    torch_module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:CLASS")] = None
    """Generator of your torch code, which is run; it has SGAN's interface."""
    checkpoint: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE ...")] = ()
    """Checkpoints to load into the torch module and here."""
    python: str | None = None
    """Interpreter that has torch and runs the module; default: this one."""
    seed: int | None = None
    """Random seed of the scenes and noise that the module is given; default: 0."""
    keep: Path | None = None
    """Also store what the module made as cases in this new folder."""
    ignore_arg: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME ...")] = ()
    """Unknown arguments of a checkpoint that do not change its network."""
    json: Path | None = None
    """Also write the rows here, as JSON."""
    tolerance: float = TOLERANCE
    """Largest absolute difference that passes."""


def run(options: Options) -> int:
    """Print the table and return the exit status: 0 where every output compared is within.

    It is 1 for a miss, and where nothing was compared: that proves nothing.

    Raises:
        InputError: as `run_parity` and `run_torch`, for options that do not go together, or when
            the JSON file cannot be written or is not ours.
    """
    if options.json is not None:
        check_report(options.json)
    parity = _compared(options)
    print(parity)
    if options.json is not None:
        write_json(options.json, parity.to_json())
    return 0 if parity.ok else 1


def _compared(options: Options) -> Parity:
    if (options.directory is None) == (options.torch_module is None):
        raise InputError("give either a folder of stored cases, or --torch-module and --checkpoint")
    if options.directory is not None:
        for name in ("checkpoint", "python", "seed", "keep"):
            if getattr(options, name):
                raise InputError(f"--{name} needs --torch-module")
        return run_parity(options.directory, options.tolerance, ignore=options.ignore_arg)
    if not (options.checkpoint and options.torch_module):
        raise InputError("--torch-module needs --checkpoint, whose weights are compared")
    seed = options.seed or 0
    refuse(Seed, {"--seed": seed})
    loaded = [load_torch_checkpoint(path, options.ignore_arg) for path in options.checkpoint]
    assumed = tuple(dict.fromkeys(words for each in loaded for words in each.assumed))
    more = {"ignore": options.ignore_arg, "assumed": assumed}

    module, python = options.torch_module, options.python or sys.executable

    def compared(folder: Path) -> Parity:
        run_torch(module, options.checkpoint, folder, python=python, seed=seed)
        return run_parity(folder, options.tolerance, **more)

    if options.keep is not None:
        with new_folder(options.keep) as folder:
            return compared(folder)
    with tempfile.TemporaryDirectory() as folder:
        return compared(Path(folder))
