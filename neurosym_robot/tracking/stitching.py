"""Stitching: tracks that occlusions broke are joined frame by frame, live or in a recording.

A lost track is extrapolated forward, a new one backward, both at constant velocity, so that a
person who left the area is expected outside it; an optimal assignment links the two.
"""

import collections
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from neurosym_jax.configuration import Checked, NotNegative
from neurosym_jax.data.clock import resample
from neurosym_jax.data.tracks import SNAP, Tracks
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.following import (
    RECENT,
    Follower,
    Frame,
    Track,
    frames_of_tracks,
    synchronous,
)

NOBODY = int(np.iinfo(np.int64).min)
"""Id of a detection that is far away, not finite, or seen too briefly so far."""
UNLINKED = 1e6  # cost of no link, above that of any allowed one
FORGET = 60.0  # seconds after which the id of a person not seen means a new person
MOVED = 0.3  # seconds after which a new track's velocity is known, and every allowed link is made
SURE = 0.2  # cost of a link that is made at once, before the new track's velocity is known
PACE = 2.0  # metres per second: nobody who was lost comes back from farther away
LATELY = 30  # newest tracks that tell how many are ghosts, and how many newcomers were new
ENOUGH = 10  # tracks after which it is known whether a tracker has ghosts
FEW = 0.2  # share of brief tracks up to which it has none, and of newcomers who were new
BRIEF = 1.0  # seconds: who is seen for less in a whole recording is a ghost


@dataclasses.dataclass(frozen=True)
class LinkOptions(Checked):
    """When two tracks may belong to one person."""

    max_gap: NotNegative = 6.0
    """Maximum seconds between the end of one track and the start of the other."""
    reach: NotNegative = 0.6
    """Maximum distance in metres of the start from its expected position, for a gap of 0 s."""
    drift: NotNegative = 0.8
    """Metres added to --reach for each second of the gap."""
    turn: NotNegative = 0.2
    """Metres of distance that count as much as a velocity difference of 1 m/s."""
    memory: NotNegative = 1.0
    """Seconds at an end or a start over which its velocity is estimated."""
    least: NotNegative = 0.3
    """Minimum duration of a track in seconds; shorter ones are a tracker's ghosts and left out."""


class OnlineStitcher:
    """Gives the people of each frame mended ids; a decision is never changed.

    A newcomer goes on with a lost track at once if they are where it is expected, or, where hardly
    any newcomer was somebody new, if they can be that person; and is somebody new at once if nobody
    who was lost can have come so far. Otherwise it is decided within `options.least` seconds, or
    within `BRIEF` where the tracker has ghosts. The people of the first frame are new.
    """

    def __init__(self, options: LinkOptions | None = None, max_tracks: int = 1024):
        """Follow up to `max_tracks` people; the others are `NOBODY`."""
        self.options = LinkOptions() if options is None else options
        self.joined = 0
        self._follower = Follower(max(FORGET, self.options.max_gap), max_tracks)
        self._fresh = 0
        # Whether the newest tracks were brief, and the newest newcomers somebody new.
        self._brief: collections.deque[bool] = collections.deque(maxlen=LATELY)
        self._new: collections.deque[bool] = collections.deque(maxlen=LATELY)

    def mend(self, frame: Frame) -> tuple[Frame, np.ndarray]:
        """The people of a frame under mended ids, and [N] bool which of them are left."""
        ids = self.push(*frame)
        known = ids != NOBODY
        return Frame(frame.stamp, ids[known], frame.xy[known]), known

    def push(self, stamp: float, ids: ArrayLike, xy: ArrayLike) -> np.ndarray:
        """[N] int64, mended ids of the people of a frame [s, N whole numbers, m], or `NOBODY`.

        Frames out of order are named by what is known but change nothing; a clock set back by more
        than a minute starts anew.
        """
        wanted = np.asarray(ids).astype(np.int64)
        xy, follower = np.asarray(xy, np.float64).reshape(-1, 2), self._follower
        if np.isfinite(stamp) and stamp < follower.stamp - follower.forget:
            follower.clear()
        if np.isfinite(stamp) and stamp > follower.stamp:
            tracks = self.follow(float(stamp), wanted, xy)
        else:
            of_id = {track.id: track for track in follower.tracks}
            tracks = [of_id.get(id) for id in wanted.tolist()]
        return _names(tracks)

    def follow(self, stamp: float, ids: np.ndarray, xy: np.ndarray) -> list[Track | None]:
        """The tracks of a frame's people, which may get their names later; None if not followed."""
        if not self._follower.tracks:
            self._begun = stamp
        found = self._follower.push(stamp, ids, xy)
        for track in self._follower.tracks:
            settled = track.age >= self.options.least
            if not track.noted and (settled or stamp - track.stamp > RECENT):
                track.noted = True
                self._brief.append(not settled)
        new = [track for track in found if track is not None and track.name is None]
        if new:
            self._name(new)
        return found

    def _name(self, new: list[Track]) -> None:
        """Name those new tracks that continue a lost one, cannot, or are old enough."""
        age = self._follower.stamp - np.array([each.born for each in new]) + 1e-6
        sure = np.minimum(1.0, age / max(min(MOVED, self.options.least), 1e-6))
        known = len(self._brief) >= ENOUGH
        ghostly = sum(self._brief) > FEW * len(self._brief)
        closed = not ghostly and sum(self._new) <= FEW * len(self._new)
        alone = self._link(new, 1.0 if closed else SURE + (1 - SURE) * sure**2)
        self._new.extend([False] * sum(track.name is not None for track in new))
        wait = max(self.options.least, BRIEF if known and ghostly else 0.0)
        used = {each.name for each in self._follower.tracks}
        for track, old in zip(new, age):
            first = track.born == self._begun
            at_once = first or (known and not ghostly and track in alone)
            if track.name is None and (old >= wait or at_once):
                track.name = track.id
                self._new.extend([True] * (not first))
                if track.id in used:  # by somebody else
                    self._fresh += 1
                    track.name = 2**53 + self._fresh
                used.add(track.name)

    def _link(self, new: list[Track], most: np.ndarray | float) -> list[Track]:
        """Name those that continue a lost track, at a cost of up to `most`, or [M].

        Return those that cannot continue any.
        """
        tracks, now = self._follower.tracks, self._follower.stamp
        taken = {each.name for each in tracks if each.stamp == now}
        # The newest of a name: tracks are in order of their start.
        lost = {each.name: each for each in tracks if each.name is not None}
        ends = [track for name, track in lost.items() if name not in taken]
        if not ends:
            return new
        cost, can_be = link_costs(ends, new, self.options)
        cost = np.where(cost <= most, cost, UNLINKED)
        for end, start in zip(*linear_sum_assignment(cost)):
            if cost[end, start] < UNLINKED:
                new[start].name = ends[end].name
                self.joined += 1
        return [track for track, some in zip(new, np.any(can_be, axis=0).tolist()) if not some]


