"""From rows of numbers to tracks: the last step of every reader.

Whatever a file holds becomes tracks here, or one `InputError` that names file, row and reason.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.reading import Reading
from neurosym_jax.data.text import recording_name
from neurosym_jax.data.tracks import LATE, MAX_METRES, Tracks, common, make_tracks
from neurosym_jax.errors import InputError, printable

__all__ = ["assemble", "consecutive", "frame_step", "refuse_rows"]

STEPS = (1, 6, 10, 12)
"""Frame numbers that are taken for 0.4 s: of a list of steps, and at 15, 25 and 30 a second."""


def refuse_rows(
    path: Path, wrong: ArrayLike, reason: Callable[[int], str], row: np.ndarray | None = None
) -> None:
    """Refuse a file with a wrong row.

    Args:
        path: of the file.
        wrong: [R] bool.
        reason: of the index of a row.
        row: [R] numbers of the rows in messages; default: 1, 2, ...

    Raises:
        InputError: naming the first wrong row and the reason.
    """
    if np.any(wrong):
        at = int(np.argmax(wrong))
        raise InputError(f"{path}: row {at + 1 if row is None else row[at]}: {reason(at)}")


def frame_step(path: Path, frame: np.ndarray, stride: float | None) -> float:
    """How many of the whole numbers `frame [R]` make one period: `stride`, or their common step.

    Raises:
        InputError: for a stride that is not a usable number, and where none is given and the most
            common step is none of `STEPS`.
    """
    if stride is None:
        steps = np.diff(np.unique(frame))
        step = common(steps) if len(steps) else 1.0
        if step not in STEPS:
            raise InputError(
                f"{path}: its frames are {step:g} apart, at 25 a second {step / 25:.2f} s: say how "
                f"many make a second (--fps 25), or --stride {step:g} if they are 0.4 s apart"
            )
        return step
    if not 1e-3 <= stride <= 1e9:
        raise InputError(f"{path}: the stride must be 0.001 to 1e9 frames, not {stride}")
    return stride


def consecutive(time: np.ndarray, id: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the rows [R] that have a next row of the same id, and of these next rows."""
    order = np.lexsort((time, id))
    same = np.diff(id[order]) == 0
    return order[:-1][same], order[1:][same]


def assemble(
    path: Path,
    stamp: ArrayLike,
    id: ArrayLike,
    position: ArrayLike,
    extras: Mapping[str, np.ndarray] = MappingProxyType({}),
    *,
    recording: str | None = None,
    row: np.ndarray | None = None,
    warnings: tuple[str, ...] = (),
    **reading: Any,
) -> Tracks:
    """Tracks of the rows of a file, in any order.

    Args:
        path: of the file.
        stamp: [R] seconds.
        id: [R] int64.
        position: [R, 2] metres.
        extras: name: [R] further numbers.
        recording: name; default: the file's without its ending.
        row: [R] numbers of the rows in messages; default: 1, 2, ...
        warnings: what looks wrong, a line each.
        **reading: further fields of `Reading`.

    Raises:
        InputError: naming file, row and reason: no rows, a time or coordinate that is not finite
            or beyond any clock or map, an agent twice at one time.
    """
    times, ids = np.asarray(stamp, np.float64), np.asarray(id, np.int64)
    points = np.asarray(position, np.float64).reshape(-1, 2)
    if len(times) == 0:
        raise InputError(f"{path}: the file has no rows")
    before, after = consecutive(times, ids)
    again = np.zeros(len(times), bool)
    again[np.maximum(before, after)[times[before] == times[after]]] = True
    for wrong, reason in (
        (~(np.abs(times) <= LATE), lambda at: f"time {times[at]:g} is not a usable number"),
        (
            ~(np.abs(points) <= MAX_METRES).all(axis=1),
            lambda at: f"position {points[at, 0]:g}, {points[at, 1]:g} is not a usable number",
        ),
        (again, lambda at: f"repeats (time {times[at]:.12g}, id {ids[at]})"),
    ):
        refuse_rows(path, wrong, reason, row)
    order = np.argsort(ids, kind="stable")
    back = np.flatnonzero((np.diff(times[order]) < 0) & (np.diff(ids[order]) == 0))
    if len(back):
        first = order[back[0] + 1]
        warnings += (
            f"row {first + 1 if row is None else row[first]}: time runs backward for agent "
            f"{ids[first]} ({len(back)} times in all); the rows are sorted",
        )
    name = recording or recording_name(path)
    tracks = make_tracks(name, times, ids, points, extras)
    how = Reading(name, printable(str(path)), rows=len(times), warnings=warnings, **reading)
    return dataclasses.replace(tracks, reading=how)
