"""A stream of people from messages of the types in `KINDS`: of one publisher, in one frame.

Two trackers on a topic, or coordinates in changing frames, would be mixed silently. Messages that
do not belong to the stream are refused, counted, and reported once.
"""

import bisect
import collections
import hashlib
import re
import threading
from collections.abc import Callable
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from neurosym_robot.ros.definitions import HUMANS, PEOPLE, seconds_of
from neurosym_robot.tracking.following import FAR, Frame, NearestIds

POSES = "geometry_msgs/msg/PoseArray"
SILENCE = 2.0  # seconds after which a silent publisher may be replaced by another
REACH = 60.0  # metres
KEPT = 10.0  # seconds of each coordinate frame's past
AHEAD = 0.5  # seconds for which the newest pose of a coordinate frame still holds
SAID = 64  # different reasons that are reported; more are only counted


class Seen(NamedTuple):
    """What a message says."""

    stamp: float  # seconds, of its header
    frame_id: str  # of the coordinates, without the slash of ROS's early names
    ids: np.ndarray | None  # [N] int64; None if a person has no id
    xyz: np.ndarray  # [N, 3] metres


class Kind(NamedTuple):
    """Where a type of message has its people."""

    people: str  # field with one entry per person
    position: str  # path from an entry to its x, y, z
    id: Callable[[Any], int | None]  # id of an entry; None if it has none


def id_of_name(name: str) -> int:
    """The id of a person's name: the number it is, or else a hash of it.

    Hashes lie between 2**52 and 2**53, where floats and JavaScript still represent every integer.
    """
    if re.fullmatch("-?[0-9]{1,18}", name):
        return int(name)
    return 2**52 | int.from_bytes(hashlib.blake2b(name.encode(), digest_size=6).digest())


def _signed(id: int) -> int:
    """A uint64 as the int64 with the same bits, as which negative ids are written."""
    return (int(id) + 2**63) % 2**64 - 2**63


def _id_of_detection(detection: Any) -> int | None:
    """The field is `id` since ROS 2 Humble, `tracking_id` before; on ROS 1 there is none."""
    name = getattr(detection, "id", "") or getattr(detection, "tracking_id", "")
    return id_of_name(name) if name else None


# Messages of people by type, as ROS 2 writes it.
KINDS = {
    PEOPLE: Kind("people", "position", lambda person: id_of_name(person.name)),
    HUMANS: Kind("humans", "centroid.pose.position", lambda human: _signed(human.id)),
    "spencer_tracking_msgs/msg/TrackedPersons": Kind(
        "tracks", "pose.pose.position", lambda track: _signed(track.track_id)
    ),
    "hunav_msgs/msg/Agents": Kind("agents", "position.position", lambda agent: agent.id),
    "vision_msgs/msg/Detection3DArray": Kind(
        "detections", "bbox.center.position", _id_of_detection
    ),
    POSES: Kind("poses", "position", lambda pose: None),
}


def see(kind: str, message: Any) -> Seen:
    """What a message of type `kind`, a key of `KINDS`, says."""
    form = KINDS[kind]
    people = list(getattr(message, form.people))
    ids = [form.id(each) for each in people]
    return Seen(
        seconds_of(message.header.stamp),
        message.header.frame_id.removeprefix("/"),
        None if None in ids else np.array(ids, np.int64),
        np.array(
            [(at.x, at.y, at.z) for at in map(attrgetter(form.position), people)], np.float64
        ).reshape(-1, 3),
    )


