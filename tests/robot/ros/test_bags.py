"""Bags of all three kinds give back what was written, and damaged ones say so in one line."""

import shutil
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.data.formats import data_files, files_in, is_folder, read_any
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.simulation.scenarios import simulate
from neurosym_robot.online.frames import Frame, frames_of_tracks, tracks_of_frames
from neurosym_robot.ros import messages
from neurosym_robot.ros.bag_writer import BagWriter
from neurosym_robot.ros.bags import read_frames, read_messages, read_people
from neurosym_robot.ros.definitions import HUMANS, PEOPLE_TOPICS
from neurosym_robot.ros.messages import make_trajectories
from neurosym_robot.ros.people import seconds_of, see

pytest.importorskip("rosbags", reason="rosbags is not installed")


KINDS = ["bag", "db3", "mcap"]
TOPIC = PEOPLE_TOPICS[0]


def frames(length: int = 20) -> list[Frame]:
    tracks = simulate("cross-path", 1, length / 10, people=3)
    return [frame._replace(stamp=frame.stamp + 1.7e9) for frame in frames_of_tracks(tracks)]


def write(path, topic=TOPIC, length=20):
    """A bag of people; the path of what was written."""
    with BagWriter(path) as bag:
        for frame in frames(length):
            bag.write(topic, frame.stamp, messages.make_people(bag.new, frame))
    return bag.path


@pytest.mark.parametrize("kind", KINDS)
def test_people_and_forecasts_there_and_back(tmp_path, kind):
    wanted = frames()
    with BagWriter(tmp_path / f"run.{kind}") as bag:
        for frame in wanted:
            bag.write(TOPIC, frame.stamp, messages.make_people(bag.new, frame))
            now = frame.stamp
            trajectories = make_trajectories(bag.new, [now], frame.ids, frame.xy[:, None])
            bag.write("/forecast", frame.stamp, trajectories)
    assert bag.path.is_file() == (kind == "bag")
    got = list(read_frames(bag.path))
    for a, b in zip(wanted, got, strict=True):
        assert a.stamp == pytest.approx(b.stamp, abs=1e-6)
        assert_array_equal(a.ids, b.ids)
        assert_array_equal(a.xy, b.xy)
    both = list(read_messages(bag.path))
    assert [topic for topic, _ in both] == [TOPIC, "/forecast"] * len(wanted)
    (step,) = both[-1][1].trajs
    assert seconds_of(step.header.stamp) == pytest.approx(wanted[-1].stamp, abs=1e-6)
    assert_array_equal(see(HUMANS, step).xy, wanted[-1].xy)
    with pytest.raises(InputError, match="already there"):
        BagWriter(tmp_path / f"run.{kind}")


def content(path):
    return [(frame.stamp, frame.ids.tolist(), frame.xy.tolist()) for frame in read_people(path)]


