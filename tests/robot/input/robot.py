"""A robot that drives and turns among people, what it says on ROS's topics, and the truth.

Positions are formulas of time, so that the truth at any stamp is known. People are seen
in the frame of a laser on the robot, unless somebody hides them; /tf comes late,
unevenly, and after the clock was set back.
"""

import dataclasses
import functools
from typing import Any

import numpy as np

from neurosym_robot.ros.definitions import (
    TF_TOPICS,
    TRANSFORMS,
    blank,
    shared_typestore,
)
from neurosym_robot.ros.messages import filled, make_people
from neurosym_robot.tracking.following import Frame

TOPIC = "/people"
SECONDS, START = 12.0, 1000.0
LASER = (0.3, 0.1, 0.4)
"""Where the laser sits on the robot: x, y [m] and yaw."""
Said = tuple[float, str, Any]  # arrival, topic, message


def new(kind: str) -> Any:
    """An empty message of ROS 1."""
    return blank(shared_typestore(1), kind)


def transform(at: float, parent: str, child: str, x, y=0.0, yaw=0.0, new=new) -> Any:
    """A TFMessage: `child` lies at `x`, `y` [m] in `parent` at a stamp, turned by `yaw`."""
    sec, nanosec = divmod(round(at * 1e9), 10**9)
    row = filled(
        new("geometry_msgs/msg/TransformStamped"),
        header={"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": parent},
        child_frame_id=child,
        transform={
            "translation": {"x": x, "y": y},
            "rotation": {"z": np.sin(yaw / 2), "w": np.cos(yaw / 2)},
        },
    )
    return filled(new(TRANSFORMS), transforms=[row])


def pose(t: float) -> tuple[float, float, float]:
    """The robot's x, y [m] and yaw in `map` at `t` seconds: up to 0.9 m/s and 1.2 rad/s."""
    return 0.6 * np.sin(1.5 * t), 0.4 * t, 0.8 * np.sin(1.5 * t)


def odometry(t: float) -> tuple[float, float, float]:
    """Where `odom` lies in `map`: it drifts."""
    return 0.01 * t, 0.3, 0.2 + 0.002 * t


def people(t: float) -> np.ndarray:
    """[5, 2] metres in `map`: two who stand, and three who walk."""
    walk = 1.2 * (t - 6)
    return np.array(
        [[3, 4], [-2, 6], [walk, 3.0], [2.0, walk], [-walk, 8 + 0.5 * np.sin(t)]]
    )


@dataclasses.dataclass
class Drive:
    """What the robot's processes send, and when it arrives."""

    late: float = 0.0  # seconds by which /tf comes late
    jitter: float = 0.0  # further seconds, drawn for each message
    reordered: bool = False  # whether a message can overtake another
    back: float = 0.0  # seconds by which all clocks are set back, amid the drive

    def clock(self, t: float) -> float:
        """The stamp of a moment."""
        return START + t - self.back * (t >= SECONDS / 2)

    def messages(self, new=new) -> list[Said]:
        """All messages, of the types of `new`, in order of arrival."""
        tf, rng = functools.partial(transform, new=new), np.random.default_rng(0)
        sent = [(0.0, TF_TOPICS[1], tf(0.0, "base", "laser", *LASER))]
        for k in range(int(50 * SECONDS)):
            t = k / 50
            base = tf(
                self.clock(t), "odom", "base", *_compose(_invert(odometry(t)), pose(t))
            )
            sent.append((self._delay(rng, t), TF_TOPICS[0], base))
            if k % 3 == 0:
                odom = tf(self.clock(t), "map", "odom", *odometry(t))
                sent.append((self._delay(rng, t), TF_TOPICS[0], odom))
        for k in range(int(10 * SECONDS)):
            t = k / 10 + 0.037
            people = make_people(new, self._seen(t), "laser")
            sent.append((START + t + 0.02, TOPIC, people))
        order = sorted(sent, key=lambda row: row[0])
        if self.reordered:
            return order
        # One connection keeps the order: who is overtaken delays the others.
        lines = iter(sorted(row[0] for row in sent if row[1] == TF_TOPICS[0]))
        transforms = [(next(lines), *row[1:]) for row in sent if row[1] == TF_TOPICS[0]]
        others = [row for row in sent if row[1] != TF_TOPICS[0]]
        return sorted(transforms + others, key=lambda row: row[0])

    def _delay(self, rng: np.random.Generator, t: float) -> float:
        return START + t + self.late + rng.uniform(0, self.jitter)

    def _seen(self, t: float) -> Frame:
        """The people in the laser's frame whom no other person hides."""
        laser = _compose(pose(t), LASER)
        local = np.array(
            [_compose(_invert(laser), (*place, 0.0))[:2] for place in people(t)]
        )
        far, angle = np.hypot(*local.T), np.arctan2(*local.T[::-1])
        turn = np.abs(np.angle(np.exp(1j * (angle[:, None] - angle))))
        hidden = ((turn < 0.3 / far) & (far < far[:, None] - 0.5)).any(axis=1)
        ids = np.arange(len(local)) + 10 * (t >= SECONDS / 2 and self.back > 0)
        return Frame(self.clock(t), ids[~hidden], local[~hidden])

    def truth(self, at: float, ids: np.ndarray) -> np.ndarray:
        """[N, 2] metres at a stamp of people, who have other ids after the clock was set back."""
        places = [
            people(at - START + self.back * (id >= 10))[id % 10] for id in ids.tolist()
        ]
        return np.array(places).reshape(-1, 2)


def _compose(first, second) -> tuple[float, float, float]:
    x, y, yaw = first
    c, s = np.cos(yaw), np.sin(yaw)
    return (
        x + c * second[0] - s * second[1],
        y + s * second[0] + c * second[1],
        yaw + second[2],
    )


def _invert(place) -> tuple[float, float, float]:
    x, y, yaw = place
    c, s = np.cos(yaw), np.sin(yaw)
    return -c * x - s * y, s * x - c * y, -yaw
