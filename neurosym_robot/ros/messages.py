"""The ROS messages of people and their forecasts, the same in bags, on ROS 1 and on ROS 2.

Topics, and the way from plain arrays to a message, which needs the classes of a `rosbags`
typestore; the way back is `ros.people`. Nothing is read, written or sent here.
"""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_robot.online.frame import Frame
from neurosym_robot.ros.definitions import HUMANS, HUMANS_TRAJS, PEOPLE

__all__ = [
    "PEOPLE_TOPICS",
    "TRUTH_TOPIC",
    "WAITING",
    "forecast_topic",
    "make_people",
    "make_trajectories",
]

PEOPLE_TOPICS = ("/people_tracker/people_filtered", "/people_tracker/people")
"""Where the robot experiment's trackers publish, best first."""
TRUTH_TOPIC = "/hri/human_poses_gt"
WAITING = 32
"""Messages of people that wait at most: three seconds of a tracker's."""


def forecast_topic(model: str) -> str:
    """Where the forecasts of a model go; those of the robot experiment have their topics.

    They are "neurosym" for NeuroSyM and "baseline" for SGAN.
    """
    name = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in model)
    name = {"sgan": "baseline"}.get(name.lower(), name.lower())
    return f"/hri/human_poses_prediction_{name}"


def make_people(
    types: Mapping[str, Callable[..., Any]], frame: Frame, frame_id: str = "map"
) -> Any:
    """The People message of a frame; `types` are a typestore's."""
    person, point = types["people_msgs/msg/Person"], types["geometry_msgs/msg/Point"]
    return types[PEOPLE](
        _header(types, frame.stamp, frame_id),
        [
            person(str(id), point(x, y, 0.0), point(0.0, 0.0, 0.0), 1.0, [], [])
            for id, (x, y) in zip(frame.ids.tolist(), frame.xy.tolist())
        ],
    )


def make_trajectories(
    types: Mapping[str, Callable[..., Any]],
    stamp: float,
    steps: ArrayLike,
    ids: np.ndarray,
    xy: ArrayLike,
    covariance: ArrayLike | None = None,
    frame_id: str = "map",
) -> Any:
    """The HumansTrajs message of a forecast: step by step, observed and then expected.

    Args:
        types: of a typestore.
        stamp: seconds, of the last step observed.
        steps: [T] seconds, of every step.
        ids: [N] whole numbers.
        xy: [N, T, 2] metres.
        covariance: [N, T, 2, 2] square metres; zero if None.
        frame_id: of the coordinates.
    """
    prefix = "darko_perception_msgs/msg/"
    point, vector = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Vector3"]
    pose, twist = types["geometry_msgs/msg/Pose"], types["geometry_msgs/msg/Twist"]
    upright = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    zero, unknown = vector(0.0, 0.0, 0.0), np.zeros(36)
    still = types["geometry_msgs/msg/TwistWithCovariance"](twist(zero, zero), unknown)
    skeleton = types[prefix + "HumanSkeletonConfig"](
        "", [], 0, np.zeros(0, np.uint8), np.zeros(0, np.uint8)
    )
    positions = np.asarray(xy, np.float64)
    people, length = positions.shape[:2]
    spread = np.zeros((people, length, 6, 6))
    if covariance is not None:
        spread[..., :2, :2] = covariance
    spread = spread.reshape(people, length, 36)

    def human(n: int, step: int) -> Any:
        x, y = positions[n, step].tolist()
        centroid = types["geometry_msgs/msg/PoseWithCovariance"](
            pose(point(x, y, 0.0), upright), spread[n, step]
        )
        id = int(ids[n]) % 2**64
        return types[prefix + "Human"](id, 1.0, centroid, still, "", [], zero, zero, zero)

    trajectory = [
        types[HUMANS](
            _header(types, at, frame_id), [human(n, step) for n in range(people)], skeleton
        )
        for step, at in enumerate(np.asarray(steps, np.float64).tolist())
    ]
    return types[HUMANS_TRAJS](_header(types, stamp, frame_id), trajectory)


def _header(types: Mapping[str, Callable[..., Any]], stamp: float, frame_id: str) -> Any:
    make: Any = types["std_msgs/msg/Header"]
    sec, nanosec = divmod(round(stamp * 1e9), 10**9)
    fields = {"stamp": types["builtin_interfaces/msg/Time"](sec, nanosec), "frame_id": frame_id}
    if any(field.name == "seq" for field in dataclasses.fields(make)):  # on ROS 1
        fields["seq"] = 0
    return make(**fields)
