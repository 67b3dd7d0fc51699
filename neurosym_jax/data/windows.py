"""Cut recordings into windows of people who are present together: SGAN's windows, exactly.

A window spans `obs_len + pred_len` consecutive steps of its recording and holds the agents seen at
every one of them. It never crosses a gap in time, a step longer than the recording's own. (SGAN's
loader would cross one, but no window of ETH/UCY does.) Its observed part depends on nothing
recorded later. Windows are stored agent by agent; `data.batching` pads scenes.
"""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from neurosym_jax.data.reading import Reading
from neurosym_jax.data.tracks import PERIOD, SNAP, Tracks, common
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.scene import scene_identity

__all__ = ["Windows", "cut_windows"]


@dataclasses.dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one or more recordings: A agent windows, grouped into S scenes."""

    position: np.ndarray
    """[A, obs_len + pred_len, 2] float64 metres in the recording's frame."""
    agent: np.ndarray
    """[A] int64 agent ids."""
    bounds: np.ndarray
    """[S + 1] int64; scene s holds the agent windows `bounds[s]:bounds[s + 1]`."""
    identity: np.ndarray
    """[S, 2] uint32 (recording digest, index of the first stamp)."""
    obs_len: int
    """Observed steps; the others are the future."""
    period: float = PERIOD
    """Seconds between steps."""
    reading: tuple[Reading, ...] = ()
    """How each recording was read, and its runs and gaps in time."""
    extras: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    """name: [A, ...] further numbers of each agent window, at the last observed step."""

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
        """Select scenes, with everything that belongs to them.

        Args:
            scenes: [S] bool mask, [S'] indices (in any order, repeats allowed), or a slice.
        """
        chosen = np.arange(self.scenes)[scenes]
        rows = self.rows(chosen)
        return dataclasses.replace(
            self,
            position=self.position[rows],
            agent=self.agent[rows],
            bounds=np.concatenate([[0], np.cumsum(self.sizes[chosen])]),
            identity=self.identity[chosen],
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

    Args:
        recordings: track tables, each on one grid; see `tracks.on_grid`.
        obs_len: observed steps.
        pred_len: steps to forecast.
        skip: a window starts at every `skip`-th step at which anybody is seen.
        min_agents: scenes with fewer agents are dropped; SGAN keeps scenes of at least 2.

    Raises:
        InputError: if there is no window, a recording is on no grid, or the recordings differ in
            their period or in the names of their extras.
    """
    recordings = list(recordings)
    clocks = [_clock(tracks) for tracks in recordings]
    periods = [clock.period for clock in clocks if clock.period is not None]
    if periods and max(periods) - min(periods) > 0.01 * min(periods):
        unlike = ", ".join(f"{period:g}" for period in sorted(set(periods))[:4])
        raise InputError(f"recordings with steps of {unlike} s: bring them to one period first")
    for tracks in recordings:
        if odd := tracks.extras.keys() ^ recordings[0].extras.keys():
            names = f"{recordings[0].recording}, {tracks.recording}"
            raise InputError(f"{names}: only one of them has the extra {min(odd)!r}")
    parts = [
        _cut(tracks, clock, obs_len, pred_len, skip, min_agents)
        for tracks, clock in zip(recordings, clocks)
    ]
    if not any(part.scenes for part in parts):
        raise InputError(_why_none(recordings, clocks, obs_len + pred_len, min_agents))
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
            name: np.concatenate([part.extras[name] for part in parts]) for name in parts[0].extras
        },
    )


class Clock(NamedTuple):
    """The steps of a recording at which anybody is seen."""

    step: np.ndarray
    """[R] index of each row's step."""
    run: np.ndarray
    """[K] run of each step; a gap in time begins a new run."""
    period: float | None
    """Seconds of one step; None if there is only one."""


def _clock(tracks: Tracks) -> Clock:
    if tracks.period is not None:
        # Two agents' stamps may be rounded differently on one grid.
        place = np.rint((tracks.stamp - tracks.stamp.min()) / tracks.period)
        places, step = np.unique(place, return_inverse=True)
        return Clock(step, np.append(0, np.cumsum(np.diff(places) > 1)), tracks.period)
    stamps, step = np.unique(tracks.stamp, return_inverse=True)
    steps = np.diff(stamps)
    if not len(steps):
        return Clock(step, np.zeros(1, int), None)
    period = common(steps.round(6))
    count = steps / period if period else np.zeros(len(steps))
    if np.any((np.abs(count - np.rint(count)) > 0.01) | (count < 0.5)):
        raise InputError(
            f"{tracks.recording}: its stamps are on no one grid: resample it first, with "
            "data.on_grid or data.windows_from"
        )
    return Clock(step, np.append(0, np.cumsum(count > 1.5)), period)


def _cut(
    tracks: Tracks, clock: Clock, obs_len: int, pred_len: int, skip: int, min_agents: int
) -> Windows:
    """The windows of one recording, possibly none."""
    length = obs_len + pred_len
    step, run, _ = clock
    # Rows are sorted by (id, stamp) without duplicates, so `length` rows of one id that span
    # `length - 1` steps of one run are all there.
    last = np.arange(length - 1, len(step))
    first = last - (length - 1)
    whole = (tracks.id[first] == tracks.id[last]) & (step[last] - step[first] == length - 1)
    whole &= run[step[first]] == run[step[last]]
    first = first[whole & (step[first] % skip == 0)]
    first = first[np.argsort(step[first], kind="stable")]

    starts, sizes = np.unique(step[first], return_counts=True)
    enough = sizes >= min_agents
    first = first[np.repeat(enough, sizes)]
    refuse_beyond_memory(
        f"{tracks.recording}: windows of {length} steps", 64.0 * len(first) * length, "shorten them"
    )
    rows = first[:, None] + np.arange(length)
    position = tracks.position[rows]
    if tracks.known is not None and tracks.foreseen is not None:
        # Observed points that depend on later observations become what was foreseen.
        seen = rows[:, :obs_len]
        late = tracks.known[seen] > tracks.stamp[seen[:, -1:]] + 2 * SNAP
        position[:, :obs_len][late] = tracks.foreseen[seen[late]]
    reading = tracks.reading or Reading(tracks.recording, rows=len(tracks.id))
    gaps = int(run[-1])
    return Windows(
        position=position,
        agent=tracks.id[first],
        bounds=np.append(0, np.cumsum(sizes[enough])),
        identity=scene_identity(tracks.recording, starts[enough]),
        obs_len=obs_len,
        reading=(dataclasses.replace(reading, runs=gaps + 1, gaps=gaps),),
        extras={name: values[first + obs_len - 1] for name, values in tracks.extras.items()},
    )


def _why_none(
    recordings: Sequence[Tracks], clocks: Sequence[Clock], length: int, min_agents: int
) -> str:
    if not recordings:
        return "no recordings to cut windows from"
    names = ", ".join(tracks.recording for tracks in recordings[:3])
    longest = max(int(np.bincount(clock.run).max()) for clock in clocks)
    if longest >= length:
        return (
            f"{names}: no {length} consecutive frames have at least {min_agents} people throughout"
        )
    for tracks, clock in zip(recordings, clocks):
        steps = np.diff(np.unique(tracks.stamp))
        if clock.period is not None and len(steps) and np.median(steps) > 1.5 * clock.period:
            return (
                f"{tracks.recording}: its points are {np.median(steps):g} s apart, and gaps longer "
                f"than --max-gap are not filled: ask for that --period, or say the times' unit"
            )
    gaps = sum(int(clock.run[-1]) for clock in clocks)
    between = f" between {gaps} gaps in time" if gaps else ""
    return f"{names}: too few frames: {longest}{between} where a window needs {length}"
