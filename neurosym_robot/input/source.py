"""A stream of people from messages, as tf2's message filter makes it: one publisher, one frame.

Messages wait, for a bounded time, until /tf brackets their stamps; messages of one
moment are joined. What would be misread, such as two trackers on a topic or coordinates
in a frame that moves, is refused, counted by cause, and reported once in words.
"""

import collections
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.errors import InputError, printable
from neurosym_robot.input.frames import FrameCheck, is_own
from neurosym_robot.input.kinds import Kind, Seen, see
from neurosym_robot.input.transforms import NotYet, Transforms
from neurosym_robot.tracking.following import FAR, RESET, Frame
from neurosym_robot.tracking.kalman import KalmanFilter
from neurosym_robot.tracking.names import UNNAMED

SILENCE = 2.0  # seconds after which a silent publisher may be replaced by another
REACH = 60.0  # metres
HOLD = 0.5  # seconds for which the newest pose of the robot itself still holds
WAIT = 1.0  # seconds that people wait for the transform of their frame
WAITING = 64  # moments that wait at most
PART = 0.01  # seconds between two messages of different people of one moment
JOIN = 0.1  # seconds that a moment waits for its parts at most
SAID = 64  # different reports; more are only counted


class Moment(NamedTuple):
    """Messages of one moment, in order of arrival."""

    parts: list[Seen]
    received: float  # seconds of a monotonic clock, of the first


