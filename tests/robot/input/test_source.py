"""One publisher, one frame of coordinates: nothing else is mixed into a stream of people."""

from types import SimpleNamespace as Fields

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from neurosym_jax.errors import InputError
from neurosym_robot.input.kinds import (
    HRI,
    KINDS,
    POSES,
    Kind,
    kinds_of,
    register_message,
    see,
)
from neurosym_robot.input.source import WAIT, PeopleSource
from neurosym_robot.input.transforms import rotation_of
from neurosym_robot.ros.definitions import PEOPLE
from neurosym_robot.tracking.names import UNNAMED, id_of_name, name_of
from tests.robot.input.robot import transform

pytest.importorskip("rosbags", reason="rosbags is not installed")


def stamp(seconds: float) -> Fields:
    sec, nanosec = divmod(round(seconds * 1e9), 10**9)
    return Fields(sec=sec, nanosec=nanosec)


def point(x: float, y: float, z: float = 0.0) -> Fields:
    return Fields(x=x, y=y, z=z)


def people(at: float, frame: str = "map", x: float = 1.0, names: str = "7") -> Fields:
    """People with these names, a metre apart; "-" has none."""
    header = Fields(stamp=stamp(at), frame_id=frame)
    rows = [
        Fields(name=name.strip("-"), position=point(x + n, 2.0))
        for n, name in enumerate(names.split())
    ]
    return Fields(header=header, people=rows)


@pytest.fixture
def notices() -> list[str]:
    """What a source reports."""
    return []


