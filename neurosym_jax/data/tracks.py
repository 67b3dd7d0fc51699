"""The track table: who was where and when, between every reader and the windows.

A reader (CSV, ETH/UCY, THOR, bags, simulation) ends in `Tracks`, and windows begin with them. The
table keeps the recording's own clock in seconds and its own world frame in metres; it is not a
scene (see `scene`), it knows no observation length, and nothing in it is a model's input yet.
"""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.provenance import Reading
from neurosym_jax.errors import InputError

__all__ = [
    "LATE",
    "MAX_METRES",
    "PERIOD",
    "SNAP",
    "Tracks",
    "common",
    "make_tracks",
    "on_grid",
    "resample",
]

PERIOD = 0.4
"""Seconds between the steps of the ETH/UCY benchmark, and of every model that ships."""

MAX_METRES = 1e8
"""Metres; farther than any map's coordinates: those of UTM and of web maps stay below."""

LATE = 1e11
"""Seconds; later than any clock, a float of that size still resolves 20 microseconds."""

SNAP = 1e-6
"""Seconds: a source stamp this near a grid point is on it, so that clocks written in decimals,
accumulated, or counted from 1970 meet the grid in spite of rounding. At a run this is 10 um."""

DENSE = 100
"""Points on a grid for each point of a recording; more is no resampling, but a mistyped period."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """One recording's points, R rows sorted by (id, stamp); build with `make_tracks`."""

    recording: str
    """Name of the recording, for messages and for the identity of its scenes."""
    stamp: np.ndarray
    """[R] float64 seconds on the recording's clock."""
    id: np.ndarray
    """[R] int64 agent."""
    position: np.ndarray
    """[R, 2] float64 metres in the recording's frame."""
    imputed: np.ndarray
    """[R] bool; True where the point was interpolated across a gap, not observed."""
    known: np.ndarray | None = None
    """[R] seconds: the stamp of the last observation that a point depends on; None where all are
    observed at their own stamps."""
    foreseen: np.ndarray | None = None
    """[R, 2] metres: where the point lies as far as one could tell before `known`, see `resample`;
    None as there."""
    period: float | None = None
    """Seconds between the points of the grid that all stamps lie on; None where there is none."""
    reading: Reading | None = None
    """How it was read; None where it was made otherwise."""


def make_tracks(
    recording: str,
    stamp: ArrayLike,
    id: ArrayLike,
    position: ArrayLike,
    imputed: ArrayLike | None = None,
) -> Tracks:
    """Checked tracks, from rows in any order.

    Args:
        recording: name of the recording.
        stamp: [R] seconds.
        id: [R] whole numbers.
        position: [R, 2] metres.
        imputed: [R] bool; None says that every point was observed.

    Returns:
        The rows sorted by (id, stamp), in arrays of their own.

    Raises:
        InputError: naming the recording, the first row at fault (counted from 0, in the caller's
            order) and the reason: no rows, shapes that differ, a number that is not finite, an id
            that is not whole, or an agent seen twice at one stamp.
    """
    times = np.asarray(stamp, np.float64)
    points = np.asarray(position, np.float64)
    ids = np.asarray(id)
    flags = np.zeros(times.shape, bool) if imputed is None else np.asarray(imputed, bool)
    rows = times.shape[0] if times.ndim == 1 else -1
    for name, array, shape in (
        ("stamp", times, (rows,)),
        ("id", ids, (rows,)),
        ("position", points, (rows, 2)),
        ("imputed", flags, (rows,)),
    ):
        if array.shape != shape:
            wanted = "[rows]" if rows < 0 else list(shape)
            raise InputError(f"{recording}: {name} must be {wanted}, not {list(array.shape)}")
    if rows == 0:
        raise InputError(f"{recording}: no rows")
    _refuse(recording, ~np.isfinite(times), "the stamp is not finite")
    _refuse(recording, (~np.isfinite(points)).any(axis=1), "the position is not finite")
    ids = _whole(recording, ids)

    order = np.lexsort((times, ids))
    ids, times = ids[order], times[order]
    again = np.flatnonzero((ids[1:] == ids[:-1]) & (times[1:] == times[:-1]))
    if len(again):
        first, second = order[again[0]], order[again[0] + 1]
        raise InputError(
            f"{recording}: row {second}: agent {ids[again[0]]} is seen at {times[again[0]]} s "
            f"in row {first} already"
        )
    return Tracks(recording, times, ids, points[order], flags[order])


