"""Windows of people who are present together, SGAN's exactly, and batches of their scenes.

A window spans `obs_len + pred_len` consecutive steps of its recording and holds the
agents seen at every one of them. Its observed part depends on nothing recorded later.
Batches are padded to a few static shapes, so that compilation stays cheap.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Self

import jax
import numpy as np

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.tracks import PERIOD, SNAP, Reading, Tracks, common
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
    "cut_windows",
    "gather_scenes",
    "make_batches",
]
__all__ += ["single_scene"]


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one or more recordings: A agent windows, grouped into S scenes."""

    position: (
        np.ndarray
    )  # [A, obs_len + pred_len, 2] float64 metres in the recording's frame
    agent: np.ndarray  # [A] int64 agent ids
    bounds: (
        np.ndarray
    )  # [S + 1] int64; scene s holds the rows `bounds[s]:bounds[s + 1]`
    identity: np.ndarray  # [S, 2] uint32 (recording digest, index of the first stamp)
    obs_len: int  # observed steps; the others are the future
    period: float = PERIOD  # seconds between steps
    reading: tuple[Reading, ...] = ()  # how each recording was read
    extras: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """name: [A, ...] further numbers of each agent window, at the last observed step."""
    stamp: np.ndarray | None = None
    """[S] float64 seconds of the last observed step, on the recording's clock, where it has one."""

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
        return np.repeat(self.bounds[scenes] - before, sizes) + np.arange(sizes.sum())

    def take(self, scenes: np.ndarray | slice) -> Self:
        """Select scenes: [S] bool mask, [S'] indices (any order, repeats allowed), or a slice."""
        chosen = np.arange(self.scenes)[scenes]
        rows = self.rows(chosen)
        return dataclasses.replace(
            self,
            position=self.position[rows],
            agent=self.agent[rows],
            bounds=np.concatenate([[0], np.cumsum(self.sizes[chosen])]),
            identity=self.identity[chosen],
            stamp=None if self.stamp is None else self.stamp[chosen],
            extras={name: values[rows] for name, values in self.extras.items()},
        )


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

    Raises: InputError: for a number below 1, or if there is no window, a recording is
        on no grid, or
            recordings do not match.
    """
    lengths = {"obs_len": obs_len, "pred_len": pred_len}
    refuse(Count, {**lengths, "skip": skip, "min_agents": min_agents})
    recordings = list(recordings)
    names = ", ".join(tracks.recording for tracks in recordings[:3]) or "no recordings"
    periods = [period for tracks in recordings if (period := _period(tracks)) < np.inf]
    if periods and max(periods) - min(periods) > 0.01 * min(periods):
        raise InputError(
            f"{names}: steps of {min(periods):g} to {max(periods):g} s: choose one"
        )
    if len({frozenset(tracks.extras) for tracks in recordings}) > 1:
        raise InputError(f"{names}: their extras differ")
    parts = [_cut(tracks, obs_len, pred_len, skip, min_agents) for tracks in recordings]
    if not any(part.scenes for part in parts):
        raise InputError(
            f"{names}: no {obs_len + pred_len} consecutive steps have at least {min_agents} people "
            f"throughout (longer gaps than {option('max_gap')} are not filled)"
        )
    sizes = np.concatenate([part.sizes for part in parts])
    return Windows(
        position=np.concatenate([part.position for part in parts]),
        agent=np.concatenate([part.agent for part in parts]),
        bounds=np.concatenate([[0], np.cumsum(sizes)]),
        identity=np.concatenate([part.identity for part in parts]),
        obs_len=obs_len,
        period=common(np.array(periods)) if periods else PERIOD,
        reading=tuple(reading for part in parts for reading in part.reading),
        extras={
            name: np.concatenate([part.extras[name] for part in parts])
            for name in parts[0].extras
        },
        stamp=np.concatenate([part.stamp for part in parts if part.stamp is not None]),
    )


def _period(tracks: Tracks) -> float:
    """Seconds of one step; infinite if there is only one."""
    steps = np.diff(np.unique(tracks.stamp)).round(6)
    return tracks.period or (max(common(steps), SNAP) if len(steps) else np.inf)


def _cut(
    tracks: Tracks, obs_len: int, pred_len: int, skip: int, min_agents: int
) -> Windows:
    """The windows of one recording, possibly none."""
    length = obs_len + pred_len
    exact = (tracks.stamp - tracks.stamp.min()) / _period(tracks)
    # Two agents' stamps may be rounded differently on one grid.
    place = np.rint(exact) if tracks.step is None else tracks.step
    if tracks.step is None and np.any(np.abs(exact - place) > 0.05):
        raise InputError(
            f"{tracks.recording}: its stamps are on no one grid: use data.on_grid"
        )
    places, step = np.unique(place, return_inverse=True)
    # Rows are sorted by (id, stamp) without duplicates, so `length` rows of one id that
    # span `length - 1` steps are all there.
    last = np.arange(length - 1, len(step))
    first = last - (length - 1)
    is_complete = (tracks.id[first] == tracks.id[last]) & (
        place[last] - place[first] == length - 1
    )
    first = first[is_complete & (step[first] % skip == 0)]
    first = first[np.argsort(step[first], kind="stable")]

    starts, sizes = np.unique(step[first], return_counts=True)
    enough = sizes >= min_agents
    first = first[np.repeat(enough, sizes)]
    rows = first[:, None] + np.arange(length)
    position = tracks.position[rows]
    interpolated = 0
    if tracks.known is not None and tracks.foreseen is not None:
        used = np.unique(rows)
        interpolated = int(np.sum(tracks.known[used] > tracks.stamp[used]))
        # Observed points that depend on later observations become what was foreseen.
        seen = rows[:, :obs_len]
        late = tracks.known[seen] > tracks.stamp[seen[:, -1:]] + 2 * SNAP
        position[:, :obs_len][late] = tracks.foreseen[seen[late]]
    reading = tracks.reading or Reading(tracks.recording, rows=len(tracks.id))
    gaps = int(np.sum(np.diff(places) > 1))
    return Windows(
        position=position,
        agent=tracks.id[first],
        bounds=np.append(0, np.cumsum(sizes[enough])),
        identity=scene_identity(tracks.recording, starts[enough]),
        obs_len=obs_len,
        reading=(dataclasses.replace(reading, gaps=gaps, interpolated=interpolated),),
        extras={
            name: values[first + obs_len - 1] for name, values in tracks.extras.items()
        },
        stamp=tracks.stamp[first + obs_len - 1][
            np.cumsum(sizes[enough]) - sizes[enough]
        ],
    )


@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Padded scenes of one bucket of sizes, filled up with empty scenes (no valid agent)."""

    scene: Scene  # arrays with a leading axis of B scenes and N = bucket agent slots
    index: (
        np.ndarray
    )  # [B] int64 index of each scene in the windows; -1 for an empty scene


