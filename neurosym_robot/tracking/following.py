"""Frames of people, and tracks from frame to frame.

The tracker's ids are kept if people can have moved so. Swapped and changed ids are corrected by the
expected positions. Longer losses are for `stitching`.
"""

import collections
import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from neurosym_jax.data.clock import resample
from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.errors import InputError

FAR = 3000.0  # metres; the original robot's filter puts lost people at (-3000, -3000)
MAX_SPEED = 5.0  # metres per second of a person between two observations
SLACK = 1.0  # metres of error of a tracker, both observations together
POINTS = 20  # newest points kept of a track: at 10 Hz twice what its velocity needs
SMOOTH = 0.7  # share of the old velocity kept from frame to frame: noise is as large as a step
CERTAIN = 0.15  # metres from the expected position within which an id is accepted at once
OTHER_ID = 0.2  # metres that a track of another id must be nearer to be preferred
REACH = 0.75  # maximum metres from the expected position of a track of another id
RECENT = 0.5  # seconds of loss after which only a track of the same id continues
FORGET = 1.0  # seconds after which a person without id who was not seen gets a new id
CROWD = 512  # people without ids followed at once; the others get new ids in every frame


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
        yield Frame(float(tracks.stamp[rows[0]]), tracks.id[rows], tracks.position[rows])


def tracks_of_frames(frames: Iterator[Frame], recording: str = "") -> Tracks:
    """Tracks of a stream.

    Raises:
        InputError: without people, or for frames that `make_tracks` refuses.
    """
    kept = [frame for frame in frames if len(frame.ids)]
    if not kept:
        raise InputError(f"{recording}: nobody in it")
    return make_tracks(
        recording,
        np.repeat([frame.stamp for frame in kept], [len(frame.ids) for frame in kept]),
        np.concatenate([frame.ids for frame in kept]),
        np.concatenate([frame.xy for frame in kept]),
    )


def is_jump(moved: Any, gap: Any) -> Any:
    """Whether a person cannot have `moved` [...] metres in `gap` [...] seconds."""
    return moved > MAX_SPEED * gap + SLACK


def velocity(stamp: np.ndarray, position: np.ndarray) -> np.ndarray:
    """[2] metres per second, least squares through `position [n, 2]`; NaN for a single point."""
    if len(stamp) < 2:
        return np.full(2, np.nan)
    time = stamp - stamp.mean()
    return time @ position / (time @ time)


class Track:
    """An unbroken track with its newest points."""

    def __init__(self, id: int, stamp: float, place: np.ndarray):
        """A new track with the tracker's `id`."""
        self.born, self.first = stamp, place
        self.name: int | None = None  # the id that it is published under
        self.noted = False  # whether it is known to be brief or not
        self.points: collections.deque[tuple[float, ...]] = collections.deque(maxlen=POINTS)
        self.add(id, stamp, place)

    @property
    def age(self) -> float:
        """Seconds from the first observation to the newest."""
        return self.stamp - self.born

    def add(self, id: int, stamp: float, place: np.ndarray) -> None:
        """Add an observation at `place` [2] metres."""
        self.id, self.stamp, self.place = id, stamp, place
        self.points.append((stamp, *place.tolist()))

    def velocity(self, memory: float, at_start: bool = False) -> np.ndarray:
        """[2] m/s, of the points within `memory` seconds of the newest or oldest."""
        points = np.array(self.points)
        at = points[0 if at_start else -1, 0]
        near = points[np.abs(points[:, 0] - at) <= memory + 1e-3]
        return velocity(near[:, 0], near[:, 1:])


