"""What a sweep leaves beside its rows: every model's errors, scene by scene."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.paired import ErrorsByScene
from neurosym_jax.runtime.files import new_file

__all__ = ["read_sweep", "write_errors"]

FILE = "scenes.npz"
ARRAYS = ("metrics", "totals", "counts", "identity")
"""Of each row: the fields of `ErrorsByScene`, but for the steps, which the row says."""


def write_errors(
    folder: Path, rows: Sequence[dict[str, Any]], errors: Sequence[ErrorsByScene]
) -> None:
    """Write `scenes.npz` into the sweep's folder, in the order of the rows."""
    arrays: dict[str, Any] = {
        f"{name}_{index}": np.asarray(getattr(of_row, name))
        for index, (row, of_row) in enumerate(zip(rows, errors))
        if row["run"]
        for name in ARRAYS
    }
    with new_file(folder / FILE) as beside:
        np.savez_compressed(beside, **arrays)


def read_sweep(folder: Path) -> tuple[list[dict[str, Any]], dict[int, ErrorsByScene]]:
    """The rows of a sweep, and by their index the errors of those that were trained.

    Raises:
        InputError: where `folder` holds no sweep, or one without errors scene by scene.
    """
    try:
        rows = json.loads((folder / "sweep.json").read_text())["rows"]
        with np.load(folder / FILE) as arrays:
            return rows, {
                index: _errors(arrays, index, row["obs_len"] + row["pred_len"])
                for index, row in enumerate(rows)
                if row["run"]
            }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder}: holds no whole sweep ({error}); run the sweep again") from None


def _errors(arrays: Mapping[str, np.ndarray], index: int, steps: int) -> ErrorsByScene:
    names, totals, counts, identity = (arrays[f"{name}_{index}"] for name in ARRAYS)
    return ErrorsByScene(tuple(names.tolist()), totals, counts, identity, steps)
