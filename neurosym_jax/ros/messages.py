"""The ROS messages of people and their forecasts, the same in bags, on ROS 1 and on ROS 2.

Definitions, topics, and the way from a message to plain arrays and back. Messages are any objects
with the right fields; making one needs the classes of a `rosbags` typestore. Nothing is read,
written or sent here.
"""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.online.frame import Frame

__all__ = [
    "DEFINITIONS",
    "HUMANS",
    "HUMANS_TRAJS",
    "PEOPLE",
    "PEOPLE_TOPICS",
    "TRUTH_TOPIC",
    "WAITING",
    "forecast_topic",
    "frame_of_humans",
    "frame_of_people",
    "id_of_name",
    "make_people",
    "make_trajectories",
    "seconds_of",
    "typestore",
]

PEOPLE = "people_msgs/msg/People"
HUMANS = "darko_perception_msgs/msg/Humans"
HUMANS_TRAJS = "darko_perception_msgs/msg/HumansTrajs"

PEOPLE_TOPICS = ("/people_tracker/people_filtered", "/people_tracker/people")
"""Where the robot experiment's trackers publish, best first."""
TRUTH_TOPIC = "/hri/human_poses_gt"
WAITING = 32
"""Messages of people that wait at most: three seconds of a tracker's."""

DEFINITIONS = {
    "people_msgs/msg/Person": """\
string name
geometry_msgs/Point position
geometry_msgs/Point velocity
float64 reliability
string[] tagnames
string[] tags
""",
    PEOPLE: """\
std_msgs/Header header
people_msgs/Person[] people
""",
    "darko_perception_msgs/msg/HumanBodyJoint": """\
string name
float32 detection_score
geometry_msgs/Pose pose
float32[] covariance
""",
    "darko_perception_msgs/msg/Human": """\
uint64 id
float64 confidence
geometry_msgs/PoseWithCovariance centroid
geometry_msgs/TwistWithCovariance velocity
string classified_pose
HumanBodyJoint[] body_joints
geometry_msgs/Vector3 upper_body_orientation
geometry_msgs/Vector3 head_orientation
geometry_msgs/Vector3 gaze_direction
""",
    "darko_perception_msgs/msg/HumanSkeletonConfig": """\
string skeleton_convention
string[] joint_names
uint8 root_joint_idx
uint8[] bone_joint1_idx
uint8[] bone_joint2_idx
""",
    HUMANS: """\
std_msgs/Header header
Human[] humans
HumanSkeletonConfig skeleton_config
""",
    HUMANS_TRAJS: """\
std_msgs/Header header
Humans[] trajs
""",
}
"""The messages that no ROS distribution brings, by name, those used by others first."""


def typestore(ros: Literal[1, 2]) -> Any:
    """The types of ROS 1 (Noetic) or ROS 2 (Jazzy) with ours among them.

    Raises:
        InputError: if rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise InputError("this needs rosbags: pip install 'neurosym-jax[bags]'") from None
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
    types = {}
    for name, text in DEFINITIONS.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


def forecast_topic(model: str) -> str:
    """Where the forecasts of a model go; those of the robot experiment have their topics.

    They are "neurosym" for NeuroSyM and "baseline" for SGAN.
    """
    name = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in model)
    name = {"sgan": "baseline"}.get(name.lower(), name.lower())
    return f"/hri/human_poses_prediction_{name}"


def id_of_name(name: str) -> int:
    """The id of a person's name, the same everywhere: the number it is, or else a hash of it.

    Hashes lie between 2**52 and 2**53, where floats and JavaScript still count in ones.
    """
    if re.fullmatch("-?[0-9]{1,18}", name):
        return int(name)
    return 2**52 | int.from_bytes(hashlib.blake2b(name.encode(), digest_size=6).digest())


def frame_of_people(message: Any) -> Frame:
    """The frame that a People message is."""
    people = message.people
    ids = np.array([id_of_name(person.name) for person in people], np.int64)
    xy = [(person.position.x, person.position.y) for person in people]
    return Frame(seconds_of(message.header.stamp), ids, np.array(xy, np.float64).reshape(-1, 2))


def frame_of_humans(message: Any) -> Frame:
    """The frame that a Humans message is."""
    # Ids count from zero in the message: negative ones wrapped around in `make_trajectories`.
    ids = np.array([human.id for human in message.humans], np.uint64).astype(np.int64)
    points = [human.centroid.pose.position for human in message.humans]
    xy = np.array([(point.x, point.y) for point in points], np.float64).reshape(-1, 2)
    return Frame(seconds_of(message.header.stamp), ids, xy)


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


def seconds_of(stamp: Any) -> float:
    """Of a message's time."""
    return stamp.sec + 1e-9 * stamp.nanosec


def _header(types: Mapping[str, Callable[..., Any]], stamp: float, frame_id: str) -> Any:
    make: Any = types["std_msgs/msg/Header"]
    sec, nanosec = divmod(round(stamp * 1e9), 10**9)
    fields = {"stamp": types["builtin_interfaces/msg/Time"](sec, nanosec), "frame_id": frame_id}
    if any(field.name == "seq" for field in dataclasses.fields(make)):  # on ROS 1
        fields["seq"] = 0
    return make(**fields)