@pytest.mark.parametrize(
    ("frames", "line"),
    [
        (
            10 * ["/map", "odom"],
            "coordinates in 'odom' are left out, the stream's are in 'map'",
        ),
        (
            5 * [""] + 5 * ["map"],
            "coordinates in 'map' are left out, the stream's are in ''",
        ),
    ],
)
def test_another_frame_is_left_out_and_said_once(frames, line, notices):
    source = PeopleSource(report=notices.append)
    for n, frame in enumerate(frames):
        taken = source.take(PEOPLE, people(1 + n / 10, frame))
        assert len(taken) == (frame == frames[0])
    assert source.refused == {"other frame": len(frames) // 2}
    assert notices == [f"{line}; --fixed-frame map transforms them"]


def test_a_second_publisher_waits_until_the_first_is_silent(notices):
    source = PeopleSource(report=notices.append)
    turns = (
        (0.0, "/a", 1),
        (0.1, "/b", 0),
        (0.2, "/a", 1),
        (2.0, "/b", 0),
        (2.3, "/b", 1),
    )
    for at, publisher, count in (*turns, (2.4, "/a", 0)):
        assert len(source.take(PEOPLE, people(1 + at), publisher, at)) == count
    assert source.refused == {"other publisher": 3}
    assert "/b, are left out beside those of /a; remap one" in notices[0]
    assert "now, not from" in notices[1]


def test_a_publisher_that_has_left_is_replaced_at_once(notices):
    source = PeopleSource(report=notices.append)
    source.take(PEOPLE, people(1.0), "/a", 0.0)
    assert source.take(PEOPLE, people(1.1), "/b", 0.1) == []
    source.is_there = {"/b"}.__contains__
    assert len(source.take(PEOPLE, people(1.2), "/b", 0.2)) == 1
    assert "people come from /b now, not from /a" in notices


def test_coordinates_are_taken_to_the_fixed_frame_once_the_transform_brackets_them(
    notices,
):
    source = PeopleSource("map", report=notices.append)
    source.transforms.hear(transform(0.0, "base", "camera", 0.5), static=True)
    source.transforms.hear(transform(10.0, "map", "base", 0.0))
    source.transforms.hear(transform(10.2, "map", "base", 2.0, yaw=np.pi / 2))
    # The camera is half a metre before a robot that is at x = 2 then and looks along y.
    (frame,) = source.take(PEOPLE, people(10.2, "camera"))
    assert_allclose(frame.xy, [[2 - 2.0, 1.5]], atol=1e-12)
    # The newest pose does not hold: people wait, and those after them, in order.
    assert source.take(PEOPLE, people(10.3, "camera"), received=10.3) == []
    assert source.take(PEOPLE, people(10.35, "map"), received=10.35) == []
    source.transforms.hear(transform(10.4, "map", "base", 2.0, yaw=np.pi / 2))
    first, second = source.release(10.4)
    assert (first.stamp, second.stamp) == (10.3, 10.35)
    assert_allclose(first.xy, [[0.0, 1.5]], atol=1e-12)
    assert notices == []
    # They wait for a bounded time, and what is older than /tf does not wait at all.
    assert source.take(PEOPLE, people(10.5, "camera"), received=10.5) == []
    assert source.release(10.5 + WAIT) == []
    assert source.waiting
    assert source.release(10.6 + WAIT) == []
    assert not source.waiting
    assert source.refused == {"no transform": 1}
    (line,) = notices
    assert (
        "cannot be taken to 'map': where base lies is known from 10.00 to 10.40 s, not"
        in line
    )
    late = PeopleSource("map", report=notices.append)
    late.transforms.hear(transform(10.0, "map", "camera", 0.0))
    assert late.take(PEOPLE, people(9.0, "camera")) == []
    assert late.refused == {"no transform": 1}


def test_lost_and_distant_people_are_left_out_in_the_sensors_frame(notices):
    """(-3000, -3000) is no place in the map, whatever the transform makes of it."""
    source = PeopleSource("map", report=notices.append)
    source.transforms.hear(transform(0.0, "map", "camera", 2.0), static=True)
    for at, x, count in (
        (1.0, 1.0, 1),
        (1.1, -3000.0, 0),
        (1.2, 61.0, 0),
        (1.3, np.nan, 1),
    ):
        (frame,) = source.take(PEOPLE, people(at, "camera", x))
        assert len(frame.ids) == len(frame.xy) == count
    assert source.refused == {"far people": 2}
    assert notices == [
        "people more than 60 m from the sensor or robot are left out; --reach sets the limit"
    ]
    # Of people who are in the map already, the robot's place counts, if it is known.
    for robot_frame, count in (("", 1), ("base", 0)):
        source = PeopleSource(report=notices.append, robot_frame=robot_frame)
        source.transforms.hear(transform(0.0, "map", "base", 500.0), static=True)
        for x, expected in ((1.0, count), (501.0, 1), (3000.0, 0)):
            assert len(source.take(PEOPLE, people(x, x=x))[0].ids) == expected


def test_where_the_robot_is_among_the_people(notices):
    source = PeopleSource(report=notices.append, robot_frame="base")
    assert source.robot(10.0) is None  # Nothing is known of the stream yet.
    assert len(source.take(PEOPLE, people(10.0))) == 1
    assert source.refused == {"robot's place unknown": 1}
    source.transforms.hear(transform(10.0, "map", "base", 0.0))
    source.transforms.hear(transform(10.2, "map", "base", 2.0, yaw=np.pi / 2))
    for at, place in ((10.2, [2, 0, np.pi / 2]), (10.1, [1, 0, np.pi / 4])):
        assert_allclose(np.asarray(source.robot(at)), place)
    assert_allclose(np.asarray(source.robot(10.05))[:2], [0.5, 0.0])


def test_every_kind_says_who_is_where():
    at, header = point(1.0, 2.0, 3.0), Fields(stamp=stamp(5.5), frame_id="/odom")
    pose = Fields(position=at)
    track = Fields(track_id=4, pose=Fields(pose=pose), is_occluded=True)
    entries = {
        "People": Fields(name="4", position=at),
        "Humans": Fields(id=4, centroid=Fields(pose=pose)),
        "TrackedPersons": track,
        "PeopleTracker": pose,
        "PersonArray": Fields(id=4, pose=pose),
        "Agents": Fields(id=4, position=pose),
        "Detection3DArray": Fields(id="4", bbox=Fields(center=pose)),
        "ObjectArray": Fields(id=4, pose=pose, classification=4),
        "PoseArray": pose,
        "ObstacleArray": Fields(id=4, position=at),
        "TrackedObjects": Fields(
            object_id=4,
            kinematics=Fields(pose_with_covariance=Fields(pose=pose)),
            classification=[Fields(label=7)],
        ),
        "ObjectsStamped": Fields(
            label_id=4, label="Person", position=np.array([1, 2, 3], np.float32)
        ),
    }
    for kind, form in KINDS.items():
        if kind == HRI:
            continue
        message = Fields(
            header=header, **{form.people: [entries[kind.split("/")[2]]]}, uuids=["4"]
        )
        seen = see(kind, message)
        assert (seen.stamp, seen.frame_id, seen.xyz.tolist()) == (
            5.5,
            "odom",
            [[1, 2, 3]],
        )
        assert seen.ids.tolist() == [UNNAMED if kind == POSES else 4]
        assert seen.occluded.tolist() == ["TrackedPersons" in kind]


def test_people_of_any_message_by_paths(notices):
    entry = Fields(where=[Fields(), Fields(p=point(1, 2))], who=Fields(number=9))
    message = Fields(
        header=Fields(stamp=stamp(1.0), frame_id="map"), crowd=Fields(all=[entry])
    )
    for path, expected in (("who.number", 9), ("", UNNAMED)):
        seen = see(Kind("crowd.all", "where.1.p", path), message)
        assert (seen.ids.tolist(), seen.xyz.tolist()) == ([expected], [[1, 2, 0]])
    source = PeopleSource(
        report=notices.append, form=Kind("crowd.all", "where.1.p", "name")
    )
    assert source.take("any/msg/Type", message) == []
    assert source.refused == {"malformed": 1}
    assert "people cannot be read: people have no name" in notices[0]


def test_only_entries_of_a_class_are_people():
    header = Fields(stamp=stamp(1.0), frame_id="map")
    labels = ("car", "person", "child", "car")
    entries = [
        Fields(p=point(n, 2), hypotheses=[Fields(label=label)])
        for n, label in enumerate(labels)
    ]
    message = Fields(header=header, all=entries, ids=[10, 11, 12, 13])
    form = Kind("all", "p", "ids")
    for only, ids in (
        ("", [10, 11, 12, 13]),
        ("hypotheses.0.label=person,child", [11, 12]),
    ):
        source = PeopleSource(report=(notices := []).append, form=form, only=only)
        (frame,) = source.take("any/msg/Type", message)
        assert frame.ids.tolist() == ids
        assert frame.xy[:, 0].tolist() == [n - 10 for n in ids]
        assert source.refused == ({"other classes": 2} if only else {})
        assert len(notices) == len(source.refused)
    cars = Fields(header=header, objects=[
        Fields(id=n, pose=Fields(position=point(n, 2)), classification=kind)
        for n, kind in enumerate((6, 4))])  # fmt: skip
    assert see("derived_object_msgs/msg/ObjectArray", cars).ids.tolist() == [1]


def test_names_are_numbers_only_as_numbers_are_written():
    assert [id_of_name(name) for name in ("7", "-7", "0", "12")] == [7, -7, 0, 12]
    names = ["person_1", "person_2", "1e3", "007", "-0", "9" * 30, "²"]
    ids = [id_of_name(name) for name in names]
    assert len(set(ids)) == len(names)
    assert all(2**52 <= id < 2**53 for id in ids)
    assert [id_of_name(str(id)) for id in ids] == ids
    assert ids[0] == 4665009609805463


def test_people_without_names_are_told_apart_by_where_they_are():
    source = PeopleSource()
    for n in range(20):
        (frame,) = source.take(PEOPLE, people(n / 10, x=n / 10, names="- - -"))
        assert frame.ids.tolist() == [0, 1, 2]
    # Beside those with names, numbers stay apart.
    (frame,) = source.take(PEOPLE, people(2.0, x=2.0, names="0 - -"))
    assert frame.ids[0] == 0
    assert (frame.ids[1:] >= 2**51).all()


def test_a_stamp_of_0_is_the_time_of_arrival(notices):
    source = PeopleSource(report=notices.append)
    for n in range(3):
        (frame,) = source.take(PEOPLE, people(0.0), received=n, clock=1.7e9 + n)
        assert frame.stamp == 1.7e9 + n
    assert notices == ["stamps are 0: the time of arrival is taken"]
    assert source.refused == {"stamped on arrival": 3}


@pytest.mark.parametrize("separate", [0.0, 0.003])
@pytest.mark.parametrize("recorded", [True, False])
def test_messages_of_one_moment_are_joined(separate, recorded):
    source, frames = PeopleSource(recorded=recorded), []
    for n in range(20):
        for m in range(3):
            at = n / 10 + m * separate
            frames += source.take(
                PEOPLE, people(at, x=3.0 * m, names=str(m)), received=at
            )
        frames += source.release(n / 10 + 0.09) if not recorded else []
    frames += source.release(np.inf)
    assert [frame.ids.tolist() for frame in frames[-19:]] == 19 * [[0, 1, 2]]
    assert len(frames) == 20 if recorded else 20 <= len(frames) <= 22
    # A person who is there again is of another moment, however close.
    close = PeopleSource(recorded=True)
    frames = [
        f
        for n in range(50)
        for f in close.take(PEOPLE, people(n / 200), received=n / 200)
    ]
    assert len(frames) == 49


def test_guessed_positions_are_no_observations():
    pose = Fields(pose=Fields(position=point(1.0, 2.0)))
    tracks = [Fields(track_id=n, is_occluded=n == 1, pose=pose) for n in range(3)]
    message = Fields(header=Fields(stamp=stamp(1.0), frame_id="map"), tracks=tracks)
    source = PeopleSource()
    (frame,) = source.take("pedsim_msgs/msg/TrackedPersons", message)
    assert frame.ids.tolist() == [0, 2]
    assert source.refused == {"occluded people": 1}


def test_ids_that_are_uuids_are_names_that_come_back():
    uuid = Fields(uuid=np.arange(16, dtype=np.uint8))
    entry = Fields(id=uuid, position=point(1.0, 2.0))
    header = Fields(stamp=stamp(1.0), frame_id="map")
    message = Fields(header=header, obstacles=[entry])
    (id,) = see("nav2_dynamic_msgs/msg/ObstacleArray", message).ids.tolist()
    assert 2**52 <= id < 2**53
    assert name_of(id) == "000102030405060708090a0b0c0d0e0f"
    assert (name_of(id_of_name("Ada")), name_of(id_of_name("12"))) == ("Ada", "12")
    assert name_of(2**52 + 1) == str(2**52 + 1)


def test_markers_have_the_header_of_the_first():
    form = Kind("markers", "pose.position", "id")
    header = Fields(stamp=stamp(3.0), frame_id="odom")
    marker = Fields(header=header, id=5, pose=Fields(position=point(1.0, 2.0)))
    seen = see(form, Fields(markers=[marker]))
    assert (seen.stamp, seen.frame_id, seen.ids.tolist()) == (3.0, "odom", [5])
    source = PeopleSource(report=lambda text: None, form=form)
    assert source.take("a/msg/B", Fields(markers=[])) == []
    assert source.refused == {"malformed": 1}


def test_a_plugin_adds_a_message_and_names_may_be_short():
    kind = Kind("crowd", "at")
    register_message("my_msgs/msg/Crowd", kind)
    assert KINDS["my_msgs/msg/Crowd"] == kind
    for name in ("Crowd", "my_msgs/Crowd", "my_msgs/msg/Crowd"):
        assert kinds_of(name) == ["my_msgs/msg/Crowd"]
    assert len(kinds_of("TrackedPersons")) == 2
    assert kinds_of("pedsim_msgs/TrackedPersons") == ["pedsim_msgs/msg/TrackedPersons"]
    assert kinds_of("Nothing") == []
    register_message("my_msgs/msg/Crowd", kind)
    for name, other in (("my_msgs/msg/Crowd", Kind("people")), ("Crowd", kind)):
        with pytest.raises(InputError, match="Crowd: "):
            register_message(name, other)


@pytest.mark.parametrize(("root", "count"), [("base_link", 0), ("hall", 1)])
def test_a_robot_s_own_frame_is_no_fixed_one(root, count, notices):
    """Bodies are known below base_link alone: standing people would seem to walk."""
    source = PeopleSource(report=notices.append)
    ids = Fields(header=Fields(stamp=stamp(1.0), frame_id=""), ids=["a"])
    for at in (0.9, 1.1):
        source.transforms.hear(transform(at, root, "body_a", 2.0))
    frames = source.take(HRI, ids) + source.release(9.0)
    assert len(frames) == count
    said = f"/tf knows no fixed frame above '{root}'; --fixed-frame names one"
    assert (said in notices) == (count == 0)
    # People of other messages are taken, with a doubt that is said.
    source = PeopleSource(report=notices.append)
    source.transforms.hear(transform(0.9, "base_link", "laser", 0.0))
    source.take(PEOPLE, people(1.0, "base_link"))
    assert any("does not say if it moves" in text for text in notices)


def test_bodies_of_ros4hri_are_frames_of_tf():
    source = PeopleSource()
    ids = Fields(header=Fields(stamp=stamp(1.0), frame_id=""), ids=["a", "b"])
    for at in (0.9, 1.1):
        for name, x in (("a", at), ("b", 5.0)):
            source.transforms.hear(transform(at, "map", f"body_{name}", x))
    (frame,) = source.take(HRI, ids)
    assert_allclose(frame.xy, [[1, 0], [5, 0]])
    assert frame.ids.tolist() == [id_of_name("a"), id_of_name("b")]
    assert source.frame_id == "map"


@pytest.mark.parametrize(
    ("frame", "turn", "step", "cause", "advice"),
    [
        ("base_link", 0.0, 0.08, "moving", "--fixed-frame odom"),
        ("camera", 0.05, 0.0, "moving", "--fixed-frame odom"),
        ("odom", 0.0, 0.08, "", ""),
        ("camera_color_optical_frame", 0.0, 0.0, "optical", "--fixed-frame odom"),
        ("tilted", 0.0, 0.0, "tilted", "--fixed-frame odom"),
        ("wall", 0.0, 0.0, "", ""),
    ],
)
def test_frames_that_would_be_misread_are_refused_with_the_option(
    frame, turn, step, cause, advice, notices
):
    live, recorded = PeopleSource(report=notices.append), PeopleSource(recorded=True)
    meant = PeopleSource(frame, report=lambda text: None)
    count, named, error = 0, 0, ""
    for n in range(20):
        at = 1 + n / 10
        move = transform(
            at, "map" if frame == "odom" else "odom", frame, step * n, yaw=turn * n
        )
        if frame == "tilted":
            move.transforms[0].transform.rotation = Fields(x=0.5, y=-0.5, z=0.5, w=-0.5)
        for source in (live, recorded, meant):
            source.transforms.hear(move, received=at)
        count += len(live.take(PEOPLE, people(at, frame), received=at))
        named += len(meant.take(PEOPLE, people(at, frame), received=at))
        try:
            recorded.take(PEOPLE, people(at, frame), received=at)
        except InputError as refused:
            error = str(refused)
    assert named == 20  # A frame that is named is meant.
    if not cause:
        assert (count, error, notices) == (20, "", [])
        return
    assert count <= 2
    assert live.refused == {f"{cause} frame": 20 - count}
    (line,) = notices
    for text in (line, error):
        assert f"coordinates are in '{frame}'" in text
        assert advice in text


def test_without_tf_a_robots_own_frame_is_questioned():
    for frame, lines in (("base_link", 1), ("map", 0), ("room", 0)):
        notices = []
        source = PeopleSource(report=notices.append)
        assert len(source.take(PEOPLE, people(1.0, frame))) == 1
        assert len(notices) == lines
    notices = []
    source = PeopleSource(report=notices.append)
    assert source.take(PEOPLE, people(1.0, "camera_color_optical_frame")) == []
    assert "--fixed-frame map" in notices[0]


@pytest.mark.parametrize("back", [0.3, 3.0, 30.0])
def test_a_clock_set_back_forgets_the_former_run(back):
    """The robot stood at 0 m before, and stands at 3 m after, when /tf of it is silent at first."""
    source = PeopleSource("map")
    for n in range(100):
        source.transforms.hear(transform(n / 10, "map", "base", 0.0), received=n / 10)
        source.take(PEOPLE, people(n / 10 - 0.05, "base"), received=n / 10)
    for n in range(100, 200):
        at = n / 10 - back
        if n >= 110:
            source.transforms.hear(transform(at, "map", "base", 3.0), received=n / 10)
        for frame in source.take(PEOPLE, people(at - 0.05, "base"), received=n / 10):
            assert n >= 110
            assert_allclose(frame.xy, [[4.0, 2.0]], atol=1e-9)
    assert source.refused["clock set back"] == 1
    assert not source.waiting


def test_names_of_others_do_not_steer_the_terminal():
    notices = []
    source = PeopleSource(report=notices.append)
    source.take(PEOPLE, people(1.0, "map"), "/good", received=1.0)
    source.take(PEOPLE, people(1.1, "map"), "/evil\x1b[2J", received=1.1)
    source.take(PEOPLE, people(9.0, "map"), "/evil\x1b[2J", received=9.0)
    assert sum("evil" in notice for notice in notices) == 2
    assert all("\\x1b[2J" in notice for notice in notices if "evil" in notice)
    assert "\x1b" not in "".join(notices)


def test_people_of_the_old_clock_who_wait_for_a_transform_never_come():
    """And nobody of the new one waits for them."""
    source = PeopleSource("map")
    stamps, first = [], None
    for n in range(200):
        at = n / 10 if n < 100 else n / 10 - 3
        if not 95 <= n < 100:
            pose = transform(at, "map", "base", 0.0)
            source.transforms.hear(pose, received=n / 10)
        for frame in source.take(PEOPLE, people(at - 0.05, "base"), received=n / 10):
            if n >= 100:
                first = n if first is None else first
                stamps.append(frame.stamp)
    assert first is not None
    assert first < 105
    assert stamps == sorted(set(stamps))
    assert min(stamps) < 7.5


def test_one_message_out_of_order_is_left_out():
    source = PeopleSource()
    stamps = [1.0, 1.1, 1.05, 1.2, 1.15, 1.5]
    frames = [frame.stamp for at in stamps for frame in source.take(PEOPLE, people(at))]
    assert frames == [1.0, 1.1, 1.2, 1.5]
    assert source.refused == {"out of order": 2}


def test_quaternions_turn_as_in_scipy():
    for quaternion in np.random.default_rng(0).normal(0, 3, (20, 4)):
        expected = Rotation.from_quat(quaternion).as_matrix()
        assert_allclose(rotation_of(quaternion), expected, atol=1e-12)
