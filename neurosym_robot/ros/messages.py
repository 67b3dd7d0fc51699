"""Topics, and what all messages share: headers, people.

Messages come from `new(type)`, which returns empty ones: rclpy's own, or `definitions.blank`. The
way from a message to people is `people.py`.
"""

import copy
from collections.abc import Callable
from typing import Any

from neurosym_robot.online.frames import Frame
from neurosym_robot.ros.definitions import PEOPLE

__all__ = ["New", "forecast_topic", "make_people", "put_stamp"]

New = Callable[[str], Any]
# Where the robot experiment's trackers publish, best first.
PEOPLE_TOPICS = ("/people_tracker/people_filtered", "/people_tracker/people")
TRUTH_TOPIC = "/hri/human_poses_gt"


def forecast_topic(model: str) -> str:
    """Topic of a model's forecasts; "NeuroSyM" and "SGAN" have those of the robot experiment."""
    name = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in model)
    name = {"sgan": "baseline"}.get(name.lower(), name.lower())
    return f"/hri/human_poses_prediction_{name}"


def put_stamp(header: Any, stamp: float, frame_id: str) -> None:
    """Write time [s] and frame into a header."""
    header.stamp.sec, header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    header.frame_id = frame_id


def make_people(new: New, frame: Frame, frame_id: str = "map") -> Any:
    """The People message of a frame."""
    message = new(PEOPLE)
    put_stamp(message.header, frame.stamp, frame_id)
    empty = new("people_msgs/msg/Person")
    for id, (x, y) in zip(frame.ids.tolist(), frame.xy.tolist()):
        person = copy.copy(empty)
        person.name, person.reliability = str(id), 1.0
        person.position = copy.copy(empty.position)
        person.position.x, person.position.y = x, y
        message.people.append(person)
    return message
