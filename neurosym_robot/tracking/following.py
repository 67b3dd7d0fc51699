"""Frames of people, tracks of them, and ids for people who have none."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.data.windows import resample
from neurosym_jax.errors import InputError

FAR = 3000.0  # metres; the original robot's filter puts lost people at (-3000, -3000)
# seconds: a stamp older by more means a clock set back, also if it comes alone
RESET = 5.0
MAX_SPEED = 5.0  # metres per second of a person between two observations
SLACK = 1.0  # metres of error of a tracker, both observations together
SMOOTH = 0.7  # share of the old velocity kept from frame to frame: noise is as large as a step
REACH = 0.75  # maximum metres from the expected position
FORGET = 1.0  # seconds after which a person without id who was not seen gets a new id
# people without ids followed at once; the others get new ids in every frame
CROWD = 512


class Frame(NamedTuple):
    """Everybody seen at one moment, as `Predictor.push` takes it."""

    stamp: float
    """Seconds, of the message's header."""
    ids: np.ndarray
    """[N] int64."""
    xy: np.ndarray
    """[N, 2] float64 world metres."""


def synchronous(tracks: Tracks) -> Tracks:
    """The tracks, resampled to one clock if agents have clocks of their own."""
    frames = np.unique(tracks.stamp)
    steps = np.diff(tracks.stamp)[np.diff(tracks.id) == 0]
    if len(steps) and np.median(np.diff(frames)) < 0.5 * np.median(steps):
        return resample(tracks, float(np.median(steps)))
    return tracks


def frames_of_tracks(tracks: Tracks) -> Iterator[Frame]:
    """Everybody at each stamp, of `synchronous` tracks."""
    tracks = synchronous(tracks)
    order = np.lexsort((tracks.id, tracks.stamp))
    starts = np.flatnonzero(np.diff(tracks.stamp[order])) + 1
    for rows in np.split(order, starts) if len(order) else ():
        yield Frame(
            float(tracks.stamp[rows[0]]), tracks.id[rows], tracks.position[rows]
        )


def tracks_of_frames(frames: Iterator[Frame], recording: str = "") -> Tracks:
    """Tracks of a stream.

    Raises:
        InputError: without people, or for frames that `make_tracks` refuses.
    """
    populated = [frame for frame in frames if len(frame.ids)]
    if not populated:
        raise InputError(f"{recording}: nobody in it")
    return make_tracks(
        recording,
        np.repeat(
            [frame.stamp for frame in populated],
            [len(frame.ids) for frame in populated],
        ),
        np.concatenate([frame.ids for frame in populated]),
        np.concatenate([frame.xy for frame in populated]),
    )


def is_jump(moved: Any, gap: Any) -> Any:
    """Whether a person cannot have `moved` [...] metres in `gap` [...] seconds."""
    return moved > MAX_SPEED * gap + SLACK


class NearestIds:
    """Ids, counted from 0, for positions without ids: each continues the nearest expected one."""

    def __init__(self):
        self._next, self._stamp = 0, -np.inf
        self._ids = np.zeros(0, np.int64)
        # [P, 5] of each: seconds of the newest point, metres; metres per second, NaN at
        # first.
        self._newest = np.zeros((0, 5))

    def push(self, stamp: float, xy: ArrayLike) -> np.ndarray:
        """[N] int64 ids of positions [N, 2] in metres; a clock set back begins anew."""
        xy = np.asarray(xy, np.float64).reshape(-1, 2)
        ids = np.full(len(xy), -1)
        if np.isfinite(stamp) and stamp != self._stamp:
            is_recent = (stamp - self._newest[:, 0] <= FORGET) & (stamp > self._stamp)
            self._ids, self._newest = self._ids[is_recent], self._newest[is_recent]
            self._stamp = stamp
            near = np.flatnonzero((np.abs(xy) < FAR).all(axis=1))
            self._follow(ids, near[:CROWD], xy)
        ids[ids < 0] = self._next + np.arange((ids < 0).sum())
        self._next = max(self._next, int(ids.max(initial=-1)) + 1)
        return ids

    def _follow(self, ids: np.ndarray, near: np.ndarray, xy: np.ndarray) -> None:
        """Write the ids of the people `near`, at `xy`, who go on or are new."""
        gap = self._stamp - self._newest[:, :1]
        expected = self._newest[:, 1:3] + gap * np.nan_to_num(self._newest[:, 3:])
        off = np.linalg.norm(xy[near] - expected[:, None], axis=-1)
        row, person = linear_sum_assignment(np.where(off <= REACH, off, 1e6))
        row, person = (part[off[row, person] <= REACH] for part in (row, person))
        moved = (xy[near[person]] - self._newest[row, 1:3]) / gap[row]
        old = self._newest[row, 3:]
        speed = np.where(np.isnan(old), moved, SMOOTH * old + (1 - SMOOTH) * moved)
        ids[near[person]] = self._ids[row]
        self._newest[row] = np.column_stack(
            [self._stamp + 0 * gap[row], xy[near[person]], speed]
        )
        new = near[ids[near] < 0][: max(CROWD - len(self._ids), 0)]
        ids[new] = self._next + np.arange(len(new))
        fresh = np.column_stack([xy[new], np.full((len(new), 2), np.nan)])
        self._newest = np.append(
            self._newest, np.insert(fresh, 0, self._stamp, axis=1), axis=0
        )
        self._ids = np.append(self._ids, ids[new])
        self._next += len(new)
