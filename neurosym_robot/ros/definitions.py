"""Definitions of the messages that ROS's own types lack, and the types with them.

What they say is in `ros.people` and `ros.messages`.
"""

from typing import Any, Literal

import numpy as np

from neurosym_jax.errors import InputError

__all__ = [
    "DEFINITIONS",
    "EVENT",
    "EVENTS",
    "FORECAST",
    "HUMANS",
    "HUMANS_TRAJS",
    "PAIR_STATES",
    "PEOPLE",
    "STATES",
    "TRANSFORMS",
    "blank",
    "ros1_name",
    "typestore",
]

PEOPLE = "people_msgs/msg/People"
HUMANS = "darko_perception_msgs/msg/Humans"
HUMANS_TRAJS = "darko_perception_msgs/msg/HumansTrajs"
FORECAST = "neurosym_msgs/msg/Forecast"
EVENT = "neurosym_msgs/msg/Event"
EVENTS = "neurosym_msgs/msg/Events"
PAIR_STATES = "neurosym_msgs/msg/PairStates"
STATES = "neurosym_msgs/msg/States"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

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
    FORECAST: """\
# What one model expects of everybody: all samples, compactly.
# Of the last observed step, and the coordinates' frame.
std_msgs/Header header
string model
# Seconds between steps: step t lies (t + 1) periods after the header's stamp.
float64 period
# K samples of T steps; sample `central` is nearest to all others.
uint32 samples
uint32 steps
uint32 central
# [K], they sum to one.
float32[] weights
# [N]
int64[] ids
# [N] steps up to the header's stamp that nobody saw: the last velocity went on.
uint32[] extrapolated
# [N, 2] metres at the header's stamp.
float64[] position
# [N, 2] metres per second then.
float32[] velocity
# [K, N, T, 2] metres from each person's position.
float32[] futures
""",
    EVENT: """\
# Something that a pair of people will probably do.
# By name, such as passes_left; and in words.
string name
string words
# Ids of who does it, and of the other.
int64 k
int64 l
float32 probability
# Seconds from the header's stamp to the first happening: the median over samples that have it.
float32 seconds
""",
    EVENTS: """\
# What one model makes probable, most probable first; empty where nothing is.
# Of the last observed step, and the coordinates' frame.
std_msgs/Header header
string model
Event[] events
""",
    PAIR_STATES: """\
# How a pair of people will probably move relative to each other.
# Ids of the two.
int64 k
int64 l
# [T] the most probable state of each step, q1 q2 q3 q4 such as -+0+, and its probability.
string[] states
float32[] probability
# [T, 4, 3] of each step, that q1 to q4 are -, 0 and +.
float32[] symbols
""",
    STATES: """\
# What one model makes of the pairs who come nearest to each other, nearest first, 16 at most.
# A pair is there one way round: of (l, k), q1 and q2 change places, and q3 and q4.
# Of the last observed step, and the coordinates' frame.
std_msgs/Header header
string model
# Of the states: c1, in which q1 is - where k moves towards l, q3 - where it moves to the left.
string calculus
# Seconds between steps: step t ends (t + 1) periods after the header's stamp.
float64 period
# Metres per second up to which a movement is 0.
float32 speed
PairStates[] pairs
""",
    TRANSFORMS: """\
geometry_msgs/TransformStamped[] transforms
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
        raise InputError("this needs rosbags: pip install 'neurosym-jax[robot]'") from None
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
    types = {}
    for name, text in DEFINITIONS.items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


def ros1_name(kind: str) -> str:
    """A type as ROS 1 writes it: "package/Name"."""
    return kind.replace("/msg/", "/")


def blank(store: Any, kind: str) -> Any:
    """A message of a typestore with zeros, empty texts and empty lists in it."""
    values = []
    for _, (node, form) in store.fielddefs[kind][1]:
        if node.name == "NAME":
            values.append(blank(store, form))
        elif node.name == "BASE":
            values.append(
                {"string": "", "bool": False}.get(form[0], 0.0 if "float" in form[0] else 0)
            )
        else:  # An array of a length, or of any.
            (node, form), length = form
            numbers = node.name == "BASE" and form[0] not in ("string", "bool")
            values.append(np.zeros(length, form[0].replace("octet", "uint8")) if numbers else [])
    return store.types[kind](*values)
