"""Compare our numbers with torch's, layer by layer."""

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.commands._options import refuse_unused
from neurosym_jax.configuration import Seed, refuse
from neurosym_jax.errors import InputError
from neurosym_jax.interop.checkpoint import load_torch_checkpoint
from neurosym_jax.interop.parity import TOLERANCE, run_parity, run_torch
from neurosym_jax.runtime.files import new_folder

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Compare our networks with a torch module that runs now, or with stored torch cases."""

    directory: Annotated[Path | None, tyro.conf.Positional] = None
    """Stored cases: a folder with manifest.json and one .npz for each of its rows."""
    torch_module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:CLASS")] = None
    """Generator of your torch code, which is run; it has SGAN's interface."""
    checkpoint: Path | None = None
    """Checkpoint to load into the torch module and here."""
    python: str | None = None
    """Interpreter that has torch and runs the module; default: this one."""
    seed: int = 0
    """Random seed of the scenes and noise that the module is given."""
    keep: Path | None = None
    """Also store what the module made as a case in this new folder."""
    tolerance: float = TOLERANCE
    """Largest absolute difference that passes."""


def run(options: Options) -> int:
    """Print the table and return the exit status: 0 where every output is within, else 1.

    Raises:
        InputError: as `run_parity` and `run_torch`, or for options that do not go together.
    """
    module, checkpoint = options.torch_module, options.checkpoint
    refuse(Seed, {"--seed": options.seed})
    if options.directory is not None:
        names = ("torch_module", "checkpoint", "python", "seed", "keep")
        refuse_unused(options, names, "on stored cases")
        parity = run_parity(options.directory, options.tolerance)
    elif module and checkpoint:
        model = load_torch_checkpoint(checkpoint, ignored=None)
        python = options.python or sys.executable
        keep = options.keep
        with tempfile.TemporaryDirectory() if keep is None else new_folder(keep) as folder:
            run_torch(module, checkpoint, Path(folder), python=python, seed=options.seed)
            parity = run_parity(Path(folder), options.tolerance)
        parity = dataclasses.replace(parity, assumed=model.assumed)
    else:
        raise InputError("give either a folder of stored cases, or --torch-module and --checkpoint")
    print(parity)
    return 0 if parity.ok else 1
