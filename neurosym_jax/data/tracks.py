"""The track table: where each agent was at each time, and tracks on one clock.

The table keeps the recording's own clock in seconds and its own world frame in metres.
"""

import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError, option, printable, refuse_masked

__all__ = [
    "GAP",
    "LATE",
    "PERIOD",
    "SNAP",
    "Reading",
    "Tracks",
    "common",
    "describe_readings",
    "fields_at",
    "make_tracks",
    "on_grid",
    "resample",
]

# seconds between the steps of the ETH/UCY benchmark and of every shipped model
PERIOD = 0.4
SNAP = 1e-6  # seconds within which a stamp counts as a grid point: clocks are rounded
GAP = 1.5  # a step of a person longer than this many usual ones is a gap
LATE = 1e11  # latest time accepted, seconds; a float64 of this size resolves 20 microseconds
MAX_METRES = 1e8  # largest coordinate accepted; UTM and web maps stay below


@dataclasses.dataclass(frozen=True)
class Reading:
    """How a recording was read; people, model cards and JSON reports show it."""

    recording: str
    file: str | None = None  # path, if there is a file
    format: str | None = None  # name of the file's format
    rows: int = 0  # points that were read
    filled: int = 0  # points that were interpolated in gaps of single people's tracks
    # points of windows, once cut, that lie between two points of the file
    interpolated: int = 0
    gaps: int = 0  # gaps in time, once windows are cut; windows do not cross them
    warnings: tuple[str, ...] = ()  # what looks wrong, a line each
    notes: tuple[str, ...] = ()
    """What the file said of itself, and what was guessed, a line each."""
    rate: float | None = None  # frame numbers a second, where the file numbers frames
    columns: tuple[str, ...] = ()  # a table's, ROLE=COLUMN each, named or guessed
    unused: tuple[str, ...] = ()  # names of a table's other columns
    left_out: tuple[str, ...] = ()  # how many rows were not read and why, a line each

    def __str__(self) -> str:
        """A line: format, rows, what is left out, gaps, interpolated points and notes."""
        parts = [f"{self.rows} rows"]
        parts += [f"{line} left out" for line in self.left_out]
        if self.interpolated:
            parts.append(f"{self.interpolated} points of windows interpolated")
        if self.filled:
            parts.append(f"{self.filled} points filled in gaps")
        if self.gaps:
            noun = "gap" if self.gaps == 1 else "gaps"
            parts.append(f"{self.gaps} {noun} in time")
        line = f"read {self.recording}: {self.format}, {', '.join(parts)}"
        if self.unused:
            names = ", ".join(name[:20] for name in self.unused[:8])
            line += f"; columns not used: {names}"
        return printable("; ".join([line, *self.notes]))


