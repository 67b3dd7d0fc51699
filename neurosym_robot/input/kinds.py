"""Where the messages of trackers hold their people: a table of types, and paths for any other."""

import dataclasses
import itertools
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_robot.ros.definitions import HUMANS, PEOPLE, seconds_of
from neurosym_robot.tracking.names import UNNAMED, id_of_name

POSES = "geometry_msgs/msg/PoseArray"
HRI = "hri_msgs/msg/IdsList"


@dataclasses.dataclass(frozen=True)
class Kind:
    """Paths of fields, with dots between their names; a number is a place in a list."""

    people: str  # field with one entry per person
    # from an entry to x, y, z; empty: entries name frames of /tf
    position: str = "position"
    id: str = ""
    """From an entry to a number or name, `|` between alternatives; or a field of the message with
    as many entries as people. Empty: people have no ids."""
    # from an entry to whether the tracker guesses the position, unseen
    occluded: str = ""
    only: str = ""  # PATH=VALUE[,VALUE] of the entries that are people; empty: all are


_TRACKS = Kind("tracks", "pose.pose.position", "track_id", "is_occluded")
_ZED = Kind("objects", id="label_id", only="label=Person")
KINDS = {
    PEOPLE: Kind("people", id="name"),
    HUMANS: Kind("humans", "centroid.pose.position", "id"),
    "spencer_tracking_msgs/msg/TrackedPersons": _TRACKS,
    "pedsim_msgs/msg/TrackedPersons": _TRACKS,
    "bayes_people_tracker/msg/PeopleTracker": Kind("poses", id="uuids"),
    "leg_tracker/msg/PersonArray": Kind("people", "pose.position", "id"),
    "hunav_msgs/msg/Agents": Kind("agents", "position.position", "id"),
    # `id` since ROS 2 Humble, `tracking_id` before; on ROS 1 there is none.
    "vision_msgs/msg/Detection3DArray": Kind(
        "detections", "bbox.center.position", "id|tracking_id"
    ),
    "derived_object_msgs/msg/ObjectArray": Kind(
        "objects",
        "pose.position",
        "id",
        only="classification=4",  # CLASSIFICATION_PEDESTRIAN
    ),
    "nav2_dynamic_msgs/msg/ObstacleArray": Kind("obstacles", id="id"),
    "autoware_perception_msgs/msg/TrackedObjects": Kind(
        "objects",
        "kinematics.pose_with_covariance.pose.position",
        "object_id",
        only="classification.0.label=7",  # PEDESTRIAN
    ),
    "zed_msgs/msg/ObjectsStamped": _ZED,
    "zed_interfaces/msg/ObjectsStamped": _ZED,
    POSES: Kind("poses"),
    HRI: Kind("ids", ""),
}
"""Messages of people by type, as ROS 2 writes it; `register_message` adds one."""


def register_message(name: str, kind: Kind) -> None:
    """Read messages of the type `name`, such as "my_msgs/msg/People", as `kind` says.

    Raises:
        InputError: for a name that is no type, or that another kind has.
    """
    if not re.fullmatch(r"\w+/msg/\w+", name):
        raise InputError(f"{name}: a type of messages is PACKAGE/msg/NAME")
    if KINDS.get(name, kind) != kind:
        raise InputError(f"{name}: is read as {KINDS[name]} already")
    KINDS[name] = kind


def kinds_of(name: str) -> list[str]:
    """The types of `KINDS` that a name means: NAME, PACKAGE/NAME or PACKAGE/msg/NAME."""
    package, _, last = name.rpartition("/")
    package = package.removesuffix("/msg")
    return [
        kind
        for kind in KINDS
        if kind.endswith(f"/msg/{last}") and (not package or kind == full_type(name))
    ]


def full_type(name: str) -> str:
    """PACKAGE/msg/NAME of a type that may be written as ROS 1 does, PACKAGE/NAME."""
    package, _, last = name.rpartition("/")
    return f"{package.removesuffix('/msg')}/msg/{last}"


class Seen(NamedTuple):
    """What a message says."""

    stamp: float  # seconds, of its header
    frame_id: str  # of the coordinates, without the slash of ROS's early names
    ids: np.ndarray  # [N] int64, `UNNAMED` without an id
    xyz: np.ndarray  # [N, 3] metres; zeros where `frames` are
    occluded: np.ndarray  # [N] bool: the tracker guesses the position
    frames: Sequence[
        str
    ] = ()  # [N] frame of /tf at whose origin each person is, for ROS4HRI
    others: int = 0  # entries that are no people


def _id_of(value: Any) -> int:
    if isinstance(value, str):
        return id_of_name(value)
    if hasattr(value, "uuid"):
        return id_of_name(bytes(value.uuid).hex())
    # A uint64 becomes the int64 with the same bits, as which negative ids are written.
    return (int(value) + 2**63) % 2**64 - 2**63


def _xyz(point: Any) -> tuple[float, float, float]:
    """Metres of a point or vector with fields, or of an array of two or three numbers."""
    if hasattr(point, "x"):
        return point.x, point.y, getattr(point, "z", 0.0)
    x, y, *rest = point
    return x, y, rest[0] if rest else 0.0


def _follow(entry: Any, path: str) -> Any:
    for name in path.split(".") if path else ():
        entry = entry[int(name)] if name.isdecimal() else getattr(entry, name)
    return entry


def _ids(message: Any, entries: Sequence[Any], path: str) -> list[int]:
    for name in path.split("|") if path else ():
        values = getattr(message, name, None)
        if values is not None and len(values) == len(entries):
            return [_id_of(value) for value in values]
        if not entries or hasattr(entries[0], name.partition(".")[0]):
            return [_id_of(_follow(entry, name)) for entry in entries]
    if "|" not in path and path and entries:
        raise AttributeError(f"people have no {path}")
    return [UNNAMED] * len(entries)


def _header(message: Any, form: Kind) -> Any:
    """The message's header, or that of its first entry, as of a MarkerArray."""
    if hasattr(message, "header"):
        return message.header
    entries = _follow(message, form.people)
    if not len(entries):
        raise LookupError("neither the message nor an entry has a header")
    return entries[0].header


def see(kind: str | Kind, message: Any, only: str = "") -> Seen:
    """What a message says, of a type in `KINDS` or with fields as a `Kind` says.

    `only` says which entries are people, instead of the kind.

    Raises:
        AttributeError, LookupError, TypeError, ValueError: if the message has no such
            fields.
    """
    form = KINDS[kind] if isinstance(kind, str) else kind
    entries = list(_follow(message, form.people))
    ids = (
        _ids(message, entries, form.id)
        if form.position
        else [id_of_name(e) for e in entries]
    )
    count = len(entries)
    only = only or form.only
    if only:
        path, _, values = only.partition("=")
        is_person = [
            str(_follow(entry, path)) in values.split(",") for entry in entries
        ]
        ids, entries = (
            list(itertools.compress(part, is_person)) for part in (ids, entries)
        )
    points = (
        [_follow(entry, form.position) for entry in entries] if form.position else []
    )
    occluded = [
        bool(form.occluded) and _follow(entry, form.occluded) for entry in entries
    ]
    header = _header(message, form)
    return Seen(
        seconds_of(header.stamp),
        header.frame_id.strip("/"),
        np.array(ids, np.int64),
        np.array(
            [_xyz(point) for point in points] or np.zeros((len(ids), 3)), np.float64
        ),
        np.array(occluded, bool),
        [] if form.position else [f"body_{entry}" for entry in entries],
        count - len(entries),
    )
