"""A stream of people out of messages: of one publisher, in one frame of coordinates.

Two trackers on a topic, or coordinates that change, would be mixed without a trace: people of one
jump to where the other has theirs. Whatever does not belong to the stream is refused, counted, and
said once.
"""

import collections
from collections.abc import Callable
from typing import Any

import numpy as np

from neurosym_robot.online.frame import Frame
from neurosym_robot.ros.people import id_of_name, see
from neurosym_robot.ros.transforms import Transforms
from neurosym_robot.tracking.nearest import NearestIds

__all__ = ["Source"]

SILENCE = 2.0
"""Seconds after which a publisher that says nothing may be replaced by another."""
SAID = 64
"""Different complaints that are said; more are counted only."""


class Source:
    """Turns messages of people into the frames of a stream, and says what it leaves out."""

    def __init__(
        self,
        fixed_frame: str = "",
        several: bool = False,
        report: Callable[[str], None] = print,
        robot_frame: str = "",
    ):
        """Nothing heard yet.

        Args:
            fixed_frame: what the coordinates are taken to, by `transforms`; if empty they stay in
                the frame of the first message, and others are refused.
            several: take in several publishers side by side; their ids are kept apart.
            report: is told, in one line, what begins to be refused.
            robot_frame: the robot's own, such as base_link, where it is to be known where it is.
        """
        self.fixed_frame, self.several, self._report = fixed_frame, several, report
        self.robot_frame = robot_frame
        self.frame_id: str | None = fixed_frame or None
        """Of the stream's coordinates; None before the first message."""
        self.transforms = Transforms()
        """What is told of frames, for `fixed_frame` and `robot_frame`."""
        self.refused: collections.Counter[str] = collections.Counter()
        """Messages left out, by reason."""
        self.is_there: Callable[[str], bool] = lambda publisher: True
        """Whether a publisher may say more, where that is known."""
        self._publisher: str | None = None
        self._heard = -np.inf
        self._said: set[str] = set()
        self._nearest: dict[str, NearestIds] = {}

    @property
    def needs_transforms(self) -> bool:
        """Whether somebody is to tell `transforms`."""
        return bool(self.fixed_frame or self.robot_frame)

    def robot(self, stamp: float) -> np.ndarray | None:
        """[3] metres, metres, radians: where the robot is among the people, as far as is known."""
        if not (self.robot_frame and self.frame_id):
            return None
        try:
            matrix = self.transforms.matrix(self.robot_frame, self.frame_id, stamp)
        except LookupError as error:
            return self._refuse("no_robot", "it is not known where the robot is", str(error))
        return np.array([*matrix[:2, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])

    def take(
        self, kind: str, message: Any, publisher: str = "", received: float = 0.0
    ) -> Frame | None:
        """The frame that a message is; None where it does not belong to the stream.

        Args:
            kind: the message's type, a key of `KINDS`.
            message: of people.
            publisher: who sent it.
            received: seconds of any clock that goes on, when it came.
        """
        seen = see(kind, message)
        if not self._is_ours(publisher, received):
            return None
        if self.frame_id is None:
            self.frame_id = seen.frame_id
        xyz = seen.xyz
        if seen.frame_id != self.frame_id:
            if not self.fixed_frame:
                return self._refuse(
                    "other_frame",
                    f"coordinates in {seen.frame_id!r} are left out, the stream's are in "
                    f"{self.frame_id!r}; --fixed-frame {self.frame_id} transforms them",
                )
            try:
                matrix = self.transforms.matrix(seen.frame_id, self.frame_id, seen.stamp)
            except LookupError as error:
                text = f"{seen.frame_id!r} cannot be taken to {self.frame_id!r}"
                return self._refuse("no_transform", text, str(error))
            xyz = xyz @ matrix[:3, :3].T + matrix[:3, 3]
        xy, ids = xyz[:, :2], seen.ids
        if ids is None:
            # What is far in one publisher's view may be near in another's: each has its own.
            ids = self._nearest.setdefault(publisher, NearestIds()).push(seen.stamp, xy)
        if self.several and publisher != self._publisher:
            ids = np.array([id_of_name(f"{publisher} {id}") for id in ids.tolist()], np.int64)
        return Frame(seen.stamp, ids, xy)

    def _is_ours(self, publisher: str, received: float) -> bool:
        ours = self._publisher
        silent = received - self._heard > SILENCE and not self.several
        if ours is None or silent or (ours != publisher and not self.is_there(ours)):
            if ours not in (None, publisher):
                self._report(f"people come from {publisher} now, not from {ours}")
            self._publisher = publisher
        if publisher == self._publisher:
            self._heard = received
        elif not self.several:
            self._refuse(
                "other_publisher",
                f"people of a second publisher, {publisher}, are left out beside those of "
                f"{self._publisher}; --several-publishers takes both in",
            )
            return False
        return True

    def _refuse(self, reason: str, text: str, detail: str = "") -> None:
        self.refused[reason] += 1
        if text not in self._said and len(self._said) < SAID:
            self._said.add(text)
            self._report(f"{text}: {detail}" if detail else text)
