"""Compare our numbers with torch's, layer by layer."""

import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Any

import tyro

from neurosym_jax.commands._options import refuse_given
from neurosym_jax.configuration import Count, NotNegative, Seed, refuse
from neurosym_jax.errors import InputError, option
from neurosym_jax.interop.checkpoint import model_from_torch
from neurosym_jax.interop.parity import TOLERANCE, Parity, run_parity, run_torch
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.interop.training_parity import (
    TRAINING_TOLERANCE,
    TrainingParity,
    compare_training,
)
from neurosym_jax.models.forecast import Model
from neurosym_jax.runtime.files import new_folder, refuse_unwritable, write_json
from neurosym_jax.runtime.foreign import reading

__all__ = ["run"]


def run(
    directory: Annotated[Path | None, tyro.conf.Positional] = None,
    torch_module: Annotated[str | None, tyro.conf.arg(metavar="FILE.py:CLASS")] = None,
    checkpoint: Path | None = None,
    python: str | None = None,
    seed: int = 0,
    train: int | None = None,
    keep: Path | None = None,
    tolerance: float | None = None,
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
        train: Compare a training of this number of steps of both of SGAN's networks, by
            the parameters after it, in place of forecasts.
        keep: Also store what the module made as a case in this new folder.
        tolerance: Largest absolute difference that passes; default: 1e-5, and 1e-6 of a
            parameter after --train.
        out: Also write the rows and the verdict to this file, FILE.json.

    Returns:
        The exit status: 0 where every output is within the tolerance, else 1.

    Raises:
        InputError: as `run_parity` and `run_torch`, or for options that do not go
            together.
    """
    refuse(Seed, {"--seed": seed})
    _refuse_out(out)
    module = {
        "torch_module": torch_module,
        "checkpoint": checkpoint,
        "python": python,
    }
    if tolerance is None:
        tolerance = TOLERANCE if train is None else TRAINING_TOLERANCE
    if directory is not None:
        refuse_given("on stored cases", **module, seed=seed, train=train, keep=keep)
        parity = run_parity(directory, tolerance)
    elif not (torch_module and checkpoint):
        raise InputError(
            "give either a folder of stored cases, or --torch-module and --checkpoint"
        )
    elif train is not None:
        refuse_given("with --train", keep=keep)
        parity = _trained(torch_module, checkpoint, train, python, seed, tolerance)
    else:
        parity = _forecast(torch_module, checkpoint, python, seed, keep, tolerance)
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


def _forecast(
    torch_module: str,
    checkpoint: Path,
    python: str | None,
    seed: int,
    keep: Path | None,
    tolerance: float,
) -> Parity:
    contents, model = _read(checkpoint)
    folder = tempfile.TemporaryDirectory() if keep is None else new_folder(keep)
    with folder as name:
        run_torch(
            torch_module,
            contents,
            Path(name),
            title=checkpoint.stem,
            python=python or sys.executable,
            seed=seed,
        )
        parity = run_parity(Path(name), tolerance)
    return dataclasses.replace(parity, assumed=model.assumed)


def _trained(
    torch_module: str,
    checkpoint: Path,
    steps: int,
    python: str | None,
    seed: int,
    tolerance: float,
) -> TrainingParity:
    refuse(Count, {"--train": steps})
    refuse(NotNegative, {"tolerance": tolerance})
    contents, model = _read(checkpoint)
    parity = compare_training(
        torch_module,
        contents,
        steps,
        python=python or sys.executable,
        seed=seed,
        tolerance=tolerance,
    )
    return dataclasses.replace(parity, assumed=model.assumed + parity.assumed)


def _read(checkpoint: Path) -> tuple[Any, Model]:
    """What a torch file holds, and its model."""
    contents = read_torch_file(checkpoint)
    with reading(checkpoint):
        return contents, model_from_torch(contents, ignored=None)
