"""Frames of any rate as steps of one period, and the tracks of people over steps."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

__all__ = ["Followed", "Step", "Steps"]

SLACK = 1e-3
"""Part of a period by which a frame may be early and count as the step itself."""
LOST = 1.5
"""Periods between two frames from which on nothing is interpolated."""


class Step(NamedTuple):
    """Everybody at one step."""

    number: int
    """Steps since the first; one is skipped where nothing was seen."""
    time: float
    ids: np.ndarray
    """[N] int64."""
    position: np.ndarray
    """[N, 2] metres."""


class Steps:
    """Frames, one after the other, as steps of `period` seconds."""

    def __init__(self, period: float):
        """Begin; the first frame is the first step."""
        self.period = period
        self.number = 0
        self.last: Step | None = None
        self.start = 0.0

    def push(
        self, time: float, ids: np.ndarray, position: np.ndarray
    ) -> Iterator[Step]:
        """The steps up to a frame, `ids [N]` at `position [N, 2]`, after all others."""
        before = self.last
        frame = Step(0, time, ids, position)
        self.last = frame
        if before is None or time - before.time > LOST * self.period:
            # Two numbers further on, nobody's track continues.
            self.number += 2
            self.start = time - self.number * self.period
        slack = SLACK * self.period
        while self.start + self.number * self.period <= time + slack:
            moment = self.start + self.number * self.period
            if before is None or moment > time - slack:
                yield frame._replace(number=self.number, time=time)
            else:
                yield _between(before, frame, moment)._replace(number=self.number)
            self.number += 1


def _between(before: Step, after: Step, time: float) -> Step:
    """Positions at a time between two frames, of the people who are in both."""
    ids, old, new = np.intersect1d(before.ids, after.ids, return_indices=True)
    share = (time - before.time) / (after.time - before.time)
    position = (1 - share) * before.position[old] + share * after.position[new]
    return Step(0, time, ids, position)


class _Person:
    """A person who is followed."""

    def __init__(self, number: int, length: int):
        """A person with a number that is never used twice, whose last `length` steps are kept."""
        self.number, self.length = number, length
        self.seen = 0
        """Number of the last step with the person."""
        self._positions = np.empty((4 * length, 2))
        self._begin = self._end = 0

    @property
    def track(self) -> np.ndarray:
        """[S, 2] positions at the steps up to the last one, without a gap."""
        return self._positions[self._begin : self._end]

    def push(self, step: int, position: np.ndarray) -> None:
        """Take in the position [2] at a step; a gap before it begins a new track."""
        if self.seen != step - 1:
            self._begin = self._end
        self._begin = max(self._begin, self._end + 1 - self.length)
        if self._end == len(self._positions):
            kept = self.track.copy()
            self._begin, self._end = 0, len(kept)
            self._positions[: len(kept)] = kept
        self._positions[self._end] = position
        self._end += 1
        self.seen = step


class Followed:
    """The last `length` steps of everybody."""

    def __init__(self, length: int, first: int = 0):
        """Nobody is followed; people get numbers from `first` on."""
        self.length = length
        self.next = first
        self._people: dict[int, _Person] = {}

    def push(self, step: Step) -> None:
        """Take in a step. A person who was not in the step before begins a new track."""
        for id, position in zip(step.ids.tolist(), step.position):
            person = self._people.get(id)
            if person is None:
                person = _Person(self.next, self.length)
                self._people[id] = person
                self.next += 1
            person.push(step.number, position)
        oldest = step.number - self.length
        self._people = {
            id: person for id, person in self._people.items() if person.seen >= oldest
        }

    def tracks(self, number: int, length: int) -> dict[int, np.ndarray]:
        """The last steps [length, 2] by the person's number.

        Of everybody who is in step `number`, the last one, and was in so many before.
        """
        tracks = {}
        for person in self._people.values():
            track = person.track
            if person.seen == number and len(track) >= length:
                tracks[person.number] = track[-length:].copy()
        return tracks
