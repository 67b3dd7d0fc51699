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
    if out is not None:
        if out.suffix != ".json":
            raise InputError(f"{option('out', str(out))}: must end in .json")
        refuse_unwritable(out)
    if directory is not None:
        module = {
            "torch_module": torch_module,
            "checkpoint": checkpoint,
            "python": python,
        }
        refuse_given("on stored cases", **module, seed=seed, keep=keep)
        parity = run_parity(directory, tolerance)
    elif torch_module and checkpoint:
        contents = read_torch_file(checkpoint)
        with reading(checkpoint):
            model = model_from_torch(contents, ignored=None)
        with (
            tempfile.TemporaryDirectory()
            if keep is None
            else new_folder(keep) as folder
        ):
            python = python or sys.executable
            run_torch(
                torch_module,
                contents,
                Path(folder),
                title=checkpoint.stem,
                python=python,
                seed=seed,
            )
            parity = run_parity(Path(folder), tolerance)
        parity = dataclasses.replace(parity, assumed=model.assumed)
    else:
        raise InputError(
            "give either a folder of stored cases, or --torch-module and --checkpoint"
        )
    print(parity)
    if out is not None:
        write_json(out, parity.to_json())
    return 0 if parity.ok else 1
