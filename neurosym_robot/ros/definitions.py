"""Endings of bags; topics, types and definitions of messages.

Those that ROS's own types lack are in `msg/`. Two folders in it are links to the
packages in `ros/` that catkin and colcon build.
"""

import collections
import functools
import os
import re
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from neurosym_jax.errors import InputError

PEOPLE = "people_msgs/msg/People"
HUMANS = "darko_perception_msgs/msg/Humans"
HUMANS_TRAJS = "darko_perception_msgs/msg/HumansTrajs"
FORECAST = "neurosym_msgs/msg/Forecast"
EVENTS = "neurosym_msgs/msg/Events"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
TF_TYPES = (TRANSFORMS, "tf/msg/tfMessage")
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
GRID = "nav_msgs/msg/OccupancyGrid"
MARKER = "visualization_msgs/msg/Marker"
MARKERS = f"{MARKER}Array"

# Where the robot experiment's trackers publish, best first.
PEOPLE_TOPICS = ("/people_tracker/people_filtered", "/people_tracker/people")
FORECAST_TOPIC = "/hri/human_poses_prediction"
TRUTH_TOPIC = "/hri/human_poses_gt"
TF_TOPICS = ("/tf", "/tf_static")
# Endings of a ROS 1 bag and of the files in the folder of a ROS 2 bag, and what mends
# them.
TOOLS = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "ros2 bag reindex"}


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: by its name, or a folder with the parts of one.

    Those are files of ROS 2, or of ROS 1 with the names that `rosbag record --split`
    gives them.
    """
    if path.suffix in TOOLS or os.path.isfile(path / "metadata.yaml"):
        return True
    if not os.path.isdir(path):
        return False
    files = [file.name for file in path.iterdir() if os.path.isfile(file)]
    numbered = [
        re.fullmatch(r"(.*)_[0-9]+(\.bag|\.mcap|\.db3)", name) for name in files
    ]
    split = all(numbered) and len({part.groups() for part in numbered if part}) == 1
    return split or (len(files) == 1 and files[0].endswith((".mcap", ".db3")))


@functools.cache
def definitions() -> dict[str, str]:
    """Texts of the definitions by type, such as "people_msgs/msg/People"."""
    folders = files("neurosym_robot.ros").joinpath("msg").iterdir()
    texts = {}
    for folder in folders:
        for file in folder.iterdir():
            kind = file.name.removesuffix(".msg")
            texts[f"{folder.name}/msg/{kind}"] = file.read_text()
    return texts


def typestore(ros: Literal[1, 2]) -> Any:
    """The types of ROS 1 (Noetic) or ROS 2 (Jazzy) with ours among them.

    Raises:
        InputError: if rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise InputError(
            "this needs rosbags: pip install 'neurosym-jax[robot]'"
        ) from None
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_JAZZY)
    types = (get_types_from_msg(text, name) for name, text in definitions().items())
    store.register(dict(collections.ChainMap(*types)))
    return store


shared_typestore = functools.cache(typestore)
"""A typestore that is made once; types must not be added to it."""


def ros1_name(kind: str) -> str:
    """A type as ROS 1 writes it: "package/Name"."""
    return kind.replace("/msg/", "/")


def blank(store: Any, kind: str, points: int | None = None) -> Any:
    """A message of a typestore with zeros, empty texts and empty lists in it.

    In a Marker or MarkerArray with a number of `points` those of a marker are an array,
    `xyz` with their `count` before it: the same bytes as those of a list of points,
    without its objects.
    """
    if points is not None:
        kind = f"{kind}{points}"
        if kind not in store.fielddefs:
            _register_lines(store, points)
    form = store.get_msgdef(kind)
    # From more zeros than an empty message of any type has.
    return form.deserialize_ros1(bytes(2**13), 0, form.cls, store)[0]


def _register_lines(store: Any, points: int) -> None:
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import get_types_from_msg

    marker, line = f"{MARKER}{points}", f"geometry_msgs/msg/Line{points}"
    constants, fields = store.fielddefs[MARKER]
    forms = dict(fields) | {"points": (Nodetype.NAME, line)}
    store.register(
        get_types_from_msg(f"uint32 count\nfloat64[{3 * points}] xyz", line)
        | get_types_from_msg(f"{ros1_name(marker)}[] markers", f"{MARKERS}{points}")
        | {marker: (constants, list(forms.items()))}
    )


def seconds_of(stamp: Any) -> float:
    """Seconds of a message's time."""
    return stamp.sec + 1e-9 * stamp.nanosec
