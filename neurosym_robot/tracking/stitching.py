"""Stitching: broken tracks are joined frame by frame, live or of a recording, by a filter.

Nobody is withheld, and nothing is taken back.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import SNAP, Tracks, resample
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.following import (
    FAR,
    Frame,
    frames_of_tracks,
    synchronous,
)
from neurosym_robot.tracking.kalman import KalmanFilter, LinkOptions

BRIEF = 1.0  # seconds: who is seen for less in a whole recording is a ghost
FRESH = 2**53  # ids given to people whose own is another person's are from here on


class OnlineStitcher:
    """Gives the people of each frame mended ids: a person keeps the tracker's first one."""

    def __init__(self, options: LinkOptions | None = None, max_tracks: int = 1024):
        """Remember up to `max_tracks` people."""
        self.joined = 0
        """Times at which a person went on under another id of the tracker."""
        self._filter = KalmanFilter(options, max_tracks)
        self._stamp, self._fresh = -np.inf, 0
        self._names: dict[int, int] = {}  # what is published, by the filter's number
        self._ids: dict[int, int] = {}  # the tracker's newest id, by the same

    def mend(self, frame: Frame) -> Frame:
        """The frame under mended ids."""
        return frame._replace(ids=self.push(*frame))

    def push(self, stamp: float, ids: ArrayLike, xy: ArrayLike) -> np.ndarray:
        """[N] int64, mended ids of the people of a frame [s, N whole numbers, m].

        A clock set back begins anew; a frame of the same moment as the one before
        changes nothing.
        """
        ids = np.asarray(ids).astype(np.int64)
        if not np.isfinite(stamp) or stamp == self._stamp:
            names = {id: self._names[number] for number, id in self._ids.items()}
            return np.array([names.get(id, id) for id in ids.tolist()], np.int64)
        self._stamp = float(stamp)
        numbers = self._filter.push(stamp, xy).tolist()
        followed = set(self._filter.numbers.tolist())
        self._ids = {n: id for n, id in self._ids.items() if n in followed}
        self._names = {n: name for n, name in self._names.items() if n in followed}

        mended = []
        for number, id in zip(numbers, ids.tolist()):
            if number not in followed:
                mended.append(id)  # Nobody is withheld: who finds no room keeps the id.
                continue
            if number in self._names:
                self.joined += id != self._ids[number]
            else:
                self._names[number] = self._new_name(id)
            self._ids[number] = id
            mended.append(self._names[number])
        return np.array(mended, np.int64)

    def _new_name(self, id: int) -> int:
        """The tracker's id, or a fresh one where it is the name of somebody else."""
        if id not in self._names.values():
            return id
        self._fresh += 1
        return FRESH + self._fresh


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
    begin = np.full(len(names), np.inf)
    end = np.full(len(names), -np.inf)
    np.minimum.at(begin, row, tracks.stamp)
    np.maximum.at(end, row, tracks.stamp)
    is_long = end - begin >= BRIEF - SNAP
    is_near = (np.abs(tracks.position) < FAR).all(axis=1)
    is_person = is_long[row] & is_near
    if not is_person.any():
        raise InputError(f"{tracks.recording}: nobody is seen for {BRIEF:g} s")

    mended = tracks.take(is_person).with_ids(ids[is_person])
    first_step = np.floor(mended.stamp.min() / period)
    mended = resample(mended, period, fill, start=period * first_step)
    return Stitched(
        tracks=mended,
        before=len(np.unique(tracks.id)),
        joined=joined,
        ghosts=int((~is_person).sum()),
    )


def stitched_ids(
    tracks: Tracks, options: LinkOptions | None = None
) -> tuple[np.ndarray, int]:
    """Mended ids [R] of the rows of `synchronous` tracks, and the number of links."""
    stitcher = OnlineStitcher(options, len(tracks.id))
    ids = [np.zeros(0, np.int64)]
    for frame in frames_of_tracks(tracks):
        ids.append(stitcher.push(*frame))
    in_time = np.lexsort((tracks.id, tracks.stamp))
    rows = np.argsort(in_time)
    return np.concatenate(ids)[rows], stitcher.joined
