"""Messages of ROS 1 are read as their publishers define them."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

pytest.importorskip("rosbags", reason="rosbags is not installed")

from rosbags.typesys import get_types_from_msg

from neurosym_robot.ros.decoding import Decoder
from neurosym_robot.ros.definitions import typestore
from neurosym_robot.ros.people import see

TRACKED = {
    # github.com/spencer-project/spencer_messages
    "spencer_tracking_msgs/msg/TrackedPerson": """\
uint64 track_id
bool is_occluded
bool is_matched
uint64 detection_id
duration age
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
""",
    "spencer_tracking_msgs/msg/TrackedPersons": "std_msgs/Header header\nTrackedPerson[] tracks\n",
}


def header(store, kind: str) -> dict[str, str]:
    """What a publisher sends first."""
    text, md5 = store.generate_msgdef(kind, ros_version=1)
    names = {"type": kind.replace("/msg/", "/"), "md5sum": md5, "message_definition": text}
    return {"callerid": "/tracker", **names}


def test_a_definition_is_learned_from_its_publisher():
    store = typestore(1)
    for name, text in TRACKED.items():
        store.register(get_types_from_msg(text, name))
    # As published with it.
    kind = "spencer_tracking_msgs/msg/TrackedPersons"
    assert store.generate_msgdef(next(iter(TRACKED)))[1] == "28bdd0d6d6551c668e4fde8aecdf1885"
    make = {
        name.split("/")[2]: form
        for name, form in store.types.items()
        if not name.startswith("std_msgs") or name.endswith("Header")
    }
    pose = make["Pose"](make["Point"](1.0, 2.0, 0.0), make["Quaternion"](0.0, 0.0, 0.0, 1.0))
    zero = make["Vector3"](0.0, 0.0, 0.0)
    track = make["TrackedPerson"](
        *(9, False, True, 0),
        make["Duration"](0, 0),
        make["PoseWithCovariance"](pose, np.zeros(36)),
        make["TwistWithCovariance"](make["Twist"](zero, zero), np.zeros(36)),
    )
    message = make["TrackedPersons"](make["Header"](0, make["Time"](3, 0), "odom"), [track])
    data, said = bytes(store.serialize_ros1(message, kind)), header(store, kind)
    decoder = Decoder()
    assert decoder.refuse(said) is None
    seen = see(*decoder.decode(data, said))
    assert_array_equal(seen.xy, [[1, 2]])
    assert (seen.stamp, seen.frame_id, seen.ids is not None and seen.ids.tolist()) == (
        *(3.0, "odom"),
        [9],
    )


def test_what_is_not_understood_is_refused_with_a_reason():
    decoder = Decoder()
    poses = header(decoder.store, "geometry_msgs/msg/PoseArray")
    assert decoder.refuse(poses) is None
    for change, reason in (
        ({"type": "std_msgs/String"}, "none of people_msgs/People"),
        ({"type": "people_msgs/People"}, "not people_msgs/People with md5 18722f4b8db20cc"),
        ({"message_definition": "}{"}, "definition cannot be read"),
        ({"md5sum": "0"}, "whose definition has the md5"),
    ):
        assert reason in str(decoder.refuse({**poses, "md5sum": "1", **change}))
