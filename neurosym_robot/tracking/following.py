"""Tracks from frame to frame: the tracker's ids are kept if people can have moved so.

Swapped and changed ids are corrected by the expected positions. Longer losses are for `linking`.
"""

import collections
from collections.abc import Iterator

import numpy as np
from scipy.optimize import linear_sum_assignment

from neurosym_robot.tracking.linking import velocity
from neurosym_robot.tracking.motion import FAR, MAX_SPEED, is_jump

__all__ = ["Follower", "Track"]

POINTS = 20  # newest points kept of a track: at 10 Hz twice what its velocity needs
SMOOTH = 0.7  # share of the old velocity kept from frame to frame: noise is as large as a step
CERTAIN = 0.15  # metres from the expected position within which an id is accepted at once
OTHER_ID = 0.2  # metres that a track of another id must be nearer to be preferred
REACH = 0.75  # maximum metres from the expected position of a track of another id
RECENT = 0.5  # seconds of loss after which only a track of the same id continues


class Track:
    """An unbroken track with its newest points."""

    __slots__ = ("born", "first", "id", "name", "noted", "place", "points", "speed", "stamp")

    def __init__(self, id: int, stamp: float, place: np.ndarray):
        """Somebody new, of the tracker's `id`."""
        self.id, self.born, self.first = id, stamp, place
        self.name: int | None = None
        self.noted = False
        self.stamp, self.place, self.speed = stamp, place, np.zeros(2)
        self.points = collections.deque([(stamp, *place)], maxlen=POINTS)

    @property
    def age(self) -> float:
        """Seconds from the first observation to the newest."""
        return self.stamp - self.born

    def expected(self, stamp: float) -> np.ndarray:
        """[2] metres."""
        return self.place + (stamp - self.stamp) * self.speed

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
    """Follows everybody frame by frame."""

    def __init__(
        self,
        forget: float,
        max_tracks: int,
        far: float = FAR,
        max_speed: float = MAX_SPEED,
        recent: float = RECENT,
    ):
        self.recent = recent
        self.forget, self.max_tracks, self.far, self.max_speed = forget, max_tracks, far, max_speed
        self.tracks: list[Track] = []
        self.stamp = -np.inf

    def clear(self) -> None:
        """Forget all tracks."""
        self.tracks, self.stamp = [], -np.inf

    def push(self, stamp: float, ids: list[int], xy: np.ndarray) -> list[Track | None]:
        """Tracks of the people of the next frame at `xy` [N, 2]; None if not followed."""
        self.tracks = [each for each in self.tracks if stamp - each.stamp <= self.forget]
        self.stamp = stamp
        found: list[Track | None] = [None] * len(ids)
        near = np.flatnonzero((np.abs(xy) < self.far).all(axis=1)).tolist() if len(ids) else []
        # Of two tracks with one id the newer counts; of two people with one id the first.
        of_id = {track.id: track for track in self.tracks}
        free = {id(track): track for track in self.tracks}
        waiting = []
        for n in near:
            track = of_id.get(ids[n])
            if track is not None and id(track) in free and self._off(track, xy[n]) <= CERTAIN:
                found[n] = free.pop(id(track))
            else:
                waiting.append(n)
        recent = [
            each for each in free.values() if stamp - each.stamp <= self.recent or each.id in ids
        ]
        for n, track in self._assign(waiting[: self.max_tracks], recent, ids, xy):
            found[n] = track
        for n in near:
            track = found[n]
            if track is not None:
                track.add(ids[n], stamp, xy[n])
            elif len(self.tracks) < self.max_tracks:
                found[n] = new = Track(ids[n], stamp, xy[n])
                self.tracks.append(new)
        return found

    def _off(self, track: Track, place: np.ndarray) -> float:
        return float(np.hypot(*(place - track.expected(self.stamp))))

    def _assign(
        self, waiting: list[int], tracks: list[Track], ids: list[int], xy: np.ndarray
    ) -> Iterator[tuple[int, Track]]:
        """Rows of the frame with the tracks that they continue."""
        if not (waiting and tracks):
            return
        gap = np.array([self.stamp - each.stamp for each in tracks])
        expected = np.array([each.expected(self.stamp) for each in tracks])
        place = np.array([each.place for each in tracks])
        points = xy[waiting]
        off = np.linalg.norm(points - expected[:, None], axis=-1)
        moved = np.linalg.norm(points - place[:, None], axis=-1)
        same = np.array([each.id for each in tracks])[:, None] == np.array(ids)[waiting]
        allowed = np.where(
            same,
            ~is_jump(moved, gap[:, None], self.max_speed),
            (off <= REACH) & (gap[:, None] <= self.recent),
        )
        cost = np.where(
            allowed, np.where(same, np.minimum(off, REACH + OTHER_ID), off + OTHER_ID), 1e6
        )
        for row, column in zip(*linear_sum_assignment(cost)):
            if allowed[row, column]:
                yield waiting[column], tracks[row]
