"""Frames of people, and tracks from frame to frame.

The tracker's ids are kept if people can have moved so. Swapped and changed ids are corrected by the
expected positions. Longer losses are for `stitching`.
"""

import collections
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from neurosym_jax.data.tracks import Tracks, make_tracks, resample
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
        self.id, self.born, self.first = id, stamp, place
        self.name: int | None = None  # the id that it is published under
        self.noted = False  # whether it is known to be brief or not
        self.stamp, self.place, self.speed = stamp, place, np.zeros(2)
        self.points = collections.deque([(stamp, *place)], maxlen=POINTS)

    @property
    def age(self) -> float:
        """Seconds from the first observation to the newest."""
        return self.stamp - self.born

    def add(self, id: int, stamp: float, place: np.ndarray) -> None:
        """Add an observation at `place` [2] metres."""
        moved = (place - self.place) / (stamp - self.stamp)
        keep = SMOOTH if len(self.points) > 1 else 0.0
        self.speed = keep * self.speed + (1 - keep) * moved
        self.id, self.stamp, self.place = id, stamp, place
        self.points.append((stamp, *place))

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
        self.stamp = -np.inf

    def push(self, stamp: float, numbers: ArrayLike, xy: np.ndarray) -> list[Track | None]:
        """Tracks of the people of the next frame, [N] ids at `xy` [N, 2]; None if not followed."""
        ids = np.asarray(numbers).tolist()
        self.tracks = [each for each in self.tracks if stamp - each.stamp <= self.forget]
        self.stamp = stamp
        found: list[Track | None] = [None] * len(ids)
        near = np.flatnonzero((np.abs(xy.reshape(-1, 2)) < FAR).all(axis=1)).tolist()
        # The newer of two tracks with one id counts, and the first of two people with one id.
        of_id = {track.id: track for track in self.tracks}
        free = dict.fromkeys(self.tracks)
        for n in near:
            track = of_id.get(ids[n])
            if track in free and np.hypot(*(xy[n] - self._expected(track))) <= CERTAIN:
                found[n] = track
                del free[track]
        waiting = [n for n in near if found[n] is None]
        recent = [each for each in free if stamp - each.stamp <= self.recent or each.id in ids]
        for n, track in self._assign(waiting[: self.max_tracks], recent, ids, xy):
            found[n] = track
        for n in near:
            track = found[n]
            if track is not None:
                track.add(ids[n], stamp, xy[n])
            elif len(self.tracks) < self.max_tracks:
                found[n] = track = Track(ids[n], stamp, xy[n])
                self.tracks.append(track)
        return found

    def _expected(self, track: Track) -> np.ndarray:
        return track.place + (self.stamp - track.stamp) * track.speed

    def _assign(
        self, waiting: list[int], tracks: list[Track], ids: list[int], xy: np.ndarray
    ) -> Iterator[tuple[int, Track]]:
        """Rows of the frame with the tracks that they continue."""
        if not (waiting and tracks):
            return
        gap = np.array([[self.stamp - each.stamp] for each in tracks])
        expected = np.array([[self._expected(each)] for each in tracks])
        place = np.array([[each.place] for each in tracks])
        off = np.linalg.norm(xy[waiting] - expected, axis=-1)
        moved = np.linalg.norm(xy[waiting] - place, axis=-1)
        same = np.array([[each.id] for each in tracks]) == np.array(ids)[waiting]
        allowed = np.where(same, ~is_jump(moved, gap), (off <= REACH) & (gap <= self.recent))
        cost = np.where(same, np.minimum(off, REACH + OTHER_ID), off + OTHER_ID)
        for row, column in zip(*linear_sum_assignment(np.where(allowed, cost, 1e6))):
            if allowed[row, column]:
                yield waiting[column], tracks[row]


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