def resample(
    tracks: Tracks, period: float, max_gap: float = 1.0, start: float | None = None
) -> Tracks:
    """Every agent's track on the one grid `start + n * period`, n = 0, 1, ..., linearly between.

    A grid point within `SNAP` of a source point takes that point's position and flag bit for bit;
    any other lies between two of the agent's source points at most `max_gap` apart. So nothing is
    extrapolated, and a longer gap splits a track: no points inside it, the same id on both sides.
    Stamps are always the grid's own, equal between agents.

    A point is imputed where it was interpolated inside a gap longer than 1.5 times the median step
    between consecutive points of an agent (one median, over all agents of the recording), or from
    a point that is imputed itself. Plain changes of rate are hence not imputation; a frame that
    the tracker lost is.

    A point between two source points depends on the later one, which need not have been observed
    when somebody stands at the grid point and looks ahead. So every point also has the place where
    the agent's earlier points alone put it: straight on from the last one, at the mean velocity of
    the period before it (of what there is, if that is shorter; where there is nothing, it stays).
    `windows` takes that one for what is observed before `known`.

    Args:
        tracks: R rows.
        period: seconds between grid points.
        max_gap: seconds; the longest gap that is filled.
        start: seconds, the grid's first point; the recording's first stamp if None. What lies
            before it is left out.

    Raises:
        InputError: for a period, gap or start that is not a usable number, or where no point of
            the recording can be put on the grid; for a grid of more than `DENSE` points for each.
    """
    name = tracks.recording
    if not (np.isfinite(period) and period > 2 * SNAP):
        raise InputError(f"{name}: the period must be more than {2 * SNAP} s, not {period}")
    if not max_gap >= 0:
        raise InputError(f"{name}: max_gap must not be negative, not {max_gap}")
    start = float(tracks.stamp.min()) if start is None else float(start)
    if not np.isfinite(start):
        raise InputError(f"{name}: the start of the grid must be finite, not {start}")

    stamp, position = tracks.stamp, tracks.position
    step, same = np.diff(stamp), np.diff(tracks.id) == 0
    joined = np.append(same & (step <= max_gap + 2 * SNAP), False)
    row, grid, exact = _grid_points(tracks, period, start, joined)
    grid_stamp = start + grid * period
    after = np.where(exact, row, row + 1)

    span = np.where(exact, 1.0, stamp[after] - stamp[row])
    weight = np.clip((grid_stamp - stamp[row]) / span, 0.0, 1.0)[:, None]
    # In this form a person who stands still stays exactly still, as QTC's zero symbols need.
    between = position[row] + weight * (position[after] - position[row])
    ahead = (
        position[row] + (grid_stamp - stamp[row])[:, None] * _velocity(tracks, joined, period)[row]
    )
    lost = np.append(same & (step > 1.5 * np.median(step[same])), False) if same.any() else joined
    return Tracks(
        recording=name,
        stamp=grid_stamp,
        id=tracks.id[row],
        position=np.where(exact[:, None], position[row], between),
        imputed=tracks.imputed[row] | tracks.imputed[after] | (lost[row] & ~exact),
        known=np.where(exact, grid_stamp, stamp[after]),
        foreseen=np.where(exact[:, None], position[row], ahead),
        period=period,
        reading=tracks.reading,
    )


