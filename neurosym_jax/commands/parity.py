"""Compare our numbers with torch's, layer by layer."""

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.commands._options import refuse_given
from neurosym_jax.configuration import Seed, refuse
from neurosym_jax.errors import InputError, option
from neurosym_jax.interop.checkpoint import model_from_torch
from neurosym_jax.interop.parity import TOLERANCE, run_parity, run_torch
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.runtime.files import new_folder, refuse_unwritable, write_json
from neurosym_jax.runtime.foreign import reading

__all__ = ["run"]


def run(
    directory: Annotated[Path | None, tyro.conf.Positional] = None,
    torch_module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:CLASS")] = None,
    checkpoint: Path | None = None,
    python: str | None = None,
    seed: int = 0,
    keep: Path | None = None,
    tolerance: float = TOLERANCE,
    out: Path | None = None,
) -> int:
    """Compare our networks with a torch module that runs now, or with stored torch cases.

    Args:
        directory: Stored cases: a folder with manifest.json and one .npz for each of
            its rows.
        torch_module: Generator of your torch code, which is run; it has SGAN's
            interface.
        checkpoint: Checkpoint to load into the torch module and here.
        python: Interpreter that has torch and runs the module; default: this one.
        seed: Random seed of the scenes and noise that the module is given.
        keep: Also store what the module made as a case in this new folder.
        tolerance: Largest absolute difference that passes.
        out: Also write the rows and the verdict to this file, FILE.json.

    Returns:
        The exit status: 0 where every output is within the tolerance, else 1.

    Raises:
        InputError: as `run_parity` and `run_torch`, or for options that do not go
            together.
    """
    refuse(Seed, {"--seed": seed})
    _refuse_out(out)
    if directory is not None:
        refuse_given(
            "on stored cases",
            torch_module=torch_module,
            checkpoint=checkpoint,
            python=python,
            seed=seed,
            keep=keep,
        )
        parity = run_parity(directory, tolerance)
    elif torch_module and checkpoint:
        python = python or sys.executable
        with tempfile.TemporaryDirectory() if keep is None else new_folder(keep) as new:
            folder = Path(new)
            assumed = _run_module(torch_module, checkpoint, folder, python, seed)
            parity = run_parity(folder, tolerance)
        parity = dataclasses.replace(parity, assumed=assumed)
    else:
        raise InputError(
            "give either a folder of stored cases, or --torch-module and --checkpoint"
        )
    print(parity)
    if out is not None:
        write_json(out, parity.to_json())
    return 0 if parity.ok else 1


def _refuse_out(path: Path | None) -> None:
    if path is None:
        return
    if path.suffix != ".json":
        raise InputError(f"{option('out', str(path))}: must end in .json")
    refuse_unwritable(path)


def _run_module(
    module: str, checkpoint: Path, folder: Path, python: str, seed: int
) -> tuple[str, ...]:
    """Store what a torch module makes in a new folder; what was assumed of its checkpoint."""
    contents = read_torch_file(checkpoint)
    with reading(checkpoint):
        model = model_from_torch(contents, ignored=None)
    run_torch(module, contents, folder, title=checkpoint.stem, python=python, seed=seed)
    return model.assumed
