"""Broken tracks mended frame by frame: `stitching` for a live stream, which cannot look ahead."""

import collections

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_robot.online.frames import Frame
from neurosym_robot.tracking.following import RECENT, Follower, Track
from neurosym_robot.tracking.linking import LinkOptions, TrackEnds, assign, link_costs
from neurosym_robot.tracking.motion import FAR, MAX_SPEED

__all__ = ["NOBODY", "OnlineStitcher", "mend"]

NOBODY = int(np.iinfo(np.int64).min)
"""Id of a detection that is far away, not finite, or seen too briefly so far."""
MOVED = 0.3  # seconds after which a new track's velocity is known, and every allowed link is made
ENOUGH = 10  # tracks after which it is known whether a tracker has ghosts
GHOSTLY = 0.2  # share of brief tracks among the newest from which on a tracker has ghosts
PACE = 2.0  # metres per second: nobody who was lost comes back from farther away
LATELY = 30  # newest tracks of which that is known
SURE = 0.2  # cost of a link that is made at once, before the new track's velocity is known


def mend(stitcher: "OnlineStitcher", frame: Frame) -> tuple[Frame, np.ndarray]:
    """The people of a frame under mended ids, and [N] bool which of them are left."""
    ids = stitcher.push(*frame)
    known = ids != NOBODY
    return Frame(frame.stamp, ids[known], frame.xy[known]), known


class OnlineStitcher:
    """Gives the people of each frame mended ids; a decision is never changed.

    A newcomer goes on with a lost track at once if they are where it is expected, and is somebody
    new at once if nobody who was lost can have come so far; otherwise, and where the tracker has
    ghosts, it is decided within `options.least` seconds.

    Memory is bounded: a track not seen for `forget` seconds is forgotten, and its id then means a
    new person; at most `max_tracks` are followed, and the others keep their ids.
    """

    def __init__(
        self,
        options: LinkOptions | None = None,
        *,
        forget: float = 60.0,
        max_tracks: int = 1024,
        far: float = FAR,
        max_speed: float = MAX_SPEED,
    ):
        """Before the first frame.

        Args:
            options: when two tracks are joined.
            forget: seconds.
            max_tracks: followed at once.
            far: metres; people with a coordinate this large are `NOBODY`.
            max_speed: metres per second; see `motion.is_jump`.
        """
        self.options = LinkOptions() if options is None else options
        self.forget = max(forget, self.options.max_gap)
        self.joined = 0
        self._follower = Follower(self.forget, max_tracks, far, max_speed)
        self._fresh = 0
        self._brief: collections.deque[bool] = collections.deque(maxlen=LATELY)

    def push(self, stamp: float, ids: ArrayLike, xy: ArrayLike) -> np.ndarray:
        """[N] int64, mended ids of the people of a frame, or `NOBODY`.

        Frames out of order are named by what is known but change nothing; a clock set back by more
        than `forget` starts anew.

        Args:
            stamp: seconds.
            ids: [N] whole numbers.
            xy: [N, 2] metres.

        Raises:
            InputError: if the shapes differ.
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
            self._note_ghosts()
            self._name([track for track in found if track is not None and track.name is None])
            near = np.all(np.abs(xy.reshape(-1, 2)) < follower.far, axis=1)
            # People who are not followed for lack of room keep their ids.
            names = [
                (id if here else NOBODY) if track is None else track.name
                for id, track, here in zip(wanted, found, near)
            ]
        else:
            known = {track.id: track.name for track in follower.tracks}
            names = [known.get(id, id) for id in wanted]
        return np.array([NOBODY if name is None else name for name in names], np.int64)

    def _name(self, new: list[Track]) -> None:
        """Name those new tracks that continue a lost one, cannot, or are old enough."""
        age = {id(each): self._follower.stamp - each.born + 1e-6 for each in new}
        wait = max(min(MOVED, self.options.least), 1e-6)
        sure = np.array([min(1.0, age[id(each)] / wait) for each in new])
        alone = self._link(new, SURE + (1 - SURE) * sure**2)
        known = len(self._brief)
        ghostly = known < ENOUGH or sum(self._brief) > GHOSTLY * known
        for track, free in zip(new, alone):
            settled = age[id(track)] >= self.options.least
            if track.name is None and (settled or (free and not ghostly)):
                track.name = self._unused(track.id)

    def _note_ghosts(self) -> None:
        """Remember of each track, once that is known, whether it was brief."""
        for track in self._follower.tracks:
            last = self._follower.stamp - track.stamp
            if not track.noted and (last > RECENT or track.age >= self.options.least):
                track.noted = True
                self._brief.append(track.age < self.options.least)

    def _link(self, new: list[Track], most: np.ndarray) -> np.ndarray:
        """Name those that continue a lost track; [N] bool which others can continue none."""
        taken = {each.name for each in self._follower.tracks if each.stamp == self._follower.stamp}
        lost = {
            each.name: each  # The newest of a name: tracks are in order of their start.
            for each in self._follower.tracks
            if each.name is not None and each.name not in taken
        }
        if not (new and lost):
            return np.ones(len(new), bool)
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
        cost = link_costs(ends, starts, self.options)
        for end, start in zip(*assign(cost, most)):
            new[start].name = tracks[end].name
            self.joined += 1
        gap = starts.stamp - ends.stamp[:, None]
        moved = np.linalg.norm(starts.position - ends.position[:, None], axis=-1)
        walkable = moved <= self.options.reach + PACE * gap
        return ~((gap > 0) & (gap <= self.options.max_gap) & walkable).any(axis=0)

    def _unused(self, id: int) -> int:
        """The tracker's id, or a number of our own if another track has that name."""
        used = {each.name for each in self._follower.tracks}
        if id not in used:
            return id
        self._fresh += 1
        return 2**53 + self._fresh