class PeopleSource:
    """Turns messages of people into the frames of a stream, and reports what it leaves out."""

    def __init__(
        self,
        fixed_frame: str = "",
        report: Callable[[str], None] = print,
        robot_frame: str = "",
        reach: float = REACH,
        form: Kind | None = None,
        only: str = "",
        *,
        recorded: bool = False,
    ):
        """Configure the stream as the options of these names say, see `LiveOptions`.

        `report` is called with one line when something begins to be left out; `form`
        says where messages hold people, by default their type, and `only` which entries
        are people. Parts of a recording's moment are joined from the first on; a frame
        that moves there is an InputError.
        """
        self.fixed_frame, self.robot_frame, self.reach = (
            fixed_frame.strip("/"),
            robot_frame,
            reach,
        )
        self._report, self.form, self._only, self._recorded = (
            report,
            form,
            only,
            recorded,
        )
        self.frame_id: str | None = self.fixed_frame or None
        """Frame of the stream's coordinates; None before the first message."""
        self.transforms = Transforms()
        self.refused: collections.Counter[str] = collections.Counter()
        """Messages or people left out, by cause in words; a node adds "late" and "malformed"."""
        self.reports: dict[str, None] = {}
        """What was reported so far, in order."""
        self.is_there: Callable[[str], bool] = lambda publisher: True
        """Whether a publisher is still connected, if that is known."""
        self._publisher: str | None = None
        self._heard = -math.inf
        self._nearest = KalmanFilter()
        # whether anybody had an id, and a message a time
        self._named = self._stamped = False
        self._newest, self._behind = (
            -math.inf,
            math.inf,
        )  # stamp; arrival of an older one
        self._joins, self._span = (
            recorded,
            JOIN / 2,
        )  # whether and how long moments come in parts
        self._open: Moment | None = None  # to which parts may come
        self._previous: Seen | None = None
        self._queue: collections.deque[Moment] = collections.deque()
        self._check = FrameCheck(self.transforms)

    @property
    def waiting(self) -> bool:
        """Whether people wait for parts of their moment or for a transform."""
        return bool(self._queue or self._open)

    def robot(self, stamp: float) -> np.ndarray | None:
        """[3] metres, metres, radians: the robot's pose in the stream's frame, or None."""
        if not (self.robot_frame and self.frame_id):
            return None
        try:
            matrix = self.transforms.matrix(
                self.robot_frame, self.frame_id, stamp, HOLD
            )
        except LookupError as error:
            self._refuse(
                "robot's place unknown", "the robot's place is unknown", str(error)
            )
            return None
        return np.array([*matrix[:2, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])

    def take(
        self,
        kind: str,
        message: Any,
        publisher: str = "",
        received: float = 0.0,
        clock: float | None = None,
    ) -> list[Frame]:
        """Take in a message of type `kind`; return the frames that are ready now, see `release`.

        `received` is the time of arrival in seconds of any monotonic clock, `clock`
        that of ROS's, by default the same.

        Raises:
            InputError: in a recording, for coordinates that would be misread.
        """
        try:
            seen = see(self.form or kind, message, self._only)
        except (AttributeError, LookupError, TypeError, ValueError) as error:
            self._refuse("malformed", f"{kind}: people cannot be read", str(error))
            return self.release(received)
        if seen.others:
            self._refuse(
                "other classes",
                "entries of other classes are left out",
                "",
                seen.others,
            )
        if not self._is_ours(publisher, received):
            return self.release(received)
        self._stamped |= seen.stamp != 0
        if not self._stamped:  # Simulated time begins at 0, too, and goes on.
            self._refuse(
                "stamped on arrival", "stamps are 0: the time of arrival is taken"
            )
            seen = seen._replace(stamp=received if clock is None else clock)
        previous = self._previous
        joins = (
            self._open is not None and previous is not None and _is_part(previous, seen)
        )
        if not (joins or self._is_in_order(seen.stamp, received)):
            return self.release(received)
        if seen.frames and self.frame_id is None:
            self.frame_id = self._fixed_frame_of(seen.frames[0])
        if self.frame_id is None:
            self.frame_id = None if seen.frames else seen.frame_id
        self._assemble(seen, received)
        return self.release(received)

    def release(self, received: float) -> list[Frame]:
        """The frames whose parts and transforms are there at the time `received`, in order.

        What has waited too long is counted, and left out; infinity ends all waiting.
        """
        if self._open and received - self._open.received > (
            JOIN if self._recorded else self._span
        ):
            self._close()
        frames = []
        while self._queue:
            moment = self._queue[0]
            try:
                frame = self._frame(moment)
            except LookupError as error:
                timely = (
                    received - moment.received <= WAIT and len(self._queue) <= WAITING
                )
                if isinstance(error, NotYet) and timely:
                    break
                text = f"people cannot be taken to {self.frame_id!r}"
                frame = self._refuse("no transform", text, str(error))
            self._queue.popleft()
            frames += [] if frame is None else [frame]
        return frames

    def _fixed_frame_of(self, frame: str) -> str | None:
        """The frame in which people's frames are taken; None while /tf knows none."""
        anchor = self.transforms.anchor(frame)
        if anchor is not None and is_own(anchor):
            text = f"/tf knows no fixed frame above {anchor!r}; --fixed-frame names one"
            self._say(text)
            return None
        return anchor

    def _assemble(self, seen: Seen, received: float) -> None:
        """Add a message to the moment that it belongs to, or begin one."""
        previous = self._previous or seen._replace(ids=seen.ids[:0])
        joins = self._previous is not None and _is_part(previous, seen)
        if joins and len(seen.ids) and len(previous.ids) and not self._joins:
            self._joins = True
            self._say("a moment comes in several messages: they are joined")
        if self._open and joins:
            self._open.parts.append(seen)
            self._span = min(
                JOIN, max(self._span, 2 * (received - self._open.received) + 5e-3)
            )
            ids = np.concatenate([previous.ids, seen.ids])
            self._previous = seen._replace(ids=ids)
            return
        self._close()
        self._previous, self._open = seen, Moment([seen], received)
        if not self._joins:
            self._close()

    def _close(self) -> None:
        if self._open:
            self._queue.append(self._open)
            self._open = None

    def _frame(self, moment: Moment) -> Frame | None:
        """The frame of a moment; None if it is refused; LookupError without its transform."""
        places, seen_from = [], []
        for part in moment.parts:
            if part.frames:
                matrices = [self._to_ours(frame, part.stamp) for frame in part.frames]
                xyz = np.array([matrix[:3, 3] for matrix in matrices]).reshape(-1, 3)
                sensor = self.robot(part.stamp)
            elif part.frame_id == self.frame_id:
                xyz, sensor = part.xyz, self.robot(part.stamp)
            elif not self.fixed_frame:
                text = f"coordinates in {part.frame_id!r} are left out, the stream's are in"
                advice = (
                    f"--fixed-frame {self.frame_id or part.frame_id} transforms them"
                )
                return self._refuse(
                    "other frame", f"{text} {self.frame_id!r}; {advice}"
                )
            else:
                matrix = self._to_ours(part.frame_id, part.stamp)
                xyz, sensor = part.xyz @ matrix[:3, :3].T + matrix[:3, 3], matrix[:2, 3]
            # NaN is left to the window, which counts it; a tracker's "nowhere" is in
            # its own frame.
            far = (np.abs(part.xyz[:, :2]) >= FAR).any(axis=1)
            if sensor is not None:
                far |= np.linalg.norm(xyz[:, :2] - sensor[:2], axis=1) > self.reach
            places.append(xyz[:, :2])
            seen_from.append(far)
        if self._objects(moment.parts[0].frame_id):
            return None
        far, xy = np.concatenate(seen_from), np.concatenate(places)
        ids = np.concatenate([part.ids for part in moment.parts])
        occluded = np.concatenate([part.occluded for part in moment.parts])
        if far.any():
            text = f"people more than {self.reach:g} m from the sensor or robot are left out"
            self._refuse(
                "far people", f"{text}; --reach sets the limit", count=int(far.sum())
            )
        if occluded.any():
            text = "positions that the tracker guesses (is_occluded) are left out"
            self._refuse("occluded people", text, count=int(occluded.sum()))
        left = ~(far | occluded)
        stamp = max(part.stamp for part in moment.parts)
        return Frame(stamp, self._identify(stamp, ids[left], xy[left]), xy[left])

    def _identify(self, stamp: float, ids: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """The ids, with new ones, by nearness, for people who have none."""
        unnamed = ids == UNNAMED
        self._named |= not unnamed.all()
        if unnamed.any():
            ids = ids.copy()
            # Hashes of names are beyond 2**52, numbers of people hardly beyond 2**51.
            ids[unnamed] = self._nearest.push(stamp, xy[unnamed]) + 2**51 * self._named
        return ids

    def _to_ours(self, frame: str, stamp: float) -> np.ndarray:
        return self.transforms.matrix(frame, self.frame_id or "", stamp)

    def _objects(self, frame_id: str) -> bool:
        """Whether coordinates of a message in `frame_id` are refused; InputError in a recording."""
        frame = self.frame_id or ""
        if frame in ("", self.fixed_frame) and frame_id != frame:
            return False
        cause, text = self._check.objection(frame)
        if text and (not cause or self.fixed_frame):  # A frame that was named is meant.
            self._say(text)
        elif text and self._recorded:
            raise InputError(text)
        elif text:
            self._refuse(cause, text)
        return bool(cause) and not self.fixed_frame

    def _is_in_order(self, stamp: float, received: float) -> bool:
        """Whether a message is not older than the one before.

        When two in a row are older, the clock was set back, and what was known is
        forgotten.
        """
        if math.isinf(self._behind) and 0 < self._newest - stamp < RESET:
            self._behind = received
            text = "messages older than the one before are left out"
            self._refuse("out of order", text)
            return False
        if stamp < self._newest:
            self.transforms.forget(min(self._behind, received))
            self._queue.clear()
            self._check.rest.clear()
            self._open = None
            self._refuse(
                "clock set back", "the clock was set back: what was known is forgotten"
            )
        self._newest, self._behind = stamp, math.inf
        return True

    def _is_ours(self, publisher: str, received: float) -> bool:
        current = self._publisher
        silent = received - self._heard > SILENCE
        if (
            current is None
            or silent
            or (current != publisher and not self.is_there(current))
        ):
            if current not in (None, publisher):
                text = f"people come from {publisher} now, not from {current}"
                self._report(printable(text))
            self._publisher = current = publisher
        if publisher == current:
            self._heard = received
            return True
        text = f"people of a second publisher, {publisher}, are left out beside those of {current}"
        self._refuse("other publisher", f"{text}; remap one of them")
        return False

    def _refuse(self, cause: str, text: str, detail: str = "", count: int = 1) -> None:
        """Count what is left out, and report the text once."""
        self.refused[cause] += count
        self._say(text, detail)

    def _say(self, text: str, detail: str = "") -> None:
        if text not in self.reports and len(self.reports) < SAID:
            self.reports[text] = None
            line = f"{text}: {detail}" if detail else text
            # Names of publishers and frames may steer a terminal.
            self._report(printable(line))


def _is_part(before: Seen, seen: Seen) -> bool:
    """Whether a message holds other people of the same moment."""
    gap = abs(seen.stamp - before.stamp)
    if before.frame_id != seen.frame_id and gap != 0:
        return False
    if (before.ids == UNNAMED).any() or (seen.ids == UNNAMED).any():
        return gap == 0 and not np.array_equal(before.xyz, seen.xyz)
    return gap <= PART and not np.isin(seen.ids, before.ids).any()
