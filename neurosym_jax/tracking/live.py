"""Broken tracks mended frame by frame: `stitching` for a live stream, which cannot look ahead."""

import collections
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.tracking.linking import LinkOptions, Loose, assign, velocity

__all__ = ["OnlineStitcher"]

POINTS = 20
"""Kept of each track; at 10 Hz twice what its velocity is taken from."""


class OnlineStitcher:
    """Gives the people of each frame mended ids; a decision once made is not changed.

    Memory is bounded: a track not seen for `forget` seconds is forgotten, and its id, should it
    come back, is somebody new; no more than `max_tracks` are followed, the rest keep their ids.
    """

    def __init__(
        self,
        options: LinkOptions | None = None,
        *,
        ids: Mapping[int, int] | None = None,
        forget: float = 60.0,
        max_tracks: int = 1024,
    ):
        """Nobody seen yet; `ids` maps old ids to new, decided by hand."""
        self.options = LinkOptions() if options is None else options
        self.ids: dict[int, int] = dict(ids or {})
        self.forget, self.max_tracks = max(forget, self.options.max_gap), max_tracks
        self.joined = 0
        self._stamp = -np.inf
        self._name: dict[int, int] = {}  # tracker's id -> mended
        self._history: dict[int, collections.deque] = {}  # tracker's id -> (stamp, x, y)
        self._followed: set[int] = set()  # lost tracks that somebody new goes on with

    def push(self, stamp: float, ids: ArrayLike, xy: ArrayLike) -> np.ndarray:
        """[N] mended ids of the people of a frame.

        Frames that do not follow in time, and people whose position is not finite, are named by
        what is known but change nothing; a clock set back by more than `forget` starts anew.

        Args:
            stamp: seconds.
            ids: [N] whole numbers.
            xy: [N, 2] metres.

        Raises:
            InputError: where the shapes differ.
        """
        numbers, xy = np.asarray(ids), np.asarray(xy, np.float64)
        if numbers.ndim != 1 or (len(numbers) and xy.shape != (len(numbers), 2)):
            raise InputError(f"a frame is ids [N], xy [N, 2], not {numbers.shape}, {xy.shape}")
        numbers = numbers.astype(np.int64)
        if np.isfinite(stamp) and stamp < self._stamp - self.forget:
            self._name, self._history, self._followed = {}, {}, set()
            self._stamp = -np.inf
        if np.isfinite(stamp) and stamp > self._stamp:
            self._stamp = float(stamp)
            self._see(numbers, xy)
        return np.array(
            [self._name.get(id, self.ids.get(id, id)) for id in numbers.tolist()], np.int64
        )

    def _see(self, numbers: np.ndarray, xy: np.ndarray) -> None:
        for id in [n for n, h in self._history.items() if self._stamp - h[-1][0] > self.forget]:
            del self._history[id], self._name[id]
            self._followed.discard(id)
        fine = np.isfinite(xy).all(axis=1) if len(numbers) else np.zeros(0, bool)
        here = dict(zip(numbers[fine].tolist(), xy[fine].tolist()))
        new = [id for id in here if id not in self._history]
        new = new[: max(0, self.max_tracks - len(self._history))]
        self._link([id for id in new if id not in self.ids], here)
        for id in new:
            if id not in self._name:
                by_hand = self.ids.get(id)
                self._name[id] = id if by_hand is None else by_hand
            self._history[id] = collections.deque(maxlen=POINTS)
        for id, position in here.items():
            if id in self._history:
                self._history[id].append((self._stamp, *position))

    def _link(self, new: list[int], here: dict[int, list[float]]) -> None:
        """Names for those of the newcomers who go on with a lost track."""
        named = {self._name[id] for id in here if id in self._name}
        lost = [
            id
            for id, history in self._history.items()
            if self._stamp - history[-1][0] <= self.options.max_gap
            and id not in here
            and id not in self._followed
            and id not in self.ids
            and self._name[id] not in named
        ]
        if not (new and lost):
            return
        tails = []
        for id in lost:
            points = np.array(self._history[id])
            points = points[points[:, 0] >= points[-1, 0] - self.options.memory]
            tails.append((*points[-1], *velocity(points[:, 0], points[:, 1:])))
        tail = np.array(tails)
        ends = Loose(tail[:, 0], tail[:, 1:3], tail[:, 3:])
        position = np.array([here[id] for id in new])
        starts = Loose(np.full(len(new), self._stamp), position, np.full((len(new), 2), np.nan))
        for end, start in zip(*assign(ends, starts, self.options)):
            self._name[new[start]] = self._name[lost[end]]
            self._followed.add(lost[end])
            self.joined += 1