@dataclasses.dataclass(frozen=True, eq=False)
class Tracks:
    """The points of one recording: R rows sorted by (id, stamp). Build with `make_tracks`."""

    recording: str  # name, used in messages and in the identity of its scenes
    stamp: np.ndarray  # [R] float64 seconds on the recording's clock
    id: np.ndarray  # [R] int64 agent
    position: np.ndarray  # [R, 2] float64 metres in the recording's frame
    extras: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """name: [R, ...] further numbers of each row, as a group, a class or a heading."""
    # [R] seconds: last observation that the point depends on
    known: np.ndarray | None = None
    # [R, 2] metres: extrapolated from those before `known`
    foreseen: np.ndarray | None = None
    # seconds between points of the grids that all stamps lie on
    period: float | None = None
    # [R] int64 number on that grid; pieces of other phase are apart
    step: np.ndarray | None = None
    reading: Reading | None = None  # how the recording was read from a file
    names: tuple[str, ...] = ()  # texts of the ids 0, 1, ... where ids are texts
    _columns: ClassVar = ("stamp", "id", "position", "known", "foreseen", "step")

    def take(self, rows: np.ndarray | slice) -> Self:
        """Select rows ([R] bool mask, [R'] ascending indices, or a slice) with all their fields."""
        extras = {name: values[rows] for name, values in self.extras.items()}
        return dataclasses.replace(
            self, extras=extras, **fields_at(self, self._columns, rows)
        )

    def with_ids(self, id: np.ndarray) -> Self:
        """The same points with other ids [R] int64, sorted by them."""
        order = _order(self.recording, self.stamp, id)
        # Fresh ids have no name.
        names = self.names if np.all(id < len(self.names)) else ()
        return dataclasses.replace(self, id=id, names=names).take(order)

    def ids_as_given(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """[R'] ids of rows as the file has them: whole numbers or texts."""
        if self.names:
            return np.array(self.names)[self.id[rows]]
        return self.id[rows]


def fields_at(data: Any, names: Iterable[str], rows: Any) -> dict[str, np.ndarray]:
    """The arrays of some names that `data` has, at `rows`."""
    arrays = {}
    for name in names:
        values = getattr(data, name)
        if values is not None:
            arrays[name] = values[rows]
    return arrays


def make_tracks(
    recording: str,
    stamp: ArrayLike,
    id: ArrayLike,
    position: ArrayLike,
    extras: Mapping[str, ArrayLike] = MappingProxyType({}),
    *,
    reading: Reading | None = None,
    row: np.ndarray | None = None,
) -> Tracks:
    """Check, copy and sort rows given in any order.

    They have `stamp` [R] seconds, `id` [R] whole numbers or texts, `position` [R, 2]
    metres, and `extras` name: [R, ...] numbers. Messages call them `row` [R] (default: from 0) of
    the file in `reading`.

    Raises:
        InputError: naming the recording, the first wrong row and the reason.
    """
    file = reading.file if reading and reading.file else recording
    refuse_masked({"stamp": stamp, "id": id, "position": position, **extras})
    times = np.asarray(stamp, np.float64)
    points = np.asarray(position, np.float64)
    ids = np.asarray(id)
    names: tuple[str, ...] = ()
    if ids.dtype.kind in "UO" and all(isinstance(text, str) for text in ids.flat):
        texts, ids = np.unique(ids, return_inverse=True)
        names = tuple(texts.tolist())
    others = {name: np.asarray(values) for name, values in extras.items()}
    _refuse_shapes(file, {"stamp": times, "id": ids, "position": points, **others})

    is_usable = np.abs(times) <= LATE
    hint = f" of seconds ({option('time_unit')}?)"
    _refuse_values(file, row, "time", times, is_usable, hint)
    is_usable = (np.abs(points) <= MAX_METRES).all(axis=1)
    _refuse_values(file, row, "position", points, is_usable)
    is_usable = ids <= np.iinfo(np.int64).max
    if ids.dtype.kind == "f":
        # Above 2**53 neighbouring ids share one float.
        is_usable &= (np.abs(ids) <= 2.0**53) & (ids == np.rint(ids))
    _refuse_values(file, row, "id", ids, is_usable)
    ids = ids.astype(np.int64)
    tracks = Tracks(recording, times, ids, points, others, reading=reading, names=names)
    unused = reading.unused if reading else ()
    return tracks.take(_order(file, times, ids, row, names, unused))


def _refuse_shapes(file: str, arrays: Mapping[str, np.ndarray]) -> None:
    """Refuse arrays that are not numbers of the same R > 0 rows."""
    rows = arrays["stamp"].size
    shapes = {"stamp": (rows,), "id": (rows,), "position": (rows, 2)}
    for name, array in arrays.items():
        shape = shapes.get(name, (rows, *array.shape[1:]))
        if not rows or array.shape != shape or array.dtype.kind not in "biuf":
            kind = f"{list(array.shape)} {array.dtype}"
            raise InputError(
                f"{file}: {name} must be numbers {list(shape)}, not {kind}"
            )


def _refuse_values(
    file: str,
    row: np.ndarray | None,
    name: str,
    values: np.ndarray,
    is_usable: Any,
    hint: str = "",
) -> None:
    """Refuse the first of [R] values that is not usable by the mask `is_usable` [R]."""
    if not np.all(is_usable):
        at = int(np.argmin(is_usable))
        line = at if row is None else row[at]
        value = f"{name} {values[at]}"
        raise InputError(f"{file}: row {line}: {value} is not a usable number{hint}")


def _order(
    file: str,
    stamp: np.ndarray,
    id: np.ndarray,
    row: Any = None,
    names: Sequence[str] = (),
    unused: Sequence[str] = (),
) -> np.ndarray:
    """[R] indices that sort the rows by (id, stamp); messages name `unused` columns of the file."""
    order = np.lexsort((stamp, id))
    same_agent = np.diff(id[order]) == 0
    same_stamp = np.diff(stamp[order]) == 0
    repeats = order[1:][same_agent & same_stamp]
    if len(repeats):
        at = repeats[0]
        line = at if row is None else row[at]
        person = names[int(id[at])][:40] if names else id[at]
        message = f"{file}: row {line}: repeats agent {person} at {stamp[at]:.12g} s"
        if unused:
            recordings = option("columns", (f"recording={unused[0]}",))
            columns = ", ".join(unused[:4])
            message += f" (unused columns: {columns}; {recordings}, if one tells recordings apart)"
        raise InputError(message)
    return order


def common(values: np.ndarray) -> float:
    """The most common of [R] numbers, R > 0; the smallest of several."""
    kinds, counts = np.unique(values, return_counts=True)
    return float(kinds[np.argmax(counts)])


def describe_readings(readings: Iterable[Reading]) -> str:
    """A line for each recording that was read from a file."""
    latest = {(reading.file, reading.recording): reading for reading in readings}
    return "\n".join(str(reading) for reading in latest.values() if reading.file)


# One clock: grids in time, and interpolation of tracks onto them.
#
# A recording may be annotated every 0.4 s and yet go on a fraction of that later after a
# pause, so that no one grid fits all of it. Each piece therefore has a grid of its own,
# and nothing crosses from one piece to the next.

DENSE = 100  # largest ratio of grid points to source points; beyond, a mistyped period
SHIFT = 0.05  # of a period: smaller changes of phase are a rounded or jittering clock


def resample(
    tracks: Tracks, period: float, max_gap: float = 1.0, start: float | None = None
) -> Tracks:
    """Interpolate every track linearly onto a grid of steps of `period`.

    With `start` the grid is `start + n * period`, n = 0, 1, ...; without, each piece of
    the recording has the phase that most of its rows have (see `phases`). A grid point
    within `SNAP` of a source point takes its position bit for bit. Any other lies
    between two source points of the agent at most `max_gap` apart; a longer gap splits
    a track in two under the same id. Extras are those of the last source point.

    An interpolated point depends on the later source point (its stamp is `known`).
    `foreseen` is extrapolated from the earlier ones alone, at their mean velocity over
    the last `period`; `windows` uses it where `known` lies after the observation.

    All times are in seconds.

    Raises:
        InputError: for a period, gap or start that does not suit the recording.
    """
    first = float(tracks.stamp.min()) if start is None else float(start)
    _refuse_grid(tracks, period, first, max_gap)
    stamp = tracks.stamp
    joined = np.append(np.diff(tracks.id) == 0, False)
    joined[:-1] &= np.diff(stamp) <= max_gap + 2 * SNAP
    if start is None:
        piece, origins = phases(stamp, joined, period)
        joined[:-1] &= np.diff(piece) == 0
    else:
        piece = np.zeros(len(stamp), int)
        origins = np.array([first])
    origin = origins[piece]
    # Steps of two pieces never follow each other: no window goes across.
    steps = np.floor(np.diff(origins) / period + SNAP) + 2
    base = np.append(0, np.cumsum(steps)).astype(np.int64)

    row, grid, exact = _grid_points(tracks, period, origin, joined)
    grid_stamp = origin[row] + grid * period
    velocity = _velocity(tracks, joined, period)
    tracks = _interpolated(tracks, row, grid_stamp, exact, velocity, GAP * period)
    step = base[piece[row]] + grid.astype(np.int64)
    return dataclasses.replace(tracks, period=period, step=step)


def _interpolated(
    tracks: Tracks,
    row: np.ndarray,
    moment: np.ndarray,
    exact: np.ndarray,
    velocity: np.ndarray,
    longest: float,
) -> Tracks:
    """Points at each `moment` [G] from the row [G] at or before it and the next of the same track.

    `exact` [G] are on that row; `velocity` [R, 2] says what was foreseen. Gaps above
    `longest` seconds are counted.
    """
    stamp = tracks.stamp
    after = np.where(exact, row, row + 1)
    since = moment - stamp[row]
    gap = stamp[after] - stamp[row]
    weight = np.clip(since / np.where(exact, 1.0, gap), 0.0, 1.0)
    before = tracks.position[row]
    # In this form a standing person stays exactly still, which QTC's zero symbols need.
    way = tracks.position[after] - before
    between = before + weight[:, None] * way
    ahead = before + since[:, None] * velocity[row]

    reading = tracks.reading
    if reading:
        filled = int(np.sum(gap > longest))
        reading = dataclasses.replace(reading, filled=filled)
    return dataclasses.replace(
        tracks.take(row),
        reading=reading,
        stamp=moment,
        position=np.where(exact[:, None], before, between),
        known=np.where(exact, moment, stamp[after]),
        foreseen=np.where(exact[:, None], before, ahead),
    )


def _refuse_grid(tracks: Tracks, period: float, first: float, max_gap: float) -> None:
    if not 2 * SNAP < period < np.inf:
        raise InputError(
            f"{tracks.recording}: the period must be positive, not {period:g}"
        )
    if not (np.isfinite(first) and max_gap >= 0):
        limits = f"start {first}, longest gap {max_gap} s"
        raise InputError(f"{tracks.recording}: no usable grid: {limits}")


def phases(
    stamp: np.ndarray, joined: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of a recording that one grid of steps of `period` seconds fits, and their grids.

    A piece ends in a pause, in which no track goes on, and where the phase of most rows
    changes. Its phase is that of most rows; where none has a majority, as at 25 frames
    a second, the first that is common, or the last piece's. Rows without a neighbour in
    time have no vote.

    Args:
        stamp: [R] seconds of rows sorted by (agent, stamp).
        joined: [R] bool: the next row continues this one's track.
        period: seconds.

    Returns:
        [R] number of each row's piece, in order of time, and [P] seconds: a point of
        each grid, at or before the first row of the piece.
    """
    votes = _voters(stamp, joined)
    moment = stamp[votes]
    label = _phases(moment, period)
    # A pause: no track lasts from before it to after it.
    following = stamp[np.minimum(votes + 1, len(stamp) - 1)]
    end = np.where(joined[votes], following, moment)
    pause = moment[1:] > np.maximum.accumulate(end)[:-1] + SNAP
    pauses = np.flatnonzero(pause) + 1
    jumps = np.searchsorted(moment, _jumps(stamp, joined, period))
    cuts = np.unique(np.array([0, *pauses, *jumps, len(votes)]))

    begins, origins = list[float](), list[float]()
    previous = -1
    for low, high in itertools.pairwise(cuts):
        labels = label[low:high]
        choice = _phase_of(labels, previous)
        if choice == previous:
            continue
        previous = choice
        start = stamp.min() if low == 0 else moment[low]
        example = moment[low:high][labels == choice][0]
        steps = np.ceil((example - start) / period - SNAP)
        origins.append(float(example - steps * period))
        begins.append(float(start))
    piece = np.searchsorted(begins, stamp + SNAP, side="right") - 1
    return piece, np.array(origins)


def _voters(stamp: np.ndarray, joined: np.ndarray) -> np.ndarray:
    """[V] rows that have a neighbour in time, else all, in order of time."""
    has_neighbour = joined | np.append(False, joined[:-1])
    rows = np.flatnonzero(has_neighbour | ~has_neighbour.any())
    return rows[np.argsort(stamp[rows], kind="stable")]


def _phase_of(labels: np.ndarray, previous: int) -> int:
    """The number of the phase of a piece whose rows have phases `labels` [V]."""
    kinds, first, counts = np.unique(labels, return_index=True, return_counts=True)
    if 2 * counts.max() > len(labels):
        return int(kinds[counts.argmax()])
    if previous in kinds:
        return previous
    frequent = counts >= counts.max() / 4
    return int(kinds[frequent][np.argmin(first[frequent])])


def _jumps(stamp: np.ndarray, joined: np.ndarray, period: float) -> list[float]:
    """The moments at which most of the tracks that go on change phase, and not before."""
    step = np.mod(np.diff(stamp) / period + SHIFT, 1)
    changes = (step > 2 * SHIFT) & joined[:-1]
    is_regular = joined[:-1] & ~changes
    new = changes & np.append(False, is_regular[:-1])
    jumps = []
    for moment in np.unique(stamp[1:][new]):
        over = joined[:-1] & (stamp[:-1] < moment) & (stamp[1:] >= moment)
        if np.mean(new[over]) > 0.5:
            jumps.append(moment)
    return jumps


def _phases(stamp: np.ndarray, period: float) -> np.ndarray:
    """[R] number of each stamp's phase, of those that are more than `SNAP` apart; the last may be
    the first again."""
    residue = np.mod(stamp, period)
    order = np.argsort(residue, kind="stable")
    new = np.diff(residue[order], prepend=-1.0) > 2 * SNAP
    label = np.empty(len(stamp), np.int64)
    label[order] = np.cumsum(new) - 1
    if residue.min() + period - residue.max() <= 2 * SNAP:
        label[label == label.max()] = 0
    return label


def _grid_points(
    tracks: Tracks, period: float, origin: np.ndarray, joined: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of G grid points its source row, its number n, and whether it lies on that row.

    The grid of a row is `origin [R] + n * period`, n >= 0. A row serves the grid points
    before the next row's or, if it is not `joined` [R] to that, the point that it lies
    on.
    """
    stamp = tracks.stamp
    place = (stamp - origin) / period
    nearest = np.rint(place)
    snaps = np.abs(stamp - (origin + nearest * period)) <= SNAP
    place = np.where(snaps, nearest, place)
    first = np.ceil(place)
    next_first = np.append(first[1:], 0.0)
    last = np.where(joined, next_first, np.floor(place) + 1)
    first = np.maximum(first, 0)
    last = np.maximum(last, 0)
    total = float(np.sum(last - first))
    if not 0 < total <= DENSE * len(stamp):
        points = f"{total:,.0f} points of {len(stamp):,}"
        raise InputError(f"{tracks.recording}: a period of {period:g} s makes {points}")
    count = (last - first).astype(np.int64)
    row = np.repeat(np.arange(len(stamp)), count)
    before = np.cumsum(count) - count
    number = np.arange(len(row)) - before[row]
    grid = first[row] + number
    return row, grid, grid == place[row]


def on_grid(tracks: Tracks, period: float = PERIOD, max_gap: float = 1.0) -> Tracks:
    """`tracks` unchanged if they lie on one grid of `period` seconds without a gap, else resampled.

    Raises:
        InputError: for a period or gap that is not a usable number, see `resample`.
    """
    _refuse_grid(tracks, period, 0.0, max_gap)
    place = (tracks.stamp - tracks.stamp.min()) / period
    nearest = np.rint(place)
    steps = np.diff(nearest)[np.diff(tracks.id) == 0]
    snaps = np.abs(place - nearest) <= SNAP / period
    if np.all(steps == 1) and np.all(snaps):
        return dataclasses.replace(tracks, period=period)
    return resample(tracks, period, max_gap)


def _velocity(tracks: Tracks, joined: np.ndarray, period: float) -> np.ndarray:
    """[R, 2] m/s: mean velocity over the last `period` seconds before each row, since the last gap
    (`joined [R]`: the next row continues this one); zero at the first row."""
    step = np.where(joined[:-1], np.diff(tracks.stamp), 2 * period)
    clock = np.append(0.0, np.cumsum(step))  # ascending over all agents
    begins = np.append(True, ~joined[:-1])
    first = np.where(begins, np.arange(len(clock)), 0)
    first = np.maximum.accumulate(first)
    since = np.searchsorted(clock, clock - period + SNAP, side="right") - 1
    since = np.maximum(since, first)
    span = tracks.stamp - tracks.stamp[since]
    moved = tracks.position - tracks.position[since]
    velocity = np.zeros_like(moved)
    has_time = span > 0
    velocity[has_time] = moved[has_time] / span[has_time, None]
    return velocity
