"""The track table: where each agent was at each time, between the readers and the windows.

Every reader, the simulation and the robot's recorder produce `Tracks`. The table keeps the
recording's own clock in seconds and its own world frame in metres; it knows no observation length.
"""

import dataclasses
from collections.abc import Mapping
from types import MappingProxyType
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.reading import Reading
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
"""Seconds between the steps of the ETH/UCY benchmark and of every shipped model."""

MAX_METRES = 1e8
"""Largest coordinate accepted, metres; UTM and web maps stay below."""

LATE = 1e11
"""Latest time accepted, seconds; a float64 of this size still resolves 20 microseconds."""

SNAP = 1e-6
"""Seconds within which a stamp counts as a grid point, so that clocks written in decimals,
accumulated, or counted from 1970 meet the grid in spite of rounding."""

GAP = 1.5
"""A step of a person longer than this many usual ones is a gap."""

DENSE = 100
"""Largest ratio of grid points to source points; a larger one is taken for a mistyped period."""


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """The points of one recording: R rows sorted by (id, stamp). Build with `make_tracks`."""

    recording: str
    """Name, used in messages and in the identity of its scenes."""
    stamp: np.ndarray
    """[R] float64 seconds on the recording's clock."""
    id: np.ndarray
    """[R] int64 agent."""
    position: np.ndarray
    """[R, 2] float64 metres in the recording's frame."""
    extras: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """name: [R, ...] further numbers of each row, as a group, a class or a heading."""
    known: np.ndarray | None = None
    """[R] seconds: stamp of the last observation that the point depends on, see `resample`; None
    where every point was observed at its own stamp."""
    foreseen: np.ndarray | None = None
    """[R, 2] metres: the point as extrapolated from observations before `known`; None as there."""
    period: float | None = None
    """Seconds between the points of the grid that all stamps lie on; None without a grid."""
    reading: Reading | None = None
    """How the recording was read from a file; None for tracks made otherwise."""

    def take(self, rows: np.ndarray | slice) -> Self:
        """Select rows, with everything that belongs to them.

        Args:
            rows: [R] bool mask, [R'] ascending indices, or a slice.
        """
        return dataclasses.replace(
            self,
            stamp=self.stamp[rows],
            id=self.id[rows],
            position=self.position[rows],
            extras={name: values[rows] for name, values in self.extras.items()},
            known=None if self.known is None else self.known[rows],
            foreseen=None if self.foreseen is None else self.foreseen[rows],
        )

    def with_ids(self, id: np.ndarray) -> Self:
        """The same points with other ids [R] int64, sorted by them.

        Raises:
            InputError: if an agent would be seen twice at one stamp.
        """
        order = _order(self.recording, self.stamp, id)
        return dataclasses.replace(self, id=id).take(order)


def make_tracks(
    recording: str,
    stamp: ArrayLike,
    id: ArrayLike,
    position: ArrayLike,
    extras: Mapping[str, ArrayLike] = MappingProxyType({}),
) -> Tracks:
    """Check and sort rows given in any order; the arrays are copied.

    Args:
        recording: name of the recording.
        stamp: [R] seconds.
        id: [R] whole numbers.
        position: [R, 2] metres.
        extras: name: [R, ...] numbers.

    Raises:
        InputError: naming the recording, the first wrong row (from 0, in the caller's order) and
            the reason.
    """
    times = np.asarray(stamp, np.float64)
    points = np.asarray(position, np.float64)
    ids = np.asarray(id)
    others = {name: np.asarray(values) for name, values in extras.items()}
    rows = times.shape[0] if times.ndim == 1 else -1
    shapes = {name: (rows, *values.shape[1:]) for name, values in others.items()}
    shapes |= {"stamp": (rows,), "id": (rows,), "position": (rows, 2)}
    for name, array in (("stamp", times), ("id", ids), ("position", points), *others.items()):
        shape = shapes[name]
        if array.shape != shape:
            wanted = "[rows]" if rows < 0 else list(shape)
            raise InputError(f"{recording}: {name} must be {wanted}, not {list(array.shape)}")
    if rows == 0:
        raise InputError(f"{recording}: no rows")
    for name, values in {"id": ids, **others}.items():
        if values.dtype.kind not in ("iuf" if name == "id" else "biuf"):
            raise InputError(f"{recording}: {name} must be numbers, not {values.dtype}")
    # Above 2**53 neighbouring ids share one float.
    whole = ids.dtype.kind != "f" or (np.abs(ids) <= 2.0**53) & (ids == np.rint(ids))
    for right, reason in (
        (np.isfinite(times), "the stamp is not finite"),
        (np.isfinite(points).all(axis=1), "the position is not finite"),
        (whole, "the id is not a whole number"),
    ):
        if not np.all(right):
            raise InputError(f"{recording}: row {np.argmin(right)}: {reason}")
    ids = ids.astype(np.int64)
    return Tracks(recording, times, ids, points, others).take(_order(recording, times, ids))


