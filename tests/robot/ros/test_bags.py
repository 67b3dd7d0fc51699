"""Bags of all three kinds give back what was written, and damaged ones say so in one line."""

import contextlib
import sqlite3
import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.recordings import data_files, files_in, is_folder, read_any
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError, InputWarning
from neurosym_robot.input.kinds import Kind, see
from neurosym_robot.input.source import PeopleSource
from neurosym_robot.ros import bag_limits, messages
from neurosym_robot.ros.bags import BagWriter, read_frames, read_messages, read_people
from neurosym_robot.ros.definitions import (
    HUMANS,
    PEOPLE_TOPICS,
    seconds_of,
    shared_typestore,
)
from neurosym_robot.ros.messages import make_people, make_trajectories
from neurosym_robot.tracking.following import Frame, tracks_of_frames
from neurosym_robot.tracking.names import name_of
from tests.repository import exhaustive
from tests.robot.recordings import walkers, write_people

pytest.importorskip("rosbags", reason="rosbags is not installed")


KINDS = ["bag", "db3", "mcap"]
COMPRESSED = ["bag LZ4", "bag BZ2", "mcap STORAGE", "db3 MESSAGE", "db3 FILE"]
"""Kinds of bags, and what in them is compressed."""
TOPIC = PEOPLE_TOPICS[0]


@pytest.mark.parametrize("kind", KINDS)
def test_people_and_forecasts_there_and_back(tmp_path, kind):
    expected = walkers(2.0)
    with BagWriter(tmp_path / f"run.{kind}") as bag:
        for frame in expected:
            bag.write(TOPIC, frame.stamp, messages.make_people(bag.new, frame))
            trajectories = make_trajectories(
                bag.new, [frame.stamp], frame.ids, frame.xy[:, None]
            )
            bag.write("/forecast", frame.stamp, trajectories)
    assert bag.path.is_file() == (kind == "bag")
    got = list(read_frames(bag.path))
    for a, b in zip(expected, got, strict=True):
        assert a.stamp == pytest.approx(b.stamp, abs=1e-6)
        assert_array_equal(a.ids, b.ids)
        assert_array_equal(a.xy, b.xy)
    records = list(read_messages(bag.path))
    assert [topic for topic, _ in records] == [TOPIC, "/forecast"] * len(expected)
    (step,) = records[-1][1].trajs
    assert seconds_of(step.header.stamp) == pytest.approx(expected[-1].stamp, abs=1e-6)
    assert_array_equal(see(HUMANS, step).xyz[:, :2], expected[-1].xy)
    with pytest.raises(InputError, match="already there"):
        BagWriter(tmp_path / f"run.{kind}")


def content(path):
    return [
        (frame.stamp, frame.ids.tolist(), frame.xy.tolist())
        for frame in read_people(path)
    ]


