"""Tracks on one clock to windows and batches of scenes, and which windows two sets share."""

import base64
import dataclasses
import itertools
import re
from collections.abc import Iterable, Mapping
from typing import Self

import jax
import numpy as np

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.tracks import GAP, PERIOD, SNAP, Reading, Tracks, common
from neurosym_jax.errors import InputError, option
from neurosym_jax.scene import (
    Scene,
    displacements,
    model_dtype,
    relative_positions,
    scene_identity,
)

__all__ = [
    "Batch",
    "Windows",
    "bucket_of",
    "chance_shapes",
    "cut_windows",
    "fingerprint",
    "gather_scenes",
    "is_fingerprint",
    "make_batches",
    "merged_fingerprints",
    "on_grid",
    "resample",
    "seen_before",
    "shared_shapes",
    "single_scene",
]


# Grids in time: the phase of each piece of a recording, and interpolation of tracks
# onto it.
#
# A recording may be annotated every 0.4 s and yet go on a fraction of that later after a
# pause, so that no one grid fits all of it. Each piece therefore has a grid of its own,
# and nothing crosses from one piece to the next.

DENSE = 100  # largest ratio of grid points to source points; beyond, a mistyped period
NEAR = 2  # periods around a row in which most rows must share its phase to make it a majority
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
    here = tracks.position[row]
    # In this form a standing person stays exactly still, which QTC's zero symbols need.
    between = here + weight[:, None] * (tracks.position[after] - here)
    ahead = here + since[:, None] * velocity[row]

    reading = tracks.reading
    if reading:
        filled = int(np.sum(gap > longest))
        reading = dataclasses.replace(reading, filled=filled)
    return dataclasses.replace(
        tracks.take(row),
        reading=reading,
        stamp=moment,
        position=np.where(exact[:, None], here, between),
        known=np.where(exact, moment, stamp[after]),
        foreseen=np.where(exact[:, None], here, ahead),
    )


def _refuse_grid(tracks: Tracks, period: float, first: float, max_gap: float) -> None:
    is_usable = np.isfinite([period, first]).all() and period > 2 * SNAP
    if not (is_usable and max_gap >= 0):
        options = f"period {period}, start {first}, longest gap {max_gap} s"
        raise InputError(f"{tracks.recording}: no usable grid: {options}")


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
    residue, label = _residues(moment, period)
    major = _is_majority(moment, label, period)
    # A pause: no track lasts from before it to after it.
    following = stamp[np.minimum(votes + 1, len(stamp) - 1)]
    end = np.where(joined[votes], following, moment)
    pause = moment[1:] > np.maximum.accumulate(end)[:-1] + SNAP

    rows = np.flatnonzero(major)
    change = np.abs(np.diff(residue[label[rows]])) / period
    change = np.minimum(change, 1 - change)
    jumps = []
    for at in rows[1:][change > SHIFT]:
        if _jumps(stamp, joined, float(moment[at]), period):
            jumps.append(at)
    pauses = np.flatnonzero(pause) + 1
    cuts = np.unique(np.array([0, *pauses, *jumps, len(votes)]))

    begins, origins = list[float](), list[float]()
    previous = -1
    for low, high in itertools.pairwise(cuts):
        labels = label[low:high]
        choice = _phase_of(labels, major[low:high], previous)
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
    rows = np.arange(len(stamp))
    if has_neighbour.any():
        rows = np.flatnonzero(has_neighbour)
    return rows[np.argsort(stamp[rows], kind="stable")]


def _phase_of(labels: np.ndarray, major: np.ndarray, previous: int) -> int:
    """The number of the phase of a piece whose rows have phases `labels` [V]."""
    ballot = labels[major]
    if 2 * len(ballot) > len(labels):
        return int(common(ballot))
    kinds, first, counts = np.unique(labels, return_index=True, return_counts=True)
    if previous in kinds:
        return previous
    frequent = counts >= counts.max() / 4
    return int(kinds[frequent][np.argmin(first[frequent])])