def _order(recording: str, stamp: np.ndarray, id: np.ndarray) -> np.ndarray:
    """[R] indices that sort the rows by (id, stamp)."""
    order = np.lexsort((stamp, id))
    ids, times = id[order], stamp[order]
    again = np.flatnonzero((ids[1:] == ids[:-1]) & (times[1:] == times[:-1]))
    if len(again):
        first, second = order[again[0]], order[again[0] + 1]
        raise InputError(
            f"{recording}: row {second}: agent {ids[again[0]]} is seen at {times[again[0]]} s "
            f"in row {first} already"
        )
    return order


def resample(
    tracks: Tracks, period: float, max_gap: float = 1.0, start: float | None = None
) -> Tracks:
    """Interpolate every track linearly onto the grid `start + n * period`, n = 0, 1, ...

    A grid point within `SNAP` of a source point takes its position bit for bit. Any other lies
    between two source points of the agent at most `max_gap` apart: nothing is extrapolated, and a
    longer gap splits a track in two under the same id. Extras are those of the last source point.

    An interpolated point depends on the later source point (its stamp is `known`), which is not
    observed yet at the grid point's own time. `foreseen` is the position extrapolated from the
    earlier source points alone, at their mean velocity over the last `period`; `windows` uses it
    where `known` lies after the observation.

    Args:
        tracks: R rows.
        period: seconds between grid points.
        max_gap: longest gap that is filled, seconds.
        start: first point of the grid, seconds; default: the recording's first stamp. Earlier
            points are dropped.

    Raises:
        InputError: for a period, gap or start that is not a usable number, or does not suit the
            recording.
    """
    name = tracks.recording
    start = float(tracks.stamp.min()) if start is None else float(start)
    if not (np.isfinite([period, start]).all() and period > 2 * SNAP and max_gap >= 0):
        raise InputError(
            f"{name}: no usable grid: period {period}, start {start}, longest gap {max_gap} s"
        )

    stamp, position = tracks.stamp, tracks.position
    joined = (np.diff(tracks.id) == 0) & (np.diff(stamp) <= max_gap + 2 * SNAP)
    joined = np.append(joined, False)
    row, grid, exact = _grid_points(tracks, period, start, joined)
    grid_stamp = start + grid * period
    after = np.where(exact, row, row + 1)
    since = grid_stamp - stamp[row]
    weight = np.clip(since / np.where(exact, 1.0, stamp[after] - stamp[row]), 0.0, 1.0)[:, None]
    # In this form a standing person stays exactly still, which QTC's zero symbols need.
    between = position[row] + weight * (position[after] - position[row])
    ahead = position[row] + since[:, None] * _velocity(tracks, joined, period)[row]
    reading = tracks.reading
    if reading is not None:
        steps = np.diff(stamp)[np.diff(tracks.id) == 0]
        usual = max(float(np.median(steps)), period) if len(steps) else period
        filled = int(np.sum(stamp[after] - stamp[row] > GAP * usual))
        reading = dataclasses.replace(reading, filled=filled)
    return dataclasses.replace(
        tracks.take(row),
        reading=reading,
        stamp=grid_stamp,
        position=np.where(exact[:, None], position[row], between),
        known=np.where(exact, grid_stamp, stamp[after]),
        foreseen=np.where(exact[:, None], position[row], ahead),
        period=period,
    )


def _grid_points(
    tracks: Tracks, period: float, start: float, joined: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of G grid points its source row, its number n, and whether it lies on that row.

    Row i serves the grid points from its own stamp up to, but excluding, the next row's. A row
    without a successor (`joined [R]` is False) serves only the point that it lies on.
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


def on_grid(tracks: Tracks, period: float = PERIOD, max_gap: float = 1.0) -> Tracks:
    """`tracks` unchanged if they lie on one grid of `period` seconds without a gap, else resampled.

    A gap is a longer step of a person than the usual; those of at most `max_gap` seconds are
    filled, and counted in `reading`.

    Raises:
        InputError: for a period or gap that is not a usable number, see `resample`.
    """
    if not 0 < period < np.inf:
        raise InputError(f"{tracks.recording}: the period must be positive, not {period}")
    place = (tracks.stamp - tracks.stamp.min()) / period
    # Stamps of large frame numbers are rounded by more than SNAP.
    tolerance = SNAP / period + 4 * np.finfo(float).eps * np.abs(tracks.stamp).max() / period
    nearest = np.rint(place)
    steps = np.diff(np.unique(nearest))
    counts = np.diff(nearest)[np.diff(tracks.id) == 0]
    usual = len(steps) == 0 or common(steps) == 1.0
    gaps = (counts > 1) & (counts * period <= max_gap + 2 * SNAP)
    on = usual and np.all(counts > 0) and np.all(np.abs(place - nearest) <= tolerance)
    if on and not np.any(gaps):
        return dataclasses.replace(tracks, period=period)
    return resample(tracks, period, max_gap)


def _velocity(tracks: Tracks, joined: np.ndarray, period: float) -> np.ndarray:
    """[R, 2] m/s: mean velocity over at least the last `period` seconds before each row.

    Uses no row before a gap (`joined [R]`: the next row continues this one). A track shorter than
    `period` uses what there is; its first row has velocity zero.
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
    """The most common of [R] numbers, R > 0; the smallest of several."""
    kinds, counts = np.unique(values, return_counts=True)
    return float(kinds[np.argmax(counts)])
