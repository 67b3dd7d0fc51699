"""From the text of a file to checked rows: what the readers of all formats have in common.

Every reader goes through here, so that whatever a file holds becomes tracks or one `InputError`
that names the file. Which column means what is the readers' own business.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import Tracks, common, make_tracks
from neurosym_jax.errors import InputError, InputWarning

__all__ = [
    "FAR",
    "LATE",
    "assemble",
    "frame_step",
    "load_text",
    "number_ids",
    "number_table",
    "refuse_repeats",
]

FAR = 1e9
"""Metres; farther than any map's coordinates."""

LATE = 1e11
"""Seconds; later than any clock, a float of that size still resolves 20 microseconds."""


def load_text(path: Path) -> str:
    """The whole text of a UTF-8 file, without its byte-order mark.

    Raises:
        InputError: if it cannot be read, or is not text.
    """
    try:
        return Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None


def number_table(path: Path, text: str, names: Sequence[str]) -> np.ndarray:
    """[R, len(names)] float64 of rows of finite numbers.

    Tabs, spaces, commas or semicolons stand between the numbers; `#` begins a comment.

    Args:
        path: for messages.
        text: the file's.
        names: of the columns.

    Raises:
        InputError: naming file, row and reason.
    """
    text = text.replace(",", " ").replace(";", " ")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # numpy's own for an empty file
            rows = np.loadtxt(text.splitlines(), ndmin=2, comments="#")
    except ValueError:
        raise InputError(_malformed(path, text, names)) from None
    if rows.size == 0:
        raise InputError(f"{path}: the file has no rows")
    if rows.shape[1] != len(names):
        wanted = " ".join(names)
        raise InputError(f"{path}: row 1 has {rows.shape[1]} columns, not `{wanted}`")
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise InputError(f"{path}: row {bad[0] + 1} is not finite: {rows[bad[0]].tolist()}")
    return rows


def _malformed(path: Path, text: str, names: Sequence[str]) -> str:
    wanted = " ".join(names)
    number = 0
    for line in text.splitlines():
        fields = line.split("#")[0].split()
        if not fields:
            continue
        number += 1
        if len(fields) != len(names):
            shown = line if len(line) < 60 else f"{line[:60]}..."
            return f"{path}: row {number} has {len(fields)} columns, not `{wanted}`: {shown!r}"
        for field in fields:
            try:
                float(field)
            except ValueError:
                return f"{path}: row {number}: {field[:60]!r} is not a number"
    return f"{path}: not a table of `{wanted}`"


def refuse_repeats(path: Path, times: np.ndarray, ids: np.ndarray, names: Sequence[str]) -> None:
    """InputError for the first of R rows whose time and id, called `names`, were there before."""
    order = np.lexsort((times, ids))
    again = np.flatnonzero((np.diff(times[order]) == 0) & (np.diff(ids[order]) == 0))
    if len(again):
        row = int(max(order[again[0]], order[again[0] + 1]))
        what = ", ".join(f"{name} {one[row]:.12g}" for name, one in zip(names, (times, ids)))
        raise InputError(f"{path}: row {row + 1} repeats ({what})")


def frame_step(path: Path, frame: np.ndarray, stride: float | None) -> float:
    """How many frame numbers make one period: `stride`, or the most common step between frames.

    Args:
        path: for messages.
        frame: [R] whole numbers.
        stride: frame numbers; None if the frames are to tell.

    Raises:
        InputError: for a stride that is not a usable number.
    """
    if stride is None:
        steps = np.diff(np.unique(frame))
        return common(steps) if len(steps) else 1.0
    if not 1e-3 <= stride <= 1e9:
        raise InputError(f"{path}: the stride must be 0.001 to 1e9 frames, not {stride}")
    return stride


def number_ids(values: Sequence[object]) -> np.ndarray:
    """[R] int64 of ids of any kind: themselves if all are whole, else numbered in order of name."""
    try:
        numbers = np.array([float(str(value)) for value in values])
        if np.all(np.abs(numbers) < 2.0**53) and np.all(numbers == np.rint(numbers)):
            return numbers.astype(np.int64)
    except ValueError:
        pass
    return np.unique([str(value) for value in values], return_inverse=True)[1].astype(np.int64)


def assemble(
    path: Path,
    stamp: ArrayLike,
    id: ArrayLike,
    position: ArrayLike,
    recording: str | None = None,
) -> Tracks:
    """Tracks of R rows in the file's order, refused or warned of in the file's words.

    Args:
        path: of the file.
        stamp: [R] seconds.
        id: [R] int64.
        position: [R, 2] metres.
        recording: name; the file's without its ending if None.

    Raises:
        InputError: naming file, row (from 1) and reason: no rows, numbers that are not finite or
            larger than any clock's or map's, an agent twice at one time.

    Warns:
        InputWarning: where an agent's time runs backward in the file; the rows are sorted.
    """
    times, ids = np.asarray(stamp, np.float64), np.asarray(id, np.int64)
    points = np.asarray(position, np.float64).reshape(-1, 2)
    if len(times) == 0:
        raise InputError(f"{path}: the file has no rows")
    for name, values, limit in (("time", times[:, None], LATE), ("position", points, FAR)):
        bad = np.flatnonzero(~(np.abs(values) <= limit).all(axis=1))
        if len(bad):
            shown = ", ".join(f"{value:g}" for value in values[bad[0]])
            raise InputError(f"{path}: row {bad[0] + 1}: {name} {shown} is not a usable number")
    refuse_repeats(path, times, ids, ("time", "id"))
    order = np.argsort(ids, kind="stable")
    back = np.flatnonzero((np.diff(times[order]) < 0) & (np.diff(ids[order]) == 0))
    if len(back):
        row = order[back[0] + 1]
        warnings.warn(
            f"{path}: row {row + 1}: time runs backward for agent {ids[row]} "
            f"({len(back)} times in all); the rows are put in order",
            InputWarning,
            stacklevel=2,
        )
    return make_tracks(recording or Path(path).stem, times, ids, points)