def link_costs(
    ends: list[Track], starts: list[Track], options: LinkOptions
) -> tuple[np.ndarray, np.ndarray]:
    """[L, M] the distance from the expected position as a share of the distance allowed.

    `UNLINKED` beyond it; and [L, M] bool whether a person can have walked from end to start.
    """
    gap = np.array([[start.born - end.stamp for start in starts] for end in ends])
    moved = np.array([[start.first - end.place for start in starts] for end in ends])
    before = np.array([each.velocity(options.memory) for each in ends])[:, None]
    after = np.array([each.velocity(options.memory, at_start=True) for each in starts])[None]
    unknown = np.isnan(after[..., 0])
    before, after = np.nan_to_num(before), np.nan_to_num(after)
    timely = (gap > 0) & (gap <= options.max_gap)
    gap = np.where(timely, gap, 0.0)
    ahead = np.linalg.norm(moved - gap[..., None] * before, axis=-1)
    back = np.linalg.norm(moved - gap[..., None] * after, axis=-1)
    turned = options.turn * np.linalg.norm(after - before, axis=-1)
    off = np.where(unknown, ahead, (ahead + back) / 2 + turned)
    cost = off / np.maximum(options.reach + options.drift * gap, 1e-9)
    walkable = np.linalg.norm(moved, axis=-1) <= options.reach + PACE * gap
    return np.where(timely & (cost <= 1), cost, UNLINKED), timely & walkable


class Stitched(NamedTuple):
    """A stitched recording and what was done to it."""

    tracks: Tracks
    before: int  # ids before
    joined: int  # tracks that continue another
    ghosts: int  # rows dropped: of people seen for less than a second, or far away


def stitch(
    tracks: Tracks, options: LinkOptions | None = None, *, period: float = 0.1, fill: float = 2.0
) -> Stitched:
    """Mend a recording; its points are then `period` seconds apart.

    Agents with clocks of their own are resampled to one first; gaps of up to `fill` seconds are
    filled linearly.

    Raises:
        InputError: if nobody is seen for a second.
    """
    tracks = synchronous(tracks)
    ids, joined = stitched_ids(tracks, options)
    there = ids != NOBODY
    if not there.any():
        raise InputError(f"{tracks.recording}: nobody is seen for {BRIEF:g} s")
    mended = tracks.take(there).with_ids(ids[there])
    mended = resample(mended, period, fill, period * np.floor(mended.stamp.min() / period))
    return Stitched(mended, len(np.unique(tracks.id)), joined, int((~there).sum()))


def stitched_ids(tracks: Tracks, options: LinkOptions | None = None) -> tuple[np.ndarray, int]:
    """Mended ids [R] of the rows, `NOBODY` for ghosts, and the number of joins.

    As `OnlineStitcher`, but ghosts are left out first, and each track has from its start on the
    name that it gets later.
    """
    options = LinkOptions() if options is None else options
    follower = Follower(max(FORGET, options.max_gap), len(tracks.id))
    there = [
        each is not None and each.age >= BRIEF - SNAP for each in _tracks(tracks, follower.push)
    ]
    given = np.full(len(tracks.id), NOBODY)
    if not any(there):
        return given, 0
    stitcher = OnlineStitcher(options, len(tracks.id))
    found = _tracks(tracks.take(np.array(there)), stitcher.follow)
    given[there] = _names(found)
    return given, stitcher.joined


def _names(tracks: list[Track | None]) -> np.ndarray:
    names = (None if track is None else track.name for track in tracks)
    return np.array([NOBODY if name is None else name for name in names], np.int64)


def _tracks(tracks: Tracks, push: Callable[..., list[Track | None]]) -> list[Track | None]:
    """[R] the track of each row."""
    found = [each for frame in frames_of_tracks(tracks) for each in push(*frame)]
    return [found[n] for n in np.argsort(np.lexsort((tracks.id, tracks.stamp)))]
