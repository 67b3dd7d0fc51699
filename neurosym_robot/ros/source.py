"""A stream of people from messages: of one publisher, in one frame of coordinates.

Two trackers on a topic, or coordinates in changing frames, would be mixed silently. Messages that
do not belong to the stream are refused, counted, and reported once.
"""

import collections
from collections.abc import Callable
from typing import Any

import numpy as np

from neurosym_robot.online.frames import Frame
from neurosym_robot.ros.people import see
from neurosym_robot.ros.transforms import Transforms
from neurosym_robot.tracking.following import FAR, NearestIds

__all__ = ["REACH", "PeopleSource"]

SILENCE = 2.0  # seconds after which a silent publisher may be replaced by another
REACH = 60.0  # metres
SAID = 64  # different reasons that are reported; more are only counted


class PeopleSource:
    """Turns messages of people into the frames of a stream, and reports what it leaves out."""

    def __init__(
        self,
        fixed_frame: str = "",
        report: Callable[[str], None] = print,
        robot_frame: str = "",
        reach: float = REACH,
    ):
        """Configure the stream as the options of these names say, see `LiveOptions`.

        `report` is called with one line when messages begin to be refused.
        """
        self.fixed_frame, self._report = fixed_frame, report
        self.robot_frame, self.reach = robot_frame, reach
        self.needs_transforms = bool(fixed_frame or robot_frame)
        self.frame_id: str | None = fixed_frame or None
        """Of the stream's coordinates; None before the first message."""
        self.transforms = Transforms()
        self.refused: collections.Counter[str] = collections.Counter()
        """Number of messages left out, by reason; and of "far_people"."""
        self.is_there: Callable[[str], bool] = lambda publisher: True
        """Whether a publisher is still connected, if that is known."""
        self._publisher: str | None = None
        self._heard = -np.inf
        self._said: set[str] = set()
        self._nearest = NearestIds()

    def robot(self, stamp: float) -> np.ndarray | None:
        """[3] metres, metres, radians: the robot's pose in the stream's frame, or None."""
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
        """The frame of a message of type `kind`; None if it does not belong to the stream.

        `received` is the time of arrival in seconds of any monotonic clock.
        """
        seen = see(kind, message)
        if not self._is_ours(publisher, received):
            return None
        self.frame_id = self.frame_id or seen.frame_id
        xyz, sensor = seen.xyz, None
        if seen.frame_id == self.frame_id:
            sensor = self.robot(seen.stamp) if self.robot_frame else None
        elif not self.fixed_frame:
            return self._refuse(
                "other_frame",
                f"coordinates in {seen.frame_id!r} are left out, the stream's are in "
                f"{self.frame_id!r}; --fixed-frame {self.frame_id} transforms them",
            )
        else:
            try:
                matrix = self.transforms.matrix(seen.frame_id, self.frame_id, seen.stamp)
            except LookupError as error:
                text = f"{seen.frame_id!r} cannot be taken to {self.frame_id!r}"
                return self._refuse("no_transform", text, str(error))
            xyz, sensor = xyz @ matrix[:3, :3].T + matrix[:3, 3], np.zeros(2)
        # NaN is left to the window, which counts it.
        near = ~np.any(np.abs(seen.xy) >= FAR, axis=1)
        if sensor is not None:
            near &= ~(np.linalg.norm(seen.xy - sensor[:2], axis=1) > self.reach)
        if not near.all():
            self.refused["far_people"] += int((~near).sum())
            text = f"people more than {self.reach:g} m from the sensor or robot are left out"
            self._say(f"{text}; --reach sets the limit")
        xy = xyz[near, :2]
        ids = self._nearest.push(seen.stamp, xy) if seen.ids is None else seen.ids[near]
        return Frame(seen.stamp, ids, xy)

    def _is_ours(self, publisher: str, received: float) -> bool:
        ours = self._publisher
        silent = received - self._heard > SILENCE
        if ours is None or silent or (ours != publisher and not self.is_there(ours)):
            if ours not in (None, publisher):
                self._report(f"people come from {publisher} now, not from {ours}")
            self._publisher = ours = publisher
        if publisher == ours:
            self._heard = received
        else:
            text = f"people of a second publisher, {publisher}, are left out beside those of {ours}"
            self._refuse("other_publisher", f"{text}; remap one of them")
        return publisher == ours

    def _refuse(self, reason: str, text: str, detail: str = "") -> None:
        self.refused[reason] += 1
        self._say(text, detail)

    def _say(self, text: str, detail: str = "") -> None:
        """Report a text once."""
        if text not in self._said and len(self._said) < SAID:
            self._said.add(text)
            self._report(f"{text}: {detail}" if detail else text)