TOOLS = {"bag": "rosbag reindex", "db3": "ros2 bag reindex", "mcap": "mcap recover"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_cut_short_is_refused_with_the_tool_that_mends_it(tmp_path, kind):
    path = write_people(tmp_path / f"run.{kind}", walkers(20.0))
    file = path if path.is_file() else next(path.glob(f"*.{kind}"))
    content_of_file = file.read_bytes()
    for size in [
        *np.random.default_rng(0).integers(100, len(content_of_file) - 1, 8),
        0,
    ]:
        file.write_bytes(content_of_file[:size])
        cut = rf"cannot be read as a bag: .*if it was cut short, `{TOOLS[kind]}`"
        with pytest.raises(InputError, match=cut) as error:
            list(read_people(path))
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_no_frame_is_lost_in_silence(tmp_path, kind):
    path = write_people(tmp_path / f"run.{kind}", walkers(0.4))
    file = path if path.is_file() else next(path.glob(f"*.{kind}"))
    content_of_file, expected = file.read_bytes(), len(content(path))
    for at in (
        [content_of_file.rindex(b"conn=") + 5] if kind == "bag" else range(90, 110)
    ):
        file.write_bytes(
            content_of_file[:at]
            + bytes([content_of_file[at] ^ 219])
            + content_of_file[at + 1 :]
        )
        with (
            warnings.catch_warnings(record=True) as warned,
            contextlib.suppress(InputError),
        ):
            assert len(content(path)) == expected or warned, at


def test_one_message_less_than_the_metadata_say_is_refused(tmp_path):
    path = write_people(tmp_path / "run.db3", walkers(0.4))
    (file,) = path.glob("*.db3")
    with contextlib.closing(sqlite3.connect(file)) as base:
        base.execute("DELETE FROM messages WHERE id = (SELECT MAX(id) FROM messages)")
        base.commit()
    with pytest.raises(InputError, match="1 of its messages are missing"):
        content(path)


def test_whatever_reads_tracks_reads_bags(tmp_path):
    frames = walkers(2.0)
    first, second = (
        write_people(tmp_path / name, frames) for name in ("first.bag", "second.mcap")
    )
    (tracks,) = read_any(first)
    expected = tracks_of_frames(iter(frames), "first")
    assert (tracks.recording, tracks.reading.format) == ("first", "bag")
    assert_array_equal(tracks.id, expected.id)
    assert_array_equal(tracks.position, expected.position)
    # The folder of ROS 2 is one recording, a folder of bags is several.
    assert not is_folder(second)
    assert data_files(tmp_path) == files_in(tmp_path) == [first, second]


def bag_of_blanks(path, kind, size):
    """A bag of one of `COMPRESSED` with a text of `size` blanks."""
    from rosbags import rosbag1, rosbag2

    ending, compressed = kind.split()
    ros1 = ending == "bag"
    store = shared_typestore(1 if ros1 else 2)
    text = store.types["std_msgs/msg/String"](data=" " * size)
    if ros1:
        path = path.with_suffix(".bag")
        writer = rosbag1.Writer(path)
        writer.set_compression(rosbag1.Writer.CompressionFormat[compressed])
        content = store.serialize_ros1(text, text.__msgtype__)
    else:
        plugin = rosbag2.StoragePlugin["MCAP" if ending == "mcap" else "SQLITE3"]
        writer = rosbag2.Writer(path, version=8, storage_plugin=plugin)
        mode = rosbag2.CompressionMode[compressed]
        writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
        content = store.serialize_cdr(text, text.__msgtype__)
    with writer:
        connection = writer.add_connection("/text", text.__msgtype__, typestore=store)
        writer.write(connection, 10**9, content)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind", [exhaustive(kind) if kind == "db3 MESSAGE" else kind for kind in COMPRESSED]
)
def test_a_bag_that_takes_much_memory_is_refused(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(bag_limits, "MEMORY", 30_000_000)
    small = bag_of_blanks(tmp_path / "small", kind, 1000)
    with pytest.raises(InputError, match=r"small.*no topic is of a type"):
        next(read_people(small))
    large = bag_of_blanks(tmp_path / "large", kind, 90_000_000)
    with pytest.raises(
        InputError, match=r"large.*: takes more than 30 MB of memory to decompress"
    ):
        next(read_people(large))
    monkeypatch.setattr(bag_limits, "SECONDS", 0.001)
    with pytest.raises(
        InputError, match=r"large.*: takes more than (0 s|30 MB of memory) to"
    ):
        next(read_people(large))


def test_which_topic_has_the_people(tmp_path):
    frame = walkers(2.0)[0]
    odd = Frame(
        2.0, np.array([7, 7, 8]), np.array([[1.0, 0.0], [1, 1], [-3000, -3000]])
    )
    for name, named in (("run", PEOPLE_TOPICS[::-1]), ("two", ())):
        with BagWriter(tmp_path / f"{name}.bag") as bag:
            for n, topic in enumerate(named):
                moved = frame._replace(xy=frame.xy + n)
                bag.write(topic, 1.0, messages.make_people(bag.new, moved))
            for topic in ("/one", "/two"):
                bag.write(topic, 1.0, messages.make_people(bag.new, odd))
            bag.write("/chatter", 1.0, bag.new("std_msgs/msg/String"))
            humans = make_trajectories(
                bag.new, [2.0], np.array([-5, 6]), np.ones((2, 1, 2))
            )
            bag.write("/humans", 1.0, humans.trajs[0])
    run, later_bag = tmp_path / "run.bag", tmp_path / "two.bag"
    # The filtered one is preferred, and humans are people, too.
    assert PEOPLE_TOPICS[::-1].index(TOPIC) == 1
    assert_array_equal(next(read_people(run)).xy, frame.xy + 1)
    assert_array_equal(next(read_people(run, PEOPLE_TOPICS[1])).xy, frame.xy)
    assert_array_equal(next(read_people(run, "/humans")).ids, [-5, 6])
    with pytest.raises(
        InputError, match=r"which topic has the people.*/one.*/two.*bag,topic="
    ):
        read_any(later_bag)
    far = pytest.warns(InputWarning, match="people more than 60 m")
    with far, pytest.warns(InputWarning, match="1 positions are left out"):
        (tracks,) = read_any(later_bag, ReadOptions(format="bag,topic=/two"))
    assert_array_equal(tracks.position, [[1, 0]])


def test_text_files_are_streams_too(tmp_path):
    path = tmp_path / "tracks.txt"
    path.write_text("0 1 0 0\n10 1 1 0\n10 2 5 5\n20 2 6 5\n")
    got = list(read_frames(path))
    assert [frame.ids.tolist() for frame in got] == [[1], [1, 2], [2]]
    assert [frame.stamp for frame in got] == pytest.approx([0, 0.4, 0.8])
    assert_array_equal(tracks_of_frames(iter(got), "again").id, [1, 1, 2, 2])


def test_people_of_a_file_have_their_names(tmp_path):
    path = tmp_path / "tracks.csv"
    path.write_text("frame,id,x,y\n0,ben,0,0\n10,ben,1,0\n10,7,5,5\n20,7,6,5\n")
    got = list(read_frames(path, ReadOptions(fps=25)))
    names = [[name_of(id) for id in frame.ids.tolist()] for frame in got]
    assert names == [["ben"], ["7", "ben"], ["7"]]


def test_a_bag_of_which_nothing_can_be_read_is_an_error(tmp_path):
    path = write_people(tmp_path / "run.bag", walkers(1.0))
    source = PeopleSource(report=lambda text: None, form=Kind("people", "nowhere"))
    with pytest.raises(InputError, match="none of 11 messages could be read: people_"):
        list(read_people(path, source=source))
    empty = [frame._replace(ids=frame.ids[:0], xy=frame.xy[:0]) for frame in walkers(1)]
    path = write_people(tmp_path / "empty.bag", empty)
    assert len(list(read_people(path))) == 11


@pytest.mark.parametrize("topic", ["/tf", "/robot_1/tf"])
def test_tf_may_be_in_a_namespace(tmp_path, topic):
    with BagWriter(tmp_path / "run.bag") as bag:
        for frame in walkers(2.0):
            bag.write("/people", frame.stamp, make_people(bag.new, frame, "laser"))
            move = bag.new("tf2_msgs/msg/TFMessage")
            row = bag.new("geometry_msgs/msg/TransformStamped")
            row.header.stamp.sec, nanosec = divmod(round(frame.stamp * 1e9), 10**9)
            row.header.stamp.nanosec = nanosec
            row.header.frame_id, row.child_frame_id = "map", "laser"
            row.transform.translation.x, row.transform.rotation.w = 100.0, 1.0
            move.transforms.append(row)
            bag.write(topic, frame.stamp, move)
    source = PeopleSource("map", report=lambda text: None)
    moved = list(read_people(tmp_path / "run.bag", source=source))
    expected = walkers(2.0)
    assert len(moved) == len(expected)
    assert_allclose(moved[5].xy, np.add(expected[5].xy, [100.0, 0.0]), atol=1e-6)
