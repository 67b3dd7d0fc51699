"""Broken tracks mended frame by frame: `stitching` for a live stream, which cannot look ahead."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_robot.online.frames import Frame
from neurosym_robot.tracking.following import Follower, Track
from neurosym_robot.tracking.linking import LinkOptions, TrackEnds, assign
from neurosym_robot.tracking.motion import FAR, MAX_SPEED

__all__ = ["NOBODY", "OnlineStitcher", "mend"]

# The id of who is not believed to be somebody: far away, nowhere, or seen too briefly so far.
NOBODY = int(np.iinfo(np.int64).min)
# Seconds after which a newcomer's velocity is known, and any link that is allowed is made.
MOVED = 0.3
# Cost of a link up to which it is made at first sight, before the newcomer's velocity is known.
SURE = 0.1


def mend(stitcher: "OnlineStitcher", frame: Frame) -> tuple[Frame, np.ndarray]:
    """The people of a frame under mended ids, and [N] bool which of them are left."""
    ids = stitcher.push(*frame)
    known = ids != NOBODY
    return Frame(frame.stamp, ids[known], frame.xy[known]), known


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
        far: float = FAR,
        max_speed: float = MAX_SPEED,
    ):
        """Nobody seen yet.

        Args:
            options: when two tracks may be one person's.
            ids: new id of an old one, decided by hand.
            forget: seconds.
            max_tracks: followed at once.
            far: metres; who has a coordinate that is as large is nobody.
            max_speed: metres per second; see `motion.is_jump`.
        """
        self.options = LinkOptions() if options is None else options
        self.ids: dict[int, int] = dict(ids or {})
        self.forget = max(forget, self.options.max_gap)
        self.joined = 0
        self._follower = Follower(self.forget, max_tracks, far, max_speed)
        self._fresh = 0

    def push(self, stamp: float, ids: ArrayLike, xy: ArrayLike) -> np.ndarray:
        """[N] int64, mended ids of the people of a frame, or `NOBODY`.

        Frames that do not follow in time are named by what is known but change nothing; a clock
        set back by more than `forget` starts anew.

        Args:
            stamp: seconds.
            ids: [N] whole numbers.
            xy: [N, 2] metres.

        Raises:
            InputError: where the shapes differ.
        """
        numbers = np.asarray(ids)
        xy = np.asarray(xy, np.float64)
        if numbers.ndim != 1 or (len(numbers) and xy.shape != (len(numbers), 2)):
            raise InputError(f"a frame is ids [N], xy [N, 2], not {numbers.shape}, {xy.shape}")
        wanted, follower = numbers.astype(np.int64).tolist(), self._follower
        if np.isfinite(stamp) and stamp < follower.stamp - self.forget:
            follower.clear()
        if np.isfinite(stamp) and stamp > follower.stamp:
            found = follower.push(float(stamp), wanted, xy)
            self._name([track for track in found if track is not None and track.name is None])
            names = [None if track is None else track.name for track in found]
            near = np.all(np.abs(xy.reshape(-1, 2)) < follower.far, axis=1)
            # Who is not followed for want of room keeps the id.
            other = [
                self.ids.get(id, id) if track is None and here else NOBODY
                for id, track, here in zip(wanted, found, near)
            ]
        else:
            known = {track.id: track.name for track in follower.tracks}
            names = [known.get(id) for id in wanted]
            other = [NOBODY if id in known else self.ids.get(id, id) for id in wanted]
        return np.array([b if a is None else a for a, b in zip(names, other)], np.int64)

    def _name(self, new: list[Track]) -> None:
        """Names for those of the newcomers who go on with a lost track, or are old enough."""
        for track in [each for each in new if each.id in self.ids]:
            track.name = self.ids[track.id]
        new = [each for each in new if each.name is None]
        stamp = self._follower.stamp
        age = {id(each): stamp - each.born + 1e-6 for each in new}
        wait = max(min(MOVED, self.options.least), 1e-6)
        sure = np.array([min(1.0, age[id(each)] / wait) for each in new])
        self._link(new, SURE + (1 - SURE) * sure**2)
        for track in new:
            if track.name is None and age[id(track)] >= self.options.least:
                track.name = self._unused(track.id)

    def _link(self, new: list[Track], most: np.ndarray) -> None:
        taken = {each.name for each in self._follower.tracks if each.stamp == self._follower.stamp}
        lost = {
            each.name: each  # The newest of a name, for tracks are in order of their beginning.
            for each in self._follower.tracks
            if each.name is not None and each.name not in taken and each.id not in self.ids
        }
        if not (new and lost):
            return
        memory, tracks = self.options.memory, list(lost.values())
        ends = TrackEnds(
            np.array([each.stamp for each in tracks]),
            np.array([each.place for each in tracks]),
            np.array([each.velocity(memory) for each in tracks]),
        )
        starts = TrackEnds(
            np.array([each.born for each in new]),
            np.array([each.first for each in new]),
            np.array([each.velocity(memory, at_start=True) for each in new]),
        )
        for end, start in zip(*assign(ends, starts, self.options, most)):
            new[start].name = tracks[end].name
            self.joined += 1

    def _unused(self, id: int) -> int:
        """The tracker's id, or a number of our own where somebody else has it."""
        used = {each.name for each in self._follower.tracks} | set(self.ids.values())
        if id not in used:
            return id
        self._fresh += 1
        return 2**53 + self._fresh