class Transforms:
    """Poses of coordinate frames in each other over time; safe to use from any thread.

    The part of ROS's tf2 that a stream of people needs, for ROS 1, ROS 2 and bags.
    """

    def __init__(self):
        # By frame: its parent, and by time its poses there, translation and quaternion x y z w [7].
        self._edges: dict[str, tuple[str, list[tuple[float, np.ndarray]]]] = {}
        self._lock = threading.Lock()

    def hear(self, message: Any, static: bool = False) -> None:
        """Take in a `tf2_msgs/TFMessage`; `static` ones, of /tf_static, hold at all times."""
        for each in message.transforms:
            at, turn = each.transform.translation, each.transform.rotation
            pose = np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w], np.float64)
            if not (np.isfinite(pose).all() and np.linalg.norm(pose[3:]) > 1e-6):
                continue
            child, parent = each.child_frame_id.strip("/"), each.header.frame_id.strip("/")
            stamp = -np.inf if static else seconds_of(each.header.stamp)
            with self._lock:
                before, poses = self._edges.get(child, ("", []))
                newest = poses[-1][0] if poses else stamp
                if before != parent or static or stamp < newest - KEPT:
                    poses = []  # Another parent, or the clock was set back.
                bisect.insort_left(poses, (stamp, pose), key=itemgetter(0))
                oldest = bisect.bisect_left(poses, poses[-1][0] - KEPT, key=itemgetter(0))
                self._edges[child] = parent, poses[oldest:]

    def matrix(self, source: str, target: str, stamp: float) -> np.ndarray:
        """[4, 4] from coordinates in `source` to those in `target` at `stamp` seconds.

        Raises:
            LookupError: with the reason, if it is not known.
        """
        with self._lock:
            up, down = self._to_root(source), self._to_root(target)
            common = next((frame for frame in up if frame in down), None)
            if common is None:
                raise LookupError(f"no transform between {source} and {target}")
            there, back = (
                self._along(frames[: frames.index(common)], stamp) for frames in (up, down)
            )
        return np.linalg.inv(back) @ there

    def _to_root(self, frame: str) -> list[str]:
        """The frame, its parent, and so on; each once, should they form a circle."""
        frames = [frame]
        while (edge := self._edges.get(frames[-1])) is not None and edge[0] not in frames:
            frames.append(edge[0])
        return frames

    def _along(self, frames: list[str], stamp: float) -> np.ndarray:
        matrix, step = np.eye(4), np.eye(4)
        for frame in frames:
            pose = _pose_at(frame, self._edges[frame][1], stamp)
            step[:3, :3], step[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
            matrix = step @ matrix
        return matrix


def _pose_at(frame: str, poses: list[tuple[float, np.ndarray]], stamp: float) -> np.ndarray:
    """[7] pose of a frame in its parent, linear between two of those known."""
    begin, end = poses[0][0], poses[-1][0]
    if not begin <= stamp <= end + AHEAD and begin > -np.inf:
        raise LookupError(
            f"where {frame} lies is known from {begin:.2f} to {end:.2f} s, not at {stamp:.2f}"
        )
    after = bisect.bisect_right(poses, stamp, key=itemgetter(0))
    (before, first), (then, last) = poses[after - 1], poses[min(after, len(poses) - 1)]
    share = (stamp - before) / (then - before) if then > before else 0.0
    # q and -q are the same rotation. Between messages a robot turns so little that linear and
    # spherical interpolation agree.
    if first[3:] @ last[3:] < 0:
        last = np.concatenate([last[:3], -last[3:]])
    return (1 - share) * first + share * last


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
        """Frame of the stream's coordinates; None before the first message."""
        self.transforms = Transforms()
        self.refused: collections.Counter[str] = collections.Counter()
        """Number of messages left out, by reason; and of "far_people". A node adds "late" ones, too
        many of which waited, and "malformed" ones."""
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
        matrix = self._matrix(self.robot_frame, stamp, "no_robot", "the robot's place is unknown")
        if matrix is None:
            return None
        return np.array([*matrix[:2, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])

    def take(
        self, kind: str, message: Any, publisher: str = "", received: float = 0.0
    ) -> Frame | None:
        """The frame of a message of type `kind`; None if it does not belong to the stream.

        `received` is the time of arrival in seconds of any monotonic clock.
        """
        stamp, frame_id, ids, xyz = see(kind, message)
        if not self._is_ours(publisher, received):
            return None
        self.frame_id = ours = self.frame_id or frame_id
        seen, sensor = xyz[:, :2], None
        if frame_id == ours:
            sensor = self.robot(stamp)
        elif not self.fixed_frame:
            text = f"coordinates in {frame_id!r} are left out, the stream's are in {ours!r}"
            return self._refuse("other_frame", f"{text}; --fixed-frame {ours} transforms them")
        else:
            text = f"{frame_id!r} cannot be taken to {ours!r}"
            matrix = self._matrix(frame_id, stamp, "no_transform", text)
            if matrix is None:
                return None
            xyz, sensor = xyz @ matrix[:3, :3].T + matrix[:3, 3], np.zeros(2)
        # NaN is left to the window, which counts it.
        near = ~np.any(np.abs(seen) >= FAR, axis=1)
        if sensor is not None:
            near &= ~(np.linalg.norm(seen - sensor[:2], axis=1) > self.reach)
        if not near.all():
            text = f"people more than {self.reach:g} m from the sensor or robot are left out"
            self._refuse("far_people", f"{text}; --reach sets the limit", count=int((~near).sum()))
        xy = xyz[near, :2]
        return Frame(stamp, self._nearest.push(stamp, xy) if ids is None else ids[near], xy)

    def _matrix(self, frame: str, stamp: float, reason: str, text: str) -> np.ndarray | None:
        """[4, 4] from a frame to the stream's; None, and counted, if it is not known."""
        try:
            return self.transforms.matrix(frame, self.frame_id or "", stamp)
        except LookupError as error:
            return self._refuse(reason, text, str(error))

    def _is_ours(self, publisher: str, received: float) -> bool:
        ours = self._publisher
        silent = received - self._heard > SILENCE
        if ours is None or silent or (ours != publisher and not self.is_there(ours)):
            if ours not in (None, publisher):
                self._report(f"people come from {publisher} now, not from {ours}")
            self._publisher = ours = publisher
        if publisher == ours:
            self._heard = received
            return True
        text = f"people of a second publisher, {publisher}, are left out beside those of {ours}"
        self._refuse("other_publisher", f"{text}; remap one of them")
        return False

    def _refuse(self, reason: str, text: str, detail: str = "", count: int = 1) -> None:
        """Count what is left out, and report the text once."""
        self.refused[reason] += count
        if text not in self._said and len(self._said) < SAID:
            self._said.add(text)
            self._report(f"{text}: {detail}" if detail else text)
