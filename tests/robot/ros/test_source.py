"""One publisher, one frame of coordinates: nothing else is mixed into a stream of people."""

from types import SimpleNamespace as Fields

import numpy as np
from numpy.testing import assert_allclose

from neurosym_robot.ros.definitions import PEOPLE
from neurosym_robot.ros.people import KINDS, POSES, PeopleSource, see


def stamp(seconds: float) -> Fields:
    sec, nanosec = divmod(round(seconds * 1e9), 10**9)
    return Fields(sec=sec, nanosec=nanosec)


def point(x: float, y: float, z: float = 0.0) -> Fields:
    return Fields(x=x, y=y, z=z)


def people(at: float, frame: str = "map", x: float = 1.0) -> Fields:
    header = Fields(stamp=stamp(at), frame_id=frame)
    return Fields(header=header, people=[Fields(name="7", position=point(x, 2.0))])


def transform(at: float, parent: str, child: str, x: float, turn: float = 0.0) -> Fields:
    """`child` lies at `x` in `parent`, turned by `turn` radians about z."""
    rotation = Fields(x=0.0, y=0.0, z=np.sin(turn / 2), w=np.cos(turn / 2))
    header = Fields(stamp=stamp(at), frame_id=parent)
    there = Fields(translation=point(x, 0.0), rotation=rotation)
    return Fields(transforms=[Fields(header=header, child_frame_id=child, transform=there)])


def test_another_frame_is_left_out_and_said_once():
    said = []
    source = PeopleSource(report=said.append)
    taken = [
        source.take(PEOPLE, people(n / 10, "odom" if n % 2 else "/map")) is not None
        for n in range(20)
    ]
    assert taken == [n % 2 == 0 for n in range(20)]
    assert source.refused == {"other_frame": 10}
    (line,) = said
    assert "'odom'" in line
    assert "'map'" in line
    assert "--fixed-frame map" in line


def test_a_second_publisher_waits_until_the_first_is_silent():
    said = []
    source = PeopleSource(report=said.append)
    assert source.take(PEOPLE, people(0.0), "/a", 0.0) is not None
    assert source.take(PEOPLE, people(0.1), "/b", 0.1) is None
    assert source.take(PEOPLE, people(0.2), "/a", 0.2) is not None
    assert source.take(PEOPLE, people(2.0), "/b", 2.0) is None
    assert source.take(PEOPLE, people(2.3), "/b", 2.3) is not None
    assert source.take(PEOPLE, people(2.4), "/a", 2.4) is None
    assert source.refused == {"other_publisher": 3}
    assert "/b, are left out beside those of /a; remap one" in said[0]
    assert "now, not from" in said[1]


def test_coordinates_are_taken_to_the_fixed_frame():
    said = []
    source = PeopleSource("map", report=said.append)
    assert source.take(PEOPLE, people(10.0, "camera")) is None
    assert source.refused == {"no_transform": 1}
    assert "no transform between camera and map" in said[0]
    source.transforms.hear(transform(0.0, "base", "camera", 0.5), static=True)
    source.transforms.hear(transform(10.0, "map", "base", 0.0))
    source.transforms.hear(transform(10.2, "map", "base", 2.0, np.pi / 2))
    # The camera is half a metre before a robot that is at x = 2 then and looks along y.
    assert_allclose(source.take(PEOPLE, people(10.2, "camera")).xy, [[2 - 2.0, 1.5]], atol=1e-12)
    assert_allclose(source.take(PEOPLE, people(10.1, "map")).xy, [[1, 2]])
    assert source.take(PEOPLE, people(11.0, "camera")) is None
    assert source.frame_id == "map"


def test_lost_and_distant_people_are_left_out_in_the_sensors_frame():
    """(-3000, -3000) is no place in the map, whatever the transform makes of it."""
    said = []
    source = PeopleSource("map", report=said.append)
    source.transforms.hear(transform(0.0, "map", "camera", 2.0), static=True)
    for at, x, kept in ((1.0, 1.0, 1), (1.1, -3000.0, 0), (1.2, 61.0, 0), (1.3, np.nan, 1)):
        frame = source.take(PEOPLE, people(at, "camera", x))
        assert len(frame.ids) == len(frame.xy) == kept
    assert source.refused == {"far_people": 2}
    assert said == [
        "people more than 60 m from the sensor or robot are left out; --reach sets the limit"
    ]
    # Of people who are in the map already, the robot's place counts, if it is known.
    for robot_frame, kept in (("", 1), ("base", 0)):
        source = PeopleSource(report=said.append, robot_frame=robot_frame)
        source.transforms.hear(transform(0.0, "map", "base", 500.0), static=True)
        for x, wanted in ((1.0, kept), (501.0, 1), (3000.0, 0)):
            assert len(source.take(PEOPLE, people(x, x=x)).ids) == wanted


def test_where_the_robot_is_among_the_people():
    said = []
    source = PeopleSource(report=said.append, robot_frame="base")
    assert source.needs_transforms
    assert source.robot(10.0) is None  # Nothing is known of the stream yet.
    assert source.take(PEOPLE, people(10.0)) is not None
    assert source.robot(10.0) is None
    assert source.refused == {"no_robot": 2}
    source.transforms.hear(transform(10.0, "map", "base", 0.0))
    source.transforms.hear(transform(10.2, "map", "base", 2.0, np.pi / 2))
    for at, place in ((10.2, [2, 0, np.pi / 2]), (10.1, [1, 0, np.pi / 4])):
        assert_allclose(np.asarray(source.robot(at)), place)
    assert_allclose(np.asarray(source.robot(10.05))[:2], [0.5, 0.0])


def test_every_kind_says_who_is_where():
    at, header = point(1.0, 2.0, 3.0), Fields(stamp=stamp(5.5), frame_id="/odom")
    pose = Fields(position=at)
    entries = {
        "People": Fields(name="4", position=at),
        "Humans": Fields(id=4, centroid=Fields(pose=pose)),
        "TrackedPersons": Fields(track_id=4, pose=Fields(pose=pose)),
        "Agents": Fields(id=4, position=pose),
        "Detection3DArray": Fields(id="4", bbox=Fields(center=pose)),
        "PoseArray": pose,
    }
    for kind, form in KINDS.items():
        seen = see(kind, Fields(header=header, **{form.people: [entries[kind.split("/")[2]]]}))
        assert (seen.stamp, seen.frame_id, seen.xyz.tolist()) == (5.5, "odom", [[1, 2, 3]])
        assert (None if seen.ids is None else seen.ids.tolist()) == (None if kind == POSES else [4])
