"""Topics, types and definitions of messages; those that ROS's own types lack are in `msg/`.

Two folders in `msg/` are links to the packages in `ros/` that catkin and colcon build.
"""

import functools
from collections.abc import Mapping
from importlib.resources import files
from typing import Any, Literal

import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["Decoder", "blank", "definitions", "ros1_name", "seconds_of", "shared_typestore"]
__all__ += ["typestore"]

PEOPLE = "people_msgs/msg/People"
HUMANS = "darko_perception_msgs/msg/Humans"
HUMANS_TRAJS = "darko_perception_msgs/msg/HumansTrajs"
FORECAST = "neurosym_msgs/msg/Forecast"
EVENTS = "neurosym_msgs/msg/Events"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MARKERS = "visualization_msgs/msg/MarkerArray"

# Where the robot experiment's trackers publish, best first.
PEOPLE_TOPICS = ("/people_tracker/people_filtered", "/people_tracker/people")
TRUTH_TOPIC = "/hri/human_poses_gt"
TF_TOPICS = ("/tf", "/tf_static")


@functools.cache
def definitions() -> dict[str, str]:
    """Texts of the definitions by type, such as "people_msgs/msg/People"."""
    folders = files("neurosym_robot.ros").joinpath("msg").iterdir()
    return {
        f"{folder.name}/msg/{file.name.removesuffix('.msg')}": file.read_text()
        for folder in folders
        for file in folder.iterdir()
    }


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
    for name, text in definitions().items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


shared_typestore = functools.cache(typestore)
"""A typestore that is made once; types must not be added to it."""


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
        else:  # An array of fixed or any length.
            (node, form), length = form
            numbers = node.name == "BASE" and form[0] not in ("string", "bool")
            values.append(np.zeros(length, form[0].replace("octet", "uint8")) if numbers else [])
    return store.types[kind](*values)


def seconds_of(stamp: Any) -> float:
    """Of a message's time."""
    return stamp.sec + 1e-9 * stamp.nanosec


class Decoder:
    """Reads messages of ROS 1 of some types, each defined as its publisher defines it.

    A type that we define is refused if its publisher's definition differs. Raises InputError if
    rosbags is not installed.
    """

    def __init__(self, kinds: Mapping[str, Any]):
        self._kinds = kinds
        self._learned: dict[tuple[str, str], Any] = {}
        self.store = typestore(1)

    def refuse(self, header: Mapping[str, str]) -> str | None:
        """Why messages of a publisher with this header cannot be read, or None."""
        kind, md5 = header.get("type", "").replace("/", "/msg/"), header.get("md5sum", "")
        if kind not in self._kinds:
            return f"none of {', '.join(map(ros1_name, self._kinds))}"
        if kind in definitions():
            ours = self.store.generate_msgdef(kind, ros_version=1)[1]
            return None if md5 == ours else f"not {ros1_name(kind)} with md5 {ours}"
        from rosbags.typesys import get_types_from_msg

        store = typestore(1)
        try:
            types = get_types_from_msg(header.get("message_definition", ""), kind)
            store.register({name: form for name, form in types.items() if name not in store.types})
            theirs = store.generate_msgdef(kind, ros_version=1)[1]
        except Exception as error:  # The text is not ours and can make the parser raise anything.
            return f"whose definition cannot be read ({type(error).__name__})"
        if theirs != md5:
            return f"whose definition has the md5 {theirs}"
        self._learned[kind, md5] = store
        return None

    def decode(self, data: bytes, header: Mapping[str, str]) -> tuple[str, Any]:
        """Type and message.

        Raises:
            rosbags.serde.SerdeError: for bytes that are no such message.
        """
        kind = header["type"].replace("/", "/msg/")
        store = self._learned.get((kind, header["md5sum"]), self.store)
        return kind, store.deserialize_ros1(data, kind)
