"""Ids for people whose messages carry none: each position goes on with the nearest one expected.

For detections without occlusions; gaps of more than a second are for `live_stitching`.
"""

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["NearestIds"]

REACH = 0.75
"""Metres from where somebody is expected, at most."""
FORGET = 1.0
"""Seconds; somebody not seen for longer is somebody new."""
SMOOTH = 0.7
"""Share of the old velocity that is kept: a tracker's noise is as large as a step."""
MOST = 512
"""People followed at once; the rest of a frame is new every time."""


class NearestIds:
    """Gives the positions of each frame ids, counted from 0."""

    def __init__(self):
        """Nobody seen yet."""
        self._next = 0
        self._clear()

    def _clear(self) -> None:
        self._id = np.zeros(0, np.int64)
        self._stamp = np.zeros(0)
        self._xy = np.zeros((0, 2))
        self._velocity = np.zeros((0, 2))

    def push(self, stamp: float, xy: ArrayLike) -> np.ndarray:
        """[N] int64 ids of the people of a frame; a clock set back begins anew.

        Args:
            stamp: seconds.
            xy: [N, 2] metres; a position that is not finite is nobody known.
        """
        xy = np.asarray(xy, np.float64).reshape(-1, 2)
        if not np.isfinite(stamp) or (self._stamp > stamp).any():
            self._clear()
        keep = stamp - self._stamp <= FORGET
        self._id, self._stamp = self._id[keep], self._stamp[keep]
        self._xy, self._velocity = self._xy[keep], self._velocity[keep]

        fine = np.flatnonzero(np.isfinite(xy).all(axis=1))[:MOST]
        seen, known = xy[fine], len(self._id)
        since = (stamp - self._stamp)[:, None]
        expected = self._xy + since * self._velocity
        distance = np.linalg.norm(expected[:, None] - seen[None], axis=-1)
        from scipy.optimize import linear_sum_assignment

        # What is out of reach costs more than any number of those within it.
        cost = np.where(distance <= REACH, distance, REACH * (MOST + 1))
        old, new = linear_sum_assignment(cost)
        near = distance[old, new] <= REACH
        old, new = old[near], new[near]

        ids = self._next + np.arange(len(xy))
        self._next += len(xy)
        ids[fine[new]] = self._id[old]
        moved = (seen[new] - self._xy[old]) / np.maximum(since[old], 1e-3)
        self._velocity[old] = SMOOTH * self._velocity[old] + (1 - SMOOTH) * moved
        self._xy[old], self._stamp[old] = seen[new], stamp
        first = np.setdiff1d(np.arange(len(fine)), new)[: max(0, MOST - known)]
        self._id = np.append(self._id, ids[fine[first]])
        self._stamp = np.append(self._stamp, np.full(len(first), stamp))
        self._xy = np.concatenate([self._xy, seen[first]])
        self._velocity = np.concatenate([self._velocity, np.zeros((len(first), 2))])
        return ids