def _grid_points(
    tracks: Tracks, period: float, start: float, joined: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[G] rows, the numbers of the grid points that they serve, and whether they lie on them.

    Row i serves the grid points from its own place up to, not including, the next row's; where the
    next row does not follow (`joined [R]`) it serves only the point that it lies on.
    """
    name, stamp = tracks.recording, tracks.stamp
    nearest = np.rint((stamp - start) / period)
    snaps = np.abs(stamp - (start + nearest * period)) <= SNAP
    place = np.where(snaps, nearest, (stamp - start) / period)
    first = np.ceil(place)
    last = np.where(joined, np.append(first[1:], 0.0), np.floor(place) + 1)
    first, last = np.maximum(first, 0), np.maximum(last, 0)
    wanted = float(np.sum(last - first))
    if wanted > DENSE * len(stamp):
        raise InputError(
            f"{name}: a period of {period:g} s makes {wanted:,.0f} points of {len(stamp):,}, more "
            f"than {DENSE} of each: a longer one does"
        )
    if not wanted:
        raise InputError(f"{name}: no point lies on or between the points of the grid")
    count = (last - first).astype(np.int64)
    row = np.repeat(np.arange(len(stamp)), count)
    before = np.cumsum(count) - count
    grid = first[row] + (np.arange(len(row)) - before[row])
    return row, grid, grid == place[row]


def on_grid(tracks: Tracks, period: float = PERIOD) -> Tracks:
    """`tracks` with their own points if these are on one grid of `period` seconds, else resampled.

    Raises:
        InputError: for a period that is no usable number, see `resample`.
    """
    if not 0 < period < np.inf:
        raise InputError(f"{tracks.recording}: the period must be positive, not {period}")
    place = (tracks.stamp - tracks.stamp.min()) / period
    # Stamps of large frame numbers are rounded by more than SNAP.
    tolerance = SNAP / period + 4 * np.finfo(float).eps * np.abs(tracks.stamp).max() / period
    nearest = np.rint(place)
    steps = np.diff(np.unique(nearest))
    usual = len(steps) == 0 or common(steps) == 1.0
    alone = np.all((np.diff(tracks.id) != 0) | (np.diff(nearest) > 0))
    if usual and alone and np.all(np.abs(place - nearest) <= tolerance):
        return dataclasses.replace(tracks, period=period)
    return resample(tracks, period)


def _velocity(tracks: Tracks, joined: np.ndarray, period: float) -> np.ndarray:
    """[R, 2] m/s at every row: the mean over the `period` seconds before it, and a little more.

    `joined [R]` says which rows the next one follows on; nothing reaches across the others.
    """
    step = np.where(joined[:-1], np.diff(tracks.stamp), 2 * period)
    clock = np.concatenate([[0.0], np.cumsum(step)])  # ascending over all agents
    first = np.maximum.accumulate(np.where(np.append(True, ~joined[:-1]), np.arange(len(clock)), 0))
    since = np.searchsorted(clock, clock - period + SNAP, side="right") - 1
    since = np.maximum(since, first)
    span = (tracks.stamp - tracks.stamp[since])[:, None]
    moved = tracks.position - tracks.position[since]
    return np.divide(moved, span, out=np.zeros_like(moved), where=span > 0)


def common(values: np.ndarray) -> float:
    """The most common of [R] numbers, R > 0, the least if several are."""
    kinds, counts = np.unique(values, return_counts=True)
    return float(kinds[np.argmax(counts)])


def _refuse(recording: str, at_fault: ArrayLike, reason: str) -> None:
    rows = np.flatnonzero(at_fault)
    if len(rows):
        raise InputError(f"{recording}: row {rows[0]}: {reason}")


def _whole(recording: str, ids: np.ndarray) -> np.ndarray:
    """`ids` as int64; CSV readers give floats, which are taken where they are whole numbers."""
    if ids.dtype.kind in "iu":
        return ids.astype(np.int64)
    if ids.dtype.kind != "f":
        raise InputError(f"{recording}: id must be whole numbers, not {ids.dtype}")
    # Above 2**53 neighbouring ids share one float.
    whole = np.isfinite(ids) & (np.abs(ids) <= 2.0**53) & (ids == np.rint(ids))
    _refuse(recording, ~whole, "the id is not a whole number")
    return ids.astype(np.int64)