def bucket_of(agents: np.ndarray | int) -> np.ndarray:
    """Padded size of scenes with `agents` [...] agents: a power of two, at least 4; for more than
    1,024 a multiple of these."""
    power = 2 ** np.ceil(np.log2(np.clip(agents, 4, 1024))).astype(int)
    return np.where(
        np.asarray(agents) > 1024, -(-np.asarray(agents) // 1024) * 1024, power
    )


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
            batches.append(
                Batch(gather_scenes(windows, part, int(bucket), size), index)
            )
    return batches


def single_scene(windows: Windows, index: int) -> Scene:
    """Scene `index` of `windows`, padded to its bucket, with the same numbers as in its batch."""
    slots = int(bucket_of(windows.sizes[index]))
    return jax.tree.map(
        lambda array: array[0], gather_scenes(windows, np.array([index]), slots)
    )


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
    origin = np.zeros((count, 2))
    first = np.cumsum(sizes) - sizes
    low, high = np.minimum.reduceat(last, first), np.maximum.reduceat(last, first)
    origin[: len(chosen)] = (low + high) / 2  # As `make_scene`.
    step = displacements(position[:, : windows.obs_len])
    position = relative_positions(position, origin[scene, None])

    def padded(values: np.ndarray, dtype: np.dtype | None = None) -> np.ndarray:
        out = np.zeros((count, slots, *values.shape[1:]), dtype or values.dtype)
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
        extras={name: padded(extra[rows]) for name, extra in windows.extras.items()},
    )
