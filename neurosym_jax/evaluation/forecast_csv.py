"""Forecasts as CSV: a row for each step of each sample of each person.

Columns are recording, frame (the last observed one), id, sample (from 0), step (from 1),
seconds (from the last observed position), x and y in metres, and the probability of the
sample where samples have one. Of a file to be read, recording, sample, seconds and
probability may be absent.
"""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.tables import csv_text

__all__ = ["csv_of_forecasts", "read_csv_forecasts"]

NEEDED = ("frame", "id", "step", "x", "y")
PERSON = ("recording", "frame", "id")
"""Columns that tell forecasts of a file apart."""
FORMULA = r"^'([=+@]|-\p{L})"
"""A text that `csv_text` keeps spreadsheets from calculating."""


def csv_of_forecasts(
    samples: np.ndarray,
    ids: np.ndarray,
    frames: np.ndarray,
    recordings: np.ndarray,
    period: float,
    probabilities: np.ndarray | None = None,
) -> str:
    """The text of a file.

    Args:
        samples: [k, A, T, 2] metres.
        ids: [A].
        frames: [A], of the last observed position.
        recordings: [A] names.
        period: seconds between steps.
        probabilities: [k, A], if the samples have them.
    """
    count, people, steps, _ = samples.shape
    person, sample, step = np.indices((people, count, steps)).reshape(3, -1)
    x, y = samples[sample, person, step].T
    columns = {
        "recording": recordings[person],
        "frame": frames[person],
        "id": ids[person],
        "sample": sample,
        "step": step + 1,
        "seconds": np.round(period * (step + 1), 6),
        "x": x,
        "y": y,
    }
    if (frames == np.rint(frames)).all():
        columns["frame"] = columns["frame"].astype(np.int64)
    if probabilities is not None:
        columns["probability"] = probabilities[sample, person].round(6)
    return csv_text(pl.DataFrame(columns))


def read_csv_forecasts(path: Path) -> dict[str, np.ndarray]:
    """The arrays `samples`, `ids`, `frames` and, where the file has them, `recordings` and
    `probabilities`, as an `.npz` has them.

    Raises:
        InputError: for columns that are missing, a file without rows, steps that are not
            1, 2, ..., people who have not each step of each sample once, and
            probabilities that change within a sample.
    """
    table, steps = _table(path)
    if "sample" not in table.columns:
        table = table.with_columns(sample=pl.lit(0))
    table = table.with_columns(pl.col(pl.String).str.replace(FORMULA, "$1"))
    key = [name for name in PERSON if name in table.columns]
    people = table.select(key).unique(maintain_order=True)
    count = table["sample"].n_unique()

    once = table.select(*key, "sample", "step").n_unique() == len(table)
    if not once or len(table) != count * len(people) * steps:
        raise InputError(
            f"{path}: {len(table)} rows, not each of {steps} steps of {count} samples of "
            f"{len(people)} people once"
        )
    number = people.with_row_index("person")
    order = ("person", "sample", "step")
    table = table.join(number, on=key, nulls_equal=True).sort(order)
    shape = (len(people), count, steps)
    values = {}
    for name in ("x", "y", *({"probability"} & set(table.columns))):
        values[name] = table[name].cast(pl.Float64).to_numpy().reshape(shape)
    points = np.stack([values["x"], values["y"]], axis=-1)
    arrays: dict[str, Any] = {
        "samples": points.swapaxes(0, 1),
        "ids": _texts_or_numbers(people["id"]),
        "frames": people["frame"].cast(pl.Float64).to_numpy(),
    }
    if "recording" in key:
        arrays["recordings"] = (
            people["recording"].cast(pl.String).to_numpy().astype("U")
        )
    if "probability" in values:
        likely = values["probability"]
        if (np.ptp(likely, axis=-1) > 1e-6).any():
            raise InputError(
                f"{path}: the probability of a sample differs between steps"
            )
        arrays["probabilities"] = likely[..., 0].T
    return arrays


def _table(path: Path) -> tuple[pl.DataFrame, int]:
    """The rows of a file, and the number of its steps."""
    table = pl.read_csv(path, infer_schema_length=None)
    missing = [name for name in NEEDED if name not in table.columns]
    if missing:
        raise InputError(
            f"{path}: column {missing[0]!r} is missing (its columns: "
            f"{', '.join(table.columns[:12])})"
        )
    if not len(table):
        raise InputError(f"{path}: has no rows")
    numbers = table["step"].unique().sort().to_list()
    if numbers != list(range(1, len(numbers) + 1)):
        listed = ", ".join(map(str, numbers[:12]))
        raise InputError(
            f"{path}: steps must be 1, 2, ..., the first after the last observed one, "
            f"not {listed}"
        )
    return table, len(numbers)


def _texts_or_numbers(ids: pl.Series) -> np.ndarray:
    """[A] ids, as the file has them."""
    if ids.dtype == pl.String:
        return ids.to_numpy().astype("U")
    return ids.to_numpy()