def _jumps(stamp: np.ndarray, joined: np.ndarray, moment: float, period: float) -> bool:
    """Whether most of the tracks that go on at a moment change phase there, and not before."""
    over = np.flatnonzero(joined & (stamp < moment))
    over = over[stamp[over + 1] >= moment]
    if not len(over):
        return False
    change = _is_shift(stamp[over + 1] - stamp[over], period)
    earlier = _is_shift(stamp[over] - stamp[over - 1], period)
    return bool(np.mean(change & ~earlier) > 0.5)


def _is_shift(step: np.ndarray, period: float) -> np.ndarray:
    """[K] bool: whether steps in seconds [K] are no whole number of periods."""
    return np.mod(step / period + SHIFT, 1) > 2 * SHIFT


def _residues(stamp: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """[K] phases in seconds, each more than `SNAP` from the next, and [R] the number of each
    stamp's; the last may be the first again."""
    residue = np.mod(stamp, period)
    order = np.argsort(residue, kind="stable")
    new = np.diff(residue[order], prepend=-1.0) > 2 * SNAP
    label = np.empty(len(stamp), np.int64)
    label[order] = np.cumsum(new) - 1
    kinds = residue[order][new]
    if kinds[0] + period - residue.max() <= 2 * SNAP:
        label[label == len(kinds) - 1] = 0
    return kinds, label


def _is_majority(stamp: np.ndarray, label: np.ndarray, period: float) -> np.ndarray:
    """[R] bool: whether most of the rows within `NEAR` periods have the phase of a row, and one of
    them at another moment. `stamp` ascends."""
    tick = np.rint((stamp - stamp[0]) / period * 100).astype(np.int64)
    # Else of two phases that alternate, each has 5 of 9 rows around one.
    reach = NEAR * 100 - 1
    total = _counts_around(tick, reach)
    # Ticks of one phase, far from those of all others.
    key = label * (tick[-1] + 4 * reach) + tick
    same_phase = _counts_around(key, reach)
    now = _counts_around(key, 1)
    return (2 * same_phase > total) & (same_phase > now)


def _counts_around(values: np.ndarray, reach: int) -> np.ndarray:
    """[R] how many of `values` [R] lie within `reach` of each."""
    ordered = np.sort(values)
    end = np.searchsorted(ordered, values + reach, "right")
    return end - np.searchsorted(ordered, values - reach)


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
    if not 0 < period < np.inf:
        raise InputError(
            f"{tracks.recording}: the period must be positive, not {period}"
        )
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
    still = np.zeros_like(moved)
    return np.divide(moved, span[:, None], out=still, where=span[:, None] > 0)


# Windows of people who are present together, SGAN's exactly, and batches of their
# scenes.
#
# A window spans `obs_len + pred_len` consecutive steps of its recording and holds the
# agents seen at every one of them. Its observed part depends on nothing recorded later.
# Batches are padded to a few static shapes, so that compilation stays cheap.


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one or more recordings: A agent windows, grouped into S scenes."""

    position: np.ndarray
    """[A, obs_len + pred_len, 2] float64 metres in the recording's frame."""
    agent: np.ndarray  # [A] ids as the recording has them: int64, or texts
    bounds: np.ndarray
    """[S + 1] int64; scene s holds the rows `bounds[s]:bounds[s + 1]`."""
    identity: np.ndarray  # [S, 2] uint32 (recording digest, index of the first stamp)
    obs_len: int  # observed steps; the others are the future
    period: float = PERIOD  # seconds between steps
    reading: tuple[Reading, ...] = ()  # how each recording was read
    extras: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """name: [A, ...] further numbers of each agent window, at the last observed step."""
    stamp: np.ndarray | None = None
    """[S] float64 seconds of the last observed step, on the recording's clock, where it has one."""
    seen: np.ndarray | None = None
    """[A, obs_len] bool, see `Scene.seen`; None where all positions were seen."""

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return len(self.bounds) - 1

    @property
    def agents(self) -> int:
        """Number of agent windows."""
        return len(self.position)

    @property
    def sizes(self) -> np.ndarray:
        """[S] agents per scene."""
        return np.diff(self.bounds)

    def rows(self, scenes: np.ndarray) -> np.ndarray:
        """[A'] the agent windows of `scenes` [S'] (indices), scene after scene."""
        sizes = self.sizes[scenes]
        before = np.cumsum(sizes) - sizes
        shift = self.bounds[scenes] - before
        return np.repeat(shift, sizes) + np.arange(sizes.sum())

    def take(self, scenes: np.ndarray | slice) -> Self:
        """Select scenes: [S] bool mask, [S'] indices (any order, repeats allowed), or a slice."""
        chosen = np.arange(self.scenes)[scenes]
        rows = self.rows(chosen)
        stamp = self.stamp
        if stamp is not None:
            stamp = stamp[chosen]
        seen = self.seen
        if seen is not None:
            seen = seen[rows]
        return dataclasses.replace(
            self,
            position=self.position[rows],
            agent=self.agent[rows],
            bounds=_bounds(self.sizes[chosen]),
            identity=self.identity[chosen],
            stamp=stamp,
            seen=seen,
            extras={name: values[rows] for name, values in self.extras.items()},
        )


def _bounds(sizes: np.ndarray) -> np.ndarray:
    """[S + 1] first row of each of S scenes of `sizes` [S] agents, and the number of rows."""
    return np.append(0, np.cumsum(sizes))


def cut_windows(
    recordings: Iterable[Tracks],
    obs_len: int,
    pred_len: int,
    *,
    skip: int = 1,
    min_agents: int = 2,
) -> Windows:
    """All windows of `recordings`, in order of recording, start stamp and agent id.

    Each recording is on one grid (see `tracks.on_grid`). A window starts at every
    `skip`-th step; scenes with fewer than `min_agents` are dropped.

    Raises:
        InputError: for a number below 1, or if there is no window, a recording is on no
            grid, or recordings do not match.
    """
    lengths = {"obs_len": obs_len, "pred_len": pred_len}
    refuse(Count, {**lengths, "skip": skip, "min_agents": min_agents})
    recordings = list(recordings)
    names = ", ".join(tracks.recording for tracks in recordings[:3]) or "no recordings"
    periods = [_period(tracks) for tracks in recordings]
    periods = [period for period in periods if period < np.inf]
    if periods and max(periods) - min(periods) > 0.01 * min(periods):
        steps = f"steps of {min(periods):g} to {max(periods):g} s"
        raise InputError(f"{names}: {steps}: choose one")
    if len({frozenset(tracks.extras) for tracks in recordings}) > 1:
        raise InputError(f"{names}: their extras differ")
    parts = []
    for tracks in recordings:
        parts.append(_cut(tracks, obs_len, pred_len, skip, min_agents))
    if not any(part.scenes for part in parts):
        raise InputError(
            f"{names}: no {obs_len + pred_len} consecutive steps have at least {min_agents} people "
            f"throughout (longer gaps than {option('max_gap')} are not filled)"
        )
    windows = _joined(parts)
    if not periods:
        return windows
    return dataclasses.replace(windows, period=common(np.array(periods)))


def _joined(parts: list[Windows]) -> Windows:
    """The windows of several recordings, one after the other."""
    readings = itertools.chain.from_iterable(part.reading for part in parts)
    extras = {}
    for name in parts[0].extras:
        extras[name] = np.concatenate([part.extras[name] for part in parts])
    stamps = [part.stamp for part in parts if part.stamp is not None]
    return Windows(
        position=np.concatenate([part.position for part in parts]),
        agent=np.concatenate([part.agent for part in parts if part.scenes]),
        bounds=_bounds(np.concatenate([part.sizes for part in parts])),
        identity=np.concatenate([part.identity for part in parts]),
        obs_len=parts[0].obs_len,
        reading=tuple(readings),
        extras=extras,
        stamp=np.concatenate(stamps),
    )


def _period(tracks: Tracks) -> float:
    """Seconds of one step; infinite if there is only one."""
    if tracks.period:
        return tracks.period
    steps = np.diff(np.unique(tracks.stamp)).round(6)
    return max(common(steps), SNAP) if len(steps) else np.inf


def _cut(
    tracks: Tracks, obs_len: int, pred_len: int, skip: int, min_agents: int
) -> Windows:
    """The windows of one recording, possibly none."""
    place = _places(tracks)
    places, step = np.unique(place, return_inverse=True)
    first = _complete_rows(tracks, place, obs_len + pred_len)
    first = first[step[first] % skip == 0]
    first = first[np.argsort(step[first], kind="stable")]

    starts, sizes = np.unique(step[first], return_counts=True)
    enough = sizes >= min_agents
    first = first[np.repeat(enough, sizes)]
    starts, sizes = starts[enough], sizes[enough]
    rows = first[:, None] + np.arange(obs_len + pred_len)
    interpolated = 0
    if tracks.known is not None and tracks.foreseen is not None:
        used = np.unique(rows)
        interpolated = int(np.sum(tracks.known[used] > tracks.stamp[used]))
    gaps = int(np.sum(np.diff(places) > 1))
    reading = tracks.reading or Reading(tracks.recording, rows=len(tracks.id))
    reading = dataclasses.replace(reading, gaps=gaps, interpolated=interpolated)
    now = first + obs_len - 1
    return Windows(
        position=_foreseen(tracks, rows, obs_len),
        agent=tracks.ids_as_given(first),
        bounds=_bounds(sizes),
        identity=scene_identity(tracks.recording, starts),
        obs_len=obs_len,
        reading=(reading,),
        extras={name: values[now] for name, values in tracks.extras.items()},
        stamp=tracks.stamp[now][_bounds(sizes)[:-1]],
    )


def _places(tracks: Tracks) -> np.ndarray:
    """[R] number of each row's step on the recording's one grid.

    Raises:
        InputError: for stamps on no one grid.
    """
    if tracks.step is not None:
        return tracks.step
    exact = (tracks.stamp - tracks.stamp.min()) / _period(tracks)
    # Two agents' stamps may be rounded differently on one grid.
    place = np.rint(exact)
    if np.any(np.abs(exact - place) > 0.05):
        raise InputError(
            f"{tracks.recording}: its stamps are on no one grid: use data.on_grid"
        )
    return place


def _complete_rows(tracks: Tracks, place: np.ndarray, length: int) -> np.ndarray:
    """[F] rows from which the same agent is seen at `length` consecutive steps `place` [R].

    Rows are sorted by (id, stamp) without duplicates, so `length` rows of one id that
    span `length - 1` steps are all there.
    """
    last = np.arange(length - 1, len(place))
    first = last - (length - 1)
    same_agent = tracks.id[first] == tracks.id[last]
    span = place[last] - place[first]
    return first[same_agent & (span == length - 1)]


def _foreseen(tracks: Tracks, rows: np.ndarray, obs_len: int) -> np.ndarray:
    """[A, T, 2] positions of `rows` [A, T], the observed ones as foreseen where they depend on
    what is observed later."""
    position = tracks.position[rows]
    if tracks.known is None or tracks.foreseen is None:
        return position
    seen = rows[:, :obs_len]
    late = tracks.known[seen] > tracks.stamp[seen[:, -1:]] + 2 * SNAP
    position[:, :obs_len][late] = tracks.foreseen[seen[late]]
    return position


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Padded scenes of one bucket of sizes, filled up with empty scenes (no valid agent)."""

    scene: Scene  # arrays with a leading axis of B scenes and N = bucket agent slots
    index: np.ndarray
    """[B] int64 index of each scene in the windows; -1 for an empty scene."""


def bucket_of(agents: np.ndarray | int) -> np.ndarray:
    """Padded size of scenes with `agents` [...] agents: a power of two, at least 4; for more than
    1,024 a multiple of these."""
    agents = np.asarray(agents)
    exponent = np.ceil(np.log2(np.clip(agents, 4, 1024)))
    power = 2 ** exponent.astype(int)
    multiple = -(-agents // 1024) * 1024  # rounded up
    return np.where(agents > 1024, multiple, power)


def make_batches(windows: Windows, slots: int = 1024) -> list[Batch]:
    """All scenes of `windows`, each in exactly one batch of about `slots` agent slots."""
    buckets = bucket_of(windows.sizes)
    batches = []
    for bucket in np.unique(buckets):
        chosen = np.flatnonzero(buckets == bucket)
        size = max(1, slots // bucket)
        for at in range(0, len(chosen), size):
            part = chosen[at : at + size]
            index = np.full(size, -1)
            index[: len(part)] = part
            scene = gather_scenes(windows, part, int(bucket), size)
            batches.append(Batch(scene, index))
    return batches


def single_scene(windows: Windows, index: int) -> Scene:
    """Scene `index` of `windows`, padded to its bucket, with the same numbers as in its batch."""
    slots = int(bucket_of(windows.sizes[index]))
    scenes = gather_scenes(windows, np.array([index]), slots)
    return jax.tree.map(lambda array: array[0], scenes)


def gather_scenes(
    windows: Windows, chosen: np.ndarray, slots: int, count: int | None = None
) -> Scene:
    """The scenes `chosen` ([S] indices, repeats allowed), each padded to `slots` agent slots, and
    empty scenes up to `count`, as one Scene with a leading axis."""
    count = len(chosen) if count is None else count
    sizes = windows.sizes[chosen]
    scene = np.repeat(np.arange(len(chosen)), sizes)
    rows = windows.rows(chosen)
    slot = rows - windows.bounds[chosen][scene]
    position = windows.position[rows]
    last = position[:, windows.obs_len - 1]
    first = _bounds(sizes)[:-1]
    low = np.minimum.reduceat(last, first)
    high = np.maximum.reduceat(last, first)
    origin = np.zeros((count, 2))
    origin[: len(chosen)] = (low + high) / 2  # As `make_scene`.
    step = displacements(position[:, : windows.obs_len])
    position = relative_positions(position, origin[scene, None])

    def padded(values: np.ndarray, dtype: np.dtype | None = None) -> np.ndarray:
        shape = (count, slots, *values.shape[1:])
        out = np.zeros(shape, dtype or values.dtype)
        out[scene, slot] = values
        return out

    identity = np.zeros((count, 2), np.uint32)
    identity[: len(chosen)] = windows.identity[chosen]
    return Scene(
        observed=padded(position[:, : windows.obs_len], model_dtype()),
        displacement=padded(step, model_dtype()),
        valid=padded(np.ones(len(rows), bool)),
        identity=identity,
        origin=origin,
        future=padded(position[:, windows.obs_len :], model_dtype()),
        period=round(float(windows.period), 6),
        seen=None if windows.seen is None else padded(windows.seen[rows]),
        extras={name: padded(extra[rows]) for name, extra in windows.extras.items()},
    )


# Whether windows were among those that a model was trained on, by their shapes.
#
# A model keeps hashes of some of its training windows: the rounded moves between eight
# positions that go some way and are not straight. A copy is found whatever its name, ids,
# frames, unit or origin are, and where its positions were rounded to millimetres or
# centimetres: cells are wider, and moves last two steps where windows are long enough.

POINTS = (
    8  # positions of a shape, observed and predicted; models of all horizons share it
)
CELL = 0.05  # metres a step to which moves are rounded
FINE_CELL = 0.01  # the same in windows of fewer positions
OFFSET = 0.35555  # of the cells' bounds, so that no move in tenths of millimetres lies on one
KEPT = 512  # hashes that a model keeps: the smallest
BYTES = 6  # of a hash
VERSION = "2:"  # in front of a fingerprint: shapes of another kind cannot be compared
ALIKE = 0.01  # share of shapes that people who are not the same may have in common
_SPLITMIX64 = (
    (30, 0xBF58476D1CE4E5B9),
    (27, 0x94D049BB133111EB),
)
"""Shifts and factors of the last two steps of splitmix64."""


def fingerprint(windows: Windows) -> str:
    """The smallest `KEPT` hashes of the shapes in `windows`, in base64; at most 4 kB."""
    return _encoded(_hashes(windows))


def merged_fingerprints(*stored: str) -> str:
    """The fingerprint of all windows of several."""
    return _encoded(np.unique(np.concatenate([*map(_decoded, stored)])))


def _encoded(hashes: np.ndarray) -> str:
    data = hashes[:KEPT].astype(">u8").view(np.uint8).reshape(-1, 8)
    return VERSION + base64.b64encode(data[:, 8 - BYTES :].tobytes()).decode()


def _decoded(stored: str) -> np.ndarray:
    text = stored.removeprefix(VERSION)
    data = np.frombuffer(base64.b64decode(text), np.uint8).reshape(-1, BYTES)
    words = np.zeros((len(data), 8), np.uint8)
    words[:, 8 - BYTES :] = data
    return words.view(">u8").ravel().astype(np.uint64)


def seen_before(stored: str, windows: Windows) -> tuple[int, int]:
    """How many shapes in `windows` are in a fingerprint, and how many were looked for there."""
    stored_hashes = _decoded(stored)
    hashes = _hashes(windows)
    if len(stored_hashes) == KEPT:
        hashes = hashes[hashes <= stored_hashes.max()]
    is_stored = np.isin(hashes, stored_hashes)
    return int(is_stored.sum()), len(hashes)


def shared_shapes(windows: Windows, others: Windows) -> tuple[int, int]:
    """How many shapes in `windows` are in `others`, and how many there are."""
    hashes = _hashes(windows)
    is_shared = np.isin(hashes, _hashes(others))
    return int(is_shared.sum()), len(hashes)


def chance_shapes(windows: Windows) -> float:
    """The share of shapes in `windows` that another person of the same recording has too.

    Where positions are rounded coarsely, people who are not the same move alike by
    chance: about this share of other people's shapes is found in `windows`. Copies of a
    whole recording do not raise it.
    """
    hashes, rows = _shapes(windows)
    recording = np.repeat(windows.identity[:, 0], windows.sizes)[rows]
    _, person = np.unique(windows.agent[rows], return_inverse=True)
    person = person.astype(np.uint64)
    people = np.unique(np.stack([hashes, recording, person]), axis=1)
    _, counts = np.unique(people[:2], axis=1, return_counts=True)
    shared = counts[counts > 1].sum()
    return float(shared / max(counts.sum(), 1))


def is_fingerprint(value: object) -> bool:
    """Whether a value read from a file is what `fingerprint` returns."""
    pattern = rf"({VERSION})?([A-Za-z0-9+/]{{8}}){{0,{KEPT}}}"
    return isinstance(value, str) and re.fullmatch(pattern, value) is not None


def _hashes(windows: Windows) -> np.ndarray:
    """[H] uint64 below 2^48, ascending: one for each shape that tells something."""
    return np.unique(_shapes(windows)[0])


def _shapes(windows: Windows) -> tuple[np.ndarray, np.ndarray]:
    """[R] uint64 below 2^48, and [R] their agent windows: of shapes that tell something."""
    stride = 1
    if windows.position.shape[1] >= 2 * POINTS:
        stride = 2
    points = windows.position[:, : stride * POINTS : stride]
    moves = np.diff(points, axis=1) / stride
    # Few moves in wide cells are alike by chance.
    width = CELL if points.shape[1] == POINTS else FINE_CELL
    cells = np.floor(moves / width + OFFSET).astype(np.int64)
    far = np.linalg.norm(moves, axis=-1).sum(axis=1) > 1.0
    # Straight ways at one pace, as annotators draw them, are alike in many recordings.
    is_turn = np.any(np.diff(cells, axis=1) != 0, axis=-1)
    turns = np.sum(is_turn, axis=1)
    rows = np.flatnonzero(far & (turns >= POINTS - 3))
    columns = cells.shape[1] * 2
    chosen = cells[rows].reshape(len(rows), columns).astype(np.uint64)
    random = np.random.default_rng(0)
    factors = random.integers(1, 2**63, columns, np.uint64) * 2 + 1
    mixed = (chosen * factors).sum(axis=1, dtype=np.uint64)
    for shift, factor in _SPLITMIX64:
        mixed ^= mixed >> np.uint64(shift)
        mixed *= np.uint64(factor)
    return mixed >> np.uint64(16), rows
