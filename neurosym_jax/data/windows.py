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
from neurosym_jax.data.tracks import PERIOD, SNAP, Reading, Tracks, common, fields_at
from neurosym_jax.errors import InputError, NoWindowsError, option
from neurosym_jax.scene import (
    WIDEST,
    Scene,
    displacements,
    model_dtype,
    origin_of,
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
    "seen_before",
    "shared_shapes",
    "single_scene",
]


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
        index = np.arange(self.scenes)[scenes]
        rows = self.rows(index)
        return dataclasses.replace(
            self,
            bounds=_bounds(self.sizes[index]),
            extras={name: values[rows] for name, values in self.extras.items()},
            **fields_at(self, ("position", "agent", "seen"), rows),
            **fields_at(self, ("identity", "stamp"), index),
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
        NoWindowsError: if there is no window.
        InputError: for a number below 1, or if a recording is on no grid, or recordings
            do not match.
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
        longest = max(map(_longest_run, recordings), default=0)
        steps = f"{obs_len + pred_len} consecutive steps"
        if longest < obs_len + pred_len:
            hint = f"nobody is in view for more than {longest}; evaluate and train take shorter "
            hint += f"windows by {option('obs_len')} and {option('pred_len')}"
        else:
            hint = "some people are, with too few others"
        raise NoWindowsError(
            f"{names}: no {steps} have at least {min_agents} people throughout: {hint} (longer "
            f"gaps than {option('max_gap')} are not filled)"
        )
    windows = _joined(parts)
    if not periods:
        return windows
    return dataclasses.replace(windows, period=common(np.array(periods)))


def _joined(parts: list[Windows]) -> Windows:
    """The windows of several recordings, one after the other."""
    arrays = {}
    for name in ("position", "identity", "stamp"):
        arrays[name] = np.concatenate([getattr(part, name) for part in parts])
    extras = {}
    for name in parts[0].extras:
        extras[name] = np.concatenate([part.extras[name] for part in parts])
    return Windows(
        # Ids of a recording without windows may be of another kind.
        agent=np.concatenate([part.agent for part in parts if part.scenes]),
        bounds=_bounds(np.concatenate([part.sizes for part in parts])),
        obs_len=parts[0].obs_len,
        reading=tuple(itertools.chain(*(part.reading for part in parts))),
        extras=extras,
        **arrays,
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


def _longest_run(tracks: Tracks) -> int:
    """The most consecutive steps at which one agent is seen."""
    if not len(tracks.id):
        return 0
    same_agent = tracks.id[1:] == tracks.id[:-1]
    ends = ~(same_agent & (np.diff(_places(tracks)) == 1))
    borders = np.flatnonzero(np.concatenate([[True], ends, [True]]))
    return int(np.diff(borders).max())


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
            index = np.pad(part, (0, size - len(part)), constant_values=-1)
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
    empty = ((0, count - len(chosen)), (0, 0))
    origin = np.pad(_origins(last, sizes), empty)
    step = displacements(position[:, : windows.obs_len])
    position = relative_positions(position, origin[scene, None])

    def padded(values: np.ndarray, dtype: np.dtype | None = None) -> np.ndarray:
        shape = (count, slots, *values.shape[1:])
        out = np.zeros(shape, dtype or values.dtype)
        out[scene, slot] = values
        return out

    return Scene(
        observed=padded(position[:, : windows.obs_len], model_dtype()),
        displacement=padded(step, model_dtype()),
        valid=padded(np.ones(len(rows), bool)),
        identity=np.pad(windows.identity[chosen], empty),
        origin=origin,
        future=padded(position[:, windows.obs_len :], model_dtype()),
        period=round(float(windows.period), 6),
        seen=None if windows.seen is None else padded(windows.seen[rows]),
        extras={name: padded(extra[rows]) for name, extra in windows.extras.items()},
    )


def _origins(last: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """[S, 2] `origin_of` of scenes of `sizes [S]` agents, at their `last [A, 2]` positions."""
    first = _bounds(sizes)[:-1]
    low = np.minimum.reduceat(last, first)
    high = np.maximum.reduceat(last, first)
    origin = (low + high) / 2
    for number in np.flatnonzero((high - low).max(axis=1) > WIDEST):
        begin = first[number]
        origin[number] = origin_of(last[begin : begin + sizes[number]])
    return origin


# Whether windows were among those that a model was trained on, by their shapes.
#
# A model keeps hashes of some of its training windows: the rounded moves between eight
# positions that go some way and are not straight. A copy is found whatever its name, ids,
# frames, unit or origin are, where its positions were rounded to millimetres or
# centimetres (cells are wider, and moves last two steps where windows are long enough),
# and where it was resampled between its steps.

POINTS = (
    8  # positions of a shape, observed and predicted; models of all horizons share it
)
CELL = 0.05  # metres a step to which moves are rounded
FINE_CELL = 0.01  # the same in windows of fewer positions
OFFSET = 0.35555  # of the cells' bounds, so that no move in tenths of millimetres lies on one
PHASES = (0.0, 0.25, 0.5, 0.75)  # of a step, at which copies are looked for
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
    data = base64.b64decode(stored.removeprefix(VERSION))
    words = np.frombuffer(data, np.uint8).reshape(-1, BYTES)
    words = np.pad(words, ((0, 0), (8 - BYTES, 0)))
    return words.view(">u8").ravel().astype(np.uint64)


def seen_before(stored: str, windows: Windows) -> tuple[int, int]:
    """How many shapes in `windows` are in a fingerprint, and how many were looked for there.

    A copy may have been resampled between the steps of the original: of several phases
    the one at which most are found counts.
    """
    if not stored:  # A network without a fingerprint: nothing is to be looked for.
        return 0, 0
    stored_hashes = _decoded(stored)
    counts = []
    for phase in PHASES:
        hashes = _hashes(windows, phase)
        if len(stored_hashes) == KEPT:
            hashes = hashes[hashes <= stored_hashes.max()]
        counts.append((int(np.isin(hashes, stored_hashes).sum()), len(hashes)))
    return max(counts)


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


def _hashes(windows: Windows, phase: float = 0.0) -> np.ndarray:
    """[H] uint64 below 2^48, ascending: one for each shape that tells something."""
    return np.unique(_shapes(windows, phase)[0])


def _shapes(windows: Windows, phase: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """[R] uint64 below 2^48, and [R] their agent windows: of shapes that tell something, at so many
    steps after the windows' own."""
    length = windows.position.shape[1]
    stride = 2 if length >= 2 * POINTS else 1
    at = np.arange(0, min(stride * POINTS, length), stride)
    points = windows.position[:, at]
    later = windows.position[:, np.minimum(at + 1, length - 1)]
    points = points + phase * (later - points)
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
