"""Ids for people whose messages carry none: each position goes on with the nearest one expected.

For detections without occlusions; gaps of more than a second are for `live`.
"""

import numpy as np
from numpy.typing import ArrayLike

from neurosym_robot.tracking.following import Follower

__all__ = ["NearestIds"]

FORGET = 1.0  # seconds; somebody not seen for longer is somebody new
MOST = 512  # people followed at once; the rest of a frame is new every time


class NearestIds:
    """Gives the positions of each frame ids, counted from 0."""

    def __init__(self):
        """Nobody seen yet."""
        self._next = 0
        self._follower = Follower(FORGET, MOST, recent=FORGET)

    def push(self, stamp: float, xy: ArrayLike) -> np.ndarray:
        """[N] int64 ids of the people of a frame; a clock set back begins anew.

        Args:
            stamp: seconds.
            xy: [N, 2] metres; a position that is not finite is nobody known.
        """
        xy = np.asarray(xy, np.float64).reshape(-1, 2)
        ids = list(range(self._next, self._next + len(xy)))
        self._next += len(xy)
        if stamp < self._follower.stamp:
            self._follower.clear()
        # The same moment again, or none, says nothing of who goes on how.
        if np.isfinite(stamp) and stamp > self._follower.stamp:
            for n, track in enumerate(self._follower.push(stamp, ids, xy)):
                if track is not None:
                    track.name = ids[n] if track.name is None else track.name
                    ids[n] = track.name
        return np.array(ids, np.int64)
