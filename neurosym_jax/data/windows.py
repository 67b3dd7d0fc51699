"""Cut recordings into windows of people who are present together: SGAN's windows, exactly.

A window spans `obs_len + pred_len` consecutive stamps of its recording (gaps in time included, as
in SGAN) and holds the agents seen at every one of them. What is observed in it depends on nothing
that was recorded later. Windows are stored agent by agent, without padding; `data.batching` makes
padded scenes of them.
"""

import dataclasses
from collections.abc import Iterable

import numpy as np

from neurosym_jax.data.tracks import SNAP, Tracks, common
from neurosym_jax.errors import InputError
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
    """Observed steps; the rest is the future."""
    period: float = 0.4
    """Seconds between steps: the most common between stamps."""

    @property
    def scenes(self) -> int:
        """Number of scenes."""
        return len(self.bounds) - 1

    @property
    def agents(self) -> int:
        """Number of agent windows, the sum over scenes of their agents."""
        return len(self.position)

    @property
    def sizes(self) -> np.ndarray:
        """[S] agents per scene."""
        return np.diff(self.bounds)


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
        recordings: track tables whose unique stamps are the time steps.
        obs_len: observed steps.
        pred_len: steps to forecast.
        skip: a window starts at every `skip`-th stamp.
        min_agents: scenes with fewer agents are dropped; SGAN keeps scenes of at least 2.

    Raises:
        InputError: when no recording is long enough, or nobody stays for a whole window.
    """
    recordings = list(recordings)
    parts = [_cut(tracks, obs_len, pred_len, skip, min_agents) for tracks in recordings]
    sizes = np.concatenate([sizes for _, _, sizes, *_ in parts]) if parts else np.zeros(0, int)
    if len(sizes) == 0:
        raise InputError(_why_none(recordings, obs_len + pred_len, min_agents))
    return Windows(
        position=np.concatenate([position for position, *_ in parts]),
        agent=np.concatenate([agent for _, agent, *_ in parts]),
        bounds=np.concatenate([[0], np.cumsum(sizes)]),
        identity=np.concatenate([identity for *_, identity, _ in parts]),
        obs_len=obs_len,
        period=common(np.concatenate([steps for *_, steps in parts]).round(6)),
    )


def _cut(tracks: Tracks, obs_len: int, pred_len: int, skip: int, min_agents: int):
    """One recording's (position, agent, sizes, identity, seconds between its stamps)."""
    length = obs_len + pred_len
    stamps, step = np.unique(tracks.stamp, return_inverse=True)
    # Rows are sorted by (id, stamp) without duplicates, so `length` rows of one id that span
    # `length - 1` steps are all there.
    last = np.arange(length - 1, len(step))
    first = last - (length - 1)
    whole = (tracks.id[first] == tracks.id[last]) & (step[last] - step[first] == length - 1)
    first = first[whole & (step[first] % skip == 0)]
    first = first[np.argsort(step[first], kind="stable")]

    starts, sizes = np.unique(step[first], return_counts=True)
    enough = sizes >= min_agents
    first = first[np.repeat(enough, sizes)]
    position = tracks.position[first[:, None] + np.arange(length)]
    _forget_the_future(position[:, :obs_len], tracks, first[:, None] + np.arange(obs_len))
    identity = scene_identity(tracks.recording, starts[enough])
    return position, tracks.id[first], sizes[enough], identity, np.diff(stamps)


def _forget_the_future(observed: np.ndarray, tracks: Tracks, rows: np.ndarray) -> None:
    """Put what rests on observations after the window's last observed step where it was foreseen.

    `observed [A, obs_len, 2]` are the positions of the tracks' `rows [A, obs_len]`.
    """
    if tracks.known is None or tracks.foreseen is None:
        return
    late = tracks.known[rows] > tracks.stamp[rows[:, -1:]] + 2 * SNAP
    observed[late] = tracks.foreseen[rows[late]]


def _why_none(recordings: list[Tracks], length: int, min_agents: int) -> str:
    if not recordings:
        return "no recordings to cut windows from"
    names = ", ".join(tracks.recording for tracks in recordings[:3])
    longest = max(len(np.unique(tracks.stamp)) for tracks in recordings)
    if longest < length:
        return f"{names}: too few frames: {longest} where a window needs {length}"
    return f"{names}: no {length} consecutive frames have at least {min_agents} people throughout"
