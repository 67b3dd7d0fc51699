"""Ids and positions from messages of people, of the types in `KINDS`."""

import hashlib
import re
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from neurosym_robot.ros.definitions import HUMANS, PEOPLE

__all__ = ["KINDS", "POSES", "Kind", "Seen", "id_of_name", "seconds_of", "see"]

POSES = "geometry_msgs/msg/PoseArray"


class Seen(NamedTuple):
    """What a message says."""

    stamp: float  # seconds, of its header
    frame_id: str  # of the coordinates, without the slash of ROS's early names
    ids: np.ndarray | None  # [N] int64; None if a person has no id
    xyz: np.ndarray  # [N, 3] metres

    @property
    def xy(self) -> np.ndarray:
        """[N, 2] metres."""
        return self.xyz[:, :2]


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
    points = map(attrgetter(form.position), people)
    return Seen(
        seconds_of(message.header.stamp),
        message.header.frame_id.removeprefix("/"),
        None if None in ids else np.array(ids, np.int64),
        np.array([(at.x, at.y, at.z) for at in points], np.float64).reshape(-1, 3),
    )


def seconds_of(stamp: Any) -> float:
    """Of a message's time."""
    return stamp.sec + 1e-9 * stamp.nanosec
