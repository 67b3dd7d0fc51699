"""Stitching: tracks that occlusions broke are linked greedily, frame by frame, live or recorded.

A newcomer goes on with the lost person who is expected nearest at constant velocity, at
once or never; nobody is withheld, and nothing is taken back.
"""

import collections
import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.configuration import Checked, NotNegative
from neurosym_jax.data.tracks import SNAP, Tracks
from neurosym_jax.data.windows import resample
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.following import (
    FAR,
    Frame,
    frames_of_tracks,
    is_jump,
    synchronous,
)

POINTS = 20  # newest points kept of a track: at 10 Hz twice what its velocity needs
FORGET = 60.0  # seconds after which the id of a person not seen means a new person
BRIEF = 1.0  # seconds: who is seen for less in a whole recording is a ghost
FRESH = 2**53  # ids given to people whose own is another person's are from here on


@dataclasses.dataclass(frozen=True)
class LinkOptions(Checked):
    """When two tracks may belong to one person."""

    max_gap: NotNegative = 4.0
    """Maximum seconds between the end of one track and the start of the other."""
    reach: NotNegative = 0.4
    """Maximum distance in metres of the start from its expected position, for a gap of 0 s."""
    drift: NotNegative = 0.5
    """Metres added to --reach for each second of the gap."""
    memory: NotNegative = 1.0
    """Seconds at the end of a track over which its velocity is estimated."""


class _Person:
    """The newest points of a person, under the name that is published."""

    def __init__(self, name: int):
        self.name = name
        self.points: collections.deque[tuple[float, ...]] = collections.deque(
            maxlen=POINTS
        )

    def expected(self, stamp: float, memory: float) -> np.ndarray:
        """[2] metres, where the person is at `stamp` at constant velocity."""
        points = np.array(self.points)
        near = points[points[:, 0] >= points[-1, 0] - memory - 1e-3]
        time = near[:, 0] - near[:, 0].mean()
        # Least squares; a single point has no velocity.
        velocity = time @ near[:, 1:] / (time @ time) if len(near) > 1 else 0.0
        return points[-1, 1:] + (stamp - points[-1, 0]) * velocity


class OnlineStitcher:
    """Gives the people of each frame mended ids; a tracker's ids are believed while they last."""

    def __init__(self, options: LinkOptions | None = None, max_tracks: int = 1024):
        """Remember up to `max_tracks` people."""
        self.options = LinkOptions() if options is None else options
        self.joined = 0
        """Tracks that were linked to an earlier one."""
        self._max_tracks = max_tracks
        self._stamp, self._fresh = -np.inf, 0
        self._people: dict[int, _Person] = {}  # by the tracker's newest id of each

    def mend(self, frame: Frame) -> Frame:
        """The frame under mended ids."""
        return frame._replace(ids=self.push(*frame))

    def push(self, stamp: float, ids: ArrayLike, xy: ArrayLike) -> np.ndarray:
        """[N] int64, mended ids of the people of a frame [s, N whole numbers, m].

        A clock set back begins anew; a frame of the same moment as the one before
        changes nothing.
        """
        numbers = np.asarray(ids).astype(np.int64).tolist()
        places = np.asarray(xy, np.float64).reshape(-1, 2)
        if np.isfinite(stamp) and stamp < self._stamp:
            self._people.clear()
        if np.isfinite(stamp) and stamp != self._stamp:
            self._stamp = float(stamp)
            self._follow(dict(zip(numbers[::-1], places[::-1])))
        names = {id: person.name for id, person in self._people.items()}
        return np.array([names.get(id, id) for id in numbers], np.int64)

    def _follow(self, seen: dict[int, np.ndarray]) -> None:
        """Add a frame to the people it shows; newcomers are linked or new."""
        now, people = self._stamp, self._people
        for id, person in list(people.items()):
            if now - person.points[-1][0] > FORGET or (
                id in seen and self._left(person, seen[id])
            ):
                del people[id]
        seen = {id: place for id, place in seen.items() if (np.abs(place) < FAR).all()}
        new = [id for id in seen if id not in people]
        for id, old in self._links({id: seen[id] for id in new}, set(seen)):
            people[id] = people.pop(old)
            self.joined += 1
        used = {person.name for person in people.values()}
        for id in new:
            if id not in people and len(people) < self._max_tracks:
                self._fresh += id in used
                people[id] = _Person(FRESH + self._fresh if id in used else id)
                used.add(people[id].name)
        for id, place in seen.items():
            if id in people:
                people[id].points.append((now, *place.tolist()))

    def _left(self, person: _Person, place: np.ndarray) -> bool:
        """Whether the tracker gave a person's id to somebody else."""
        stamp, *last = person.points[-1]
        return bool(is_jump(np.linalg.norm(place - last), self._stamp - stamp))

    def _links(
        self, new: dict[int, np.ndarray], seen: set[int]
    ) -> list[tuple[int, int]]:
        """Ids of newcomers, and of the lost people whom they continue, the nearest pairs first."""
        options, pairs = self.options, []
        for old, person in self._people.items() if new else ():
            gap = self._stamp - person.points[-1][0]
            if old in seen or gap > options.max_gap:
                continue
            expected = person.expected(self._stamp, options.memory)
            for id, place in new.items():
                off = float(np.linalg.norm(place - expected))
                if off <= options.reach + options.drift * gap:
                    pairs.append((off, id, old))
        links: dict[int, int] = {}
        for _, id, old in sorted(pairs):
            if id not in links and old not in links.values():
                links[id] = old
        return list(links.items())


class Stitched(NamedTuple):
    """A stitched recording and what was done to it."""

    tracks: Tracks
    before: int  # ids before
    joined: int  # tracks that continue another
    ghosts: int  # rows dropped: of people seen for less than a second, or far away


def stitch(
    tracks: Tracks,
    options: LinkOptions | None = None,
    *,
    period: float = 0.1,
    fill: float = 2.0,
) -> Stitched:
    """Mend a recording; its points are then `period` seconds apart.

    Agents with clocks of their own are resampled to one first; gaps of up to `fill`
    seconds are filled linearly.

    Raises:
        InputError: if nobody is seen for a second.
    """
    tracks = synchronous(tracks)
    ids, joined = stitched_ids(tracks, options)
    names, row = np.unique(ids, return_inverse=True)
    begin, end = np.full((2, len(names)), [[np.inf], [-np.inf]])
    np.minimum.at(begin, row, tracks.stamp)
    np.maximum.at(end, row, tracks.stamp)
    is_person = (end - begin >= BRIEF - SNAP)[row] & (
        np.abs(tracks.position) < FAR
    ).all(axis=1)
    if not is_person.any():
        raise InputError(f"{tracks.recording}: nobody is seen for {BRIEF:g} s")
    mended = tracks.take(is_person).with_ids(ids[is_person])
    mended = resample(
        mended, period, fill, period * np.floor(mended.stamp.min() / period)
    )
    return Stitched(mended, len(np.unique(tracks.id)), joined, int((~is_person).sum()))


def stitched_ids(
    tracks: Tracks, options: LinkOptions | None = None
) -> tuple[np.ndarray, int]:
    """Mended ids [R] of the rows of `synchronous` tracks, and the number of links."""
    stitcher = OnlineStitcher(options, len(tracks.id))
    ids = [stitcher.push(*frame) for frame in frames_of_tracks(tracks)]
    rows = np.argsort(np.lexsort((tracks.id, tracks.stamp)))
    return np.concatenate([*ids, np.zeros(0, np.int64)])[rows], stitcher.joined
