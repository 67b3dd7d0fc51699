"""Ids for messages without ids: each position continues the nearest expected one.

For detections without occlusions; gaps of more than a second are for `live`.
"""

import numpy as np
from numpy.typing import ArrayLike

from neurosym_robot.tracking.following import Follower

__all__ = ["NearestIds"]

FORGET = 1.0  # seconds after which a person not seen gets a new id
MOST = 512  # people followed at once; the others get new ids in every frame


class NearestIds:
    """Gives the positions of each frame ids, counted from 0."""

    def __init__(self):
        self._next = 0
        self._follower = Follower(FORGET, MOST, recent=FORGET)

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