TOOLS = {"bag": "rosbag reindex", "db3": "ros2 bag reindex", "mcap": "mcap recover"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_cut_short_is_refused_with_the_tool_that_mends_it(tmp_path, kind):
    path = write(tmp_path / f"run.{kind}", length=200)
    file = path if path.is_file() else next(path.glob(f"*.{kind}"))
    whole = file.read_bytes()
    for size in [*np.random.default_rng(0).integers(100, len(whole) - 1, 8), 0]:
        file.write_bytes(whole[:size])
        cut = rf"cannot be read as a bag: .*if it was cut short, `{TOOLS[kind]}`"
        with pytest.raises(InputError, match=cut) as error:
            list(read_people(path))
        assert "\n" not in str(error.value)


def test_which_topic(tmp_path):
    path = tmp_path / "run.mcap"
    with BagWriter(path) as bag:
        frame = frames()[0]
        bag.write("/chatter", frame.stamp, bag.new("std_msgs/msg/String"))
        bag.write("/one", frame.stamp, messages.make_people(bag.new, frame))
    path = bag.path
    assert len(list(read_people(path))) == len(list(read_people(path, "/one"))) == 1
    with pytest.raises(InputError, match=r"/two is not there.*there are: /chatter .*, /one"):
        list(read_people(path, "/two"))
    with pytest.raises(InputError, match="/chatter is not there, or none that carries"):
        list(read_people(path, "/chatter"))
    shutil.rmtree(path)
    with BagWriter(path.with_suffix(".db3")) as bag:
        for topic in ("/one", "/two"):
            bag.write(topic, 1.0, messages.make_people(bag.new, frame))
    with pytest.raises(InputError, match=r"which topic has the people.*/one.*/two.*bag,topic="):
        list(read_people(path))
    shutil.rmtree(path)
    with BagWriter(path.with_suffix(".bag")) as bag:
        bag.write("/chatter", 1.0, bag.new("std_msgs/msg/String"))
    with pytest.raises(InputError, match="none carries people_msgs/msg/People"):
        list(read_people(bag.path))


def test_the_filtered_topic_is_preferred_and_humans_are_people_too(tmp_path):
    frame = frames()[0]
    with BagWriter(tmp_path / "run.bag") as bag:
        moved = messages.make_people(bag.new, frame._replace(xy=frame.xy + 1))
        bag.write(PEOPLE_TOPICS[1], 1.0, moved)
        bag.write(TOPIC, 1.0, messages.make_people(bag.new, frame))
        humans = make_trajectories(bag.new, [2.0], np.array([-5, 6]), np.ones((2, 1, 2)))
        bag.write("/humans", 1.0, humans.trajs[0])
    assert_array_equal(next(read_people(bag.path)).xy, frame.xy)
    assert_array_equal(next(read_people(bag.path, "/humans")).ids, [-5, 6])


def test_whatever_reads_tracks_reads_bags(tmp_path):
    first, second = write(tmp_path / "first.bag"), write(tmp_path / "second.mcap")
    (tracks,) = read_any(first)
    wanted = tracks_of_frames(iter(frames()), "first")
    assert tracks.reading is not None
    assert (tracks.recording, tracks.reading.format) == ("first", "bag")
    assert_array_equal(tracks.id, wanted.id)
    assert_array_equal(tracks.position, wanted.position)
    # The folder of ROS 2 is one recording, a folder of bags is several.
    assert not is_folder(second)
    assert data_files(tmp_path) == files_in(tmp_path) == [first, second]


def test_which_topic_is_said_by_an_option(tmp_path):
    with BagWriter(tmp_path / "run.bag") as bag:
        for n, topic in enumerate(("/one", "/two")):
            frame = Frame(
                1.0 + n, np.array([7, 7, 8]), np.array([[n, 0.0], [1, 1], [-3000, -3000]])
            )
            bag.write(topic, 1.0, messages.make_people(bag.new, frame))
    with pytest.raises(InputError, match="which topic"):
        read_any(bag.path)
    far = pytest.warns(InputWarning, match="people more than 60 m")
    with far, pytest.warns(InputWarning, match="1 positions are left out"):
        (tracks,) = read_any(bag.path, ReadOptions(format="bag,topic=/two"))
    assert_array_equal(tracks.position, [[1, 0]])


def test_bad_paths_and_values(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        list(read_frames(tmp_path / "none.bag"))
    with pytest.raises(InputError, match="not a bag"):
        list(read_frames(tmp_path))
    with pytest.raises(InputError, match=r"ends in \.bag"):
        BagWriter(tmp_path / "run.txt")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        BagWriter(tmp_path / "file" / "run.bag")
    with BagWriter(tmp_path / "new" / "run.bag") as bag:
        people = messages.make_people(bag.new, frames()[0])
        with pytest.raises(InputError, match="does not fit"):
            bag.write(TOPIC, -1.0, people)


def test_text_files_are_streams_too(tmp_path):
    path = tmp_path / "tracks.txt"
    path.write_text("0 1 0 0\n10 1 1 0\n10 2 5 5\n20 2 6 5\n")
    got = list(read_frames(path))
    assert [frame.ids.tolist() for frame in got] == [[1], [1, 2], [2]]
    assert [frame.stamp for frame in got] == pytest.approx([0, 0.4, 0.8])
    with pytest.raises(InputError, match="unknown field 'topic' for Text"):
        read_frames(path, ReadOptions(format="text,topic=/people"))
    tracks = tracks_of_frames(iter(got), "again")
    assert_array_equal(tracks.id, [1, 1, 2, 2])
    with pytest.raises(InputError, match="nobody"):
        tracks_of_frames(iter([]), "again")


DEBIAN = """
import sys
import rosbag
from genpy.dynamic import generate_dynamic
source, target = sys.argv[1:]
with rosbag.Bag(source) as old, rosbag.Bag(target, "w") as new:
    for topic, message, time in old.read_messages():
        assert message._md5sum == "18722f4b8db20cc2369740732357847b", message._md5sum
        new.write(topic, message, time)
"""


def test_debians_rosbag_reads_ours_and_we_its(tmp_path):
    python = "/usr/bin/python3"
    if subprocess.run([python, "-c", "import rosbag"], capture_output=True).returncode:
        pytest.skip("Debian's python3-rosbag is not installed")
    source, target = write(tmp_path / "run.bag"), tmp_path / "debian.bag"
    done = subprocess.run(
        [python, "-c", DEBIAN, source, target], capture_output=True, text=True, env={}
    )
    assert done.returncode == 0, done.stderr
    for a, b in zip(read_people(source), read_people(target), strict=True):
        assert a.stamp == b.stamp
        assert_array_equal(a.xy, b.xy)


def test_without_rosbags_it_says_what_to_install(tmp_path):
    path = tmp_path / "run.bag"
    path.touch()
    code = (
        "import sys; sys.modules['rosbags'] = None\n"
        "from neurosym_robot.ros.bags import read_people\n"
        "from pathlib import Path\n"
        "from neurosym_jax.errors import InputError\n"
        f"try: list(read_people(Path({str(path)!r})))\n"
        "except InputError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "pip install 'neurosym-jax[robot]'" in done.stdout, done.stderr
