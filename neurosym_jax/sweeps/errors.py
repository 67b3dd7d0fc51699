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
EARLIER = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde")
"""The metrics of files that do not name theirs."""


def write_errors(
    folder: Path, rows: Sequence[dict[str, Any]], errors: Sequence[ErrorsByScene]
) -> None:
    """Write `scenes.npz` into the sweep's folder, in the order of the rows."""
    arrays = {}
    for index, (row, of_row) in enumerate(zip(rows, errors)):
        if row["run"]:
            arrays[f"metrics_{index}"] = np.array(of_row.metrics)
            arrays[f"totals_{index}"] = of_row.totals
            arrays[f"counts_{index}"] = of_row.counts
            arrays[f"identity_{index}"] = of_row.identity
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
    identity = arrays[f"identity_{index}"]
    if f"metrics_{index}" in arrays:
        names = tuple(arrays[f"metrics_{index}"].tolist())
        return ErrorsByScene(
            names, arrays[f"totals_{index}"], arrays[f"counts_{index}"], identity, steps
        )
    totals = arrays[f"errors_{index}"]
    counts = np.repeat(arrays[f"agents_{index}"][:, None], totals.shape[1], axis=1)
    return ErrorsByScene(EARLIER, totals, counts, identity, steps)