class Follower:
    """Follows up to `max_tracks` people frame by frame; forgets a track after `forget` seconds.

    A track not seen for `recent` seconds is continued by its own id only.
    """

    def __init__(self, forget: float, max_tracks: int, recent: float = RECENT):
        self.forget, self.max_tracks, self.recent = forget, max_tracks, recent
        self.clear()

    def clear(self) -> None:
        """Forget all tracks."""
        self.tracks: list[Track] = []
        # [P, 5] of each track: seconds of its newest point, metres; metres per second, first NaN.
        self._newest = np.zeros((0, 5))
        self.stamp = -np.inf

    def push(self, stamp: float, numbers: ArrayLike, xy: np.ndarray) -> list[Track | None]:
        """Tracks of the people of the next frame, [N] ids at `xy` [N, 2]; None if not followed."""
        ids, xy, self.stamp = np.asarray(numbers), xy.reshape(-1, 2), stamp
        kept = stamp - self._newest[:, 0] <= self.forget
        self.tracks, self._newest = list(itertools.compress(self.tracks, kept)), self._newest[kept]
        near = np.flatnonzero((np.abs(xy) < FAR).all(axis=1))
        rows = np.full(len(ids), -1)  # in `tracks`
        if self.tracks and len(near):
            rows[near] = self._rows(ids[near], xy[near])
        known, new = near[rows[near] >= 0], near[rows[near] < 0]
        new = new[: max(self.max_tracks - len(self.tracks), 0)]
        before = self._newest[rows[known]]
        moved = (xy[known] - before[:, 1:3]) / (stamp - before[:, :1])
        mixed = SMOOTH * before[:, 3:] + (1 - SMOOTH) * moved
        now = np.column_stack([np.full(len(xy), stamp), xy, np.full(xy.shape, np.nan)])
        now[known, 3:] = np.where(np.isnan(before[:, 3:]), moved, mixed)
        self._newest[rows[known]] = now[known]
        self._newest = np.append(self._newest, now[new], axis=0)
        for n in known.tolist():
            self.tracks[rows[n]].add(int(ids[n]), stamp, xy[n])
        rows[new] = len(self.tracks) + np.arange(len(new))
        self.tracks += [Track(int(ids[n]), stamp, xy[n]) for n in new]
        return [None if row < 0 else self.tracks[row] for row in rows.tolist()]

    def _rows(self, ids: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """[N] rows of the tracks that people of a frame continue, or -1."""
        gap, place = self.stamp - self._newest[:, 0], self._newest[:, 1:3]
        expected = place + gap[:, None] * np.nan_to_num(self._newest[:, 3:])
        # The newer of two tracks with one id counts, and the first of two people with one id.
        numbers = [track.id for track in self.tracks]
        of_id = {id: row for row, id in enumerate(numbers)}
        own = np.array([of_id.get(id, -1) for id in ids.tolist()])
        at_once = np.flatnonzero((own >= 0) & (_apart(xy, expected[own]) <= CERTAIN))
        rows, (taken, first) = np.full(len(ids), -1), np.unique(own[at_once], return_index=True)
        rows[at_once[first]] = taken
        waiting = np.flatnonzero(rows < 0)[: self.max_tracks]
        free = np.flatnonzero((gap <= self.recent) | np.isin(numbers, ids))
        free = np.setdiff1d(free, taken)
        off = _apart(xy[waiting], expected[free, None])
        allowed, cost = (off <= REACH) & (gap[free, None] <= self.recent), off + OTHER_ID
        same = np.array(numbers)[free, None] == ids[waiting]
        track, person = np.nonzero(same)
        moved = _apart(xy[waiting[person]], place[free[track]])
        allowed[same] = ~is_jump(moved, gap[free[track]])
        cost[same] = np.minimum(off[same], REACH + OTHER_ID)
        track, person = linear_sum_assignment(np.where(allowed, cost, 1e6))
        made = allowed[track, person]
        rows[waiting[person[made]]] = free[track[made]]
        return rows


def _apart(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    """[...] metres between places [..., 2]."""
    x, y = some[..., 0] - others[..., 0], some[..., 1] - others[..., 1]
    return np.sqrt(x * x + y * y)


class NearestIds:
    """Ids, counted from 0, for positions without ids: each continues the nearest expected one."""

    def __init__(self):
        self._next = 0
        self._follower = Follower(FORGET, CROWD, recent=FORGET)

    def push(self, stamp: float, xy: ArrayLike) -> np.ndarray:
        """[N] int64 ids of positions [N, 2] in metres; a clock set back begins anew."""
        xy = np.asarray(xy, np.float64).reshape(-1, 2)
        ids = list(range(self._next, self._next + len(xy)))
        self._next += len(xy)
        if stamp < self._follower.stamp:
            self._follower.clear()
        if np.isfinite(stamp) and stamp > self._follower.stamp:
            for n, track in enumerate(self._follower.push(stamp, ids, xy)):
                if track is not None:
                    track.name = ids[n] = ids[n] if track.name is None else track.name
        return np.array(ids, np.int64)
