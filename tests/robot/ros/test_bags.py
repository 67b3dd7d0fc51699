"""Bags of all three kinds give back what was written, and damaged ones say so in one line."""

import importlib
import shutil
import sqlite3
import struct
import subprocess
import sys
import warnings
import zlib

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.data.formats import data_files, is_folder, read_any
from neurosym_jax.data.inspection import files_below
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.simulation.scenarios import simulate
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.recordings import frames_of_tracks, tracks_of_frames
from neurosym_robot.ros import messages
from neurosym_robot.ros.bag_names import is_bag
from neurosym_robot.ros.bags import BagWriter, read_messages, read_people
from neurosym_robot.ros.definitions import HUMANS, PEOPLE, typestore
from neurosym_robot.ros.people import seconds_of, see
from neurosym_robot.ros.recordings import read_frames

pytest.importorskip("rosbags", reason="rosbags is not installed")


KINDS = ["bag", "db3", "mcap"]
TOPIC = messages.PEOPLE_TOPICS[0]


def frames(length: int = 20) -> list[Frame]:
    tracks = simulate("cross-path", 1, length / 10, people=3)
    return [frame._replace(stamp=frame.stamp + 1.7e9) for frame in frames_of_tracks(tracks)]


def write(path, topic=TOPIC, length=20):
    """A bag of people; the path of what was written."""
    with BagWriter(path) as bag:
        for frame in frames(length):
            bag.write(topic, frame.stamp, messages.make_people(bag.types, frame))
    return bag.path


@pytest.mark.parametrize("kind", KINDS)
def test_people_and_forecasts_there_and_back(tmp_path, kind):
    wanted = frames()
    with BagWriter(tmp_path / f"run.{kind}") as bag:
        for frame in wanted:
            bag.write(TOPIC, frame.stamp, messages.make_people(bag.types, frame))
            trajectories = messages.make_trajectories(
                bag.types, frame.stamp, [frame.stamp], frame.ids, frame.xy[:, None]
            )
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


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_cut_short_is_read_as_far_as_it_goes(tmp_path, kind):
    """Wherever it is cut, what is read is how the whole begins, and it is said."""
    path = write(tmp_path / f"run.{kind}", length=200)
    file = path if path.is_file() else next(path.glob(f"*.{kind}"))
    whole, wanted, longest = file.read_bytes(), content(path), 0
    for size in np.random.default_rng(0).integers(len(whole) // 2, len(whole), 8):
        file.write_bytes(whole[:size])
        with pytest.warns(InputWarning, match=r"run.*cut short.*messages of .* s in"):
            found = content(path)
        assert found == wanted[: len(found)]
        longest = max(longest, len(found))
    assert longest > 0.8 * len(wanted)
    for part in (0.01, 0.0):
        file.write_bytes(whole[: int(part * len(whole))])
        with pytest.raises(InputError, match=r"run.*cannot be read as a bag.*cut short") as error:
            list(read_people(path))
        assert "\n" not in str(error.value)


KILLED = """
import sys, time
from pathlib import Path
from neurosym_robot.ros import bags
from tests.robot.ros.test_bags import TOPIC, frames, messages
bags.KEEP = 0.0
bag = bags.BagWriter(Path(sys.argv[1]))
for frame in frames():
    bag.write(TOPIC, frame.stamp, messages.make_people(bag.types, frame))
bags.KEEP = 60.0
bag.write(TOPIC, frame.stamp + 1, messages.make_people(bag.types, frame))  # Lost.
print("written", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_killed_writer_leaves_is_told_and_read(tmp_path, kind):
    wanted, path = content(write(tmp_path / f"whole.{kind}")), tmp_path / f"run.{kind}"
    with subprocess.Popen([sys.executable, "-c", KILLED, path], stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"written\n"
        process.kill()
    left = path.with_suffix(".bag.active" if kind == "bag" else "")
    if kind == "db3":  # Of a transaction that is to be undone.
        assert (left / "run.db3-journal").stat().st_size
    assert is_bag(left)
    with pytest.warns(InputWarning, match="never finished"):
        found = content(left)
    assert len(found) >= len(wanted) - 1
    assert found == wanted[: len(found)]
    with pytest.warns(InputWarning, match="never finished"):
        (tracks,) = read_any(left)
    assert tracks.reading is not None
    assert "never finished" in tracks.reading.warnings[0], "which is what inspect tells"
    with pytest.raises(InputError, match="already there"):
        BagWriter(path)


def test_what_a_recorder_left_in_a_databases_log_is_read(tmp_path):
    """ROS 2's own may write ahead to a log, at which rosbags does not look."""
    path = write(tmp_path / "run.db3")
    whole = content(path)
    base = sqlite3.connect(path / "run.db3")
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("INSERT INTO messages SELECT 1000, topic_id, 2e18, data FROM messages LIMIT 1")
    base.commit()
    with pytest.warns(InputWarning, match="cut short"):
        assert content(path) == [*whole, whole[0]]
    base.close()


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4", "zstd"])
def test_the_last_chunk_of_a_recorder_that_was_killed(tmp_path, compression):
    """Compressed; of ROS 1 its sizes are zero until it is finished."""
    rosbag1, rosbag2 = (importlib.import_module(f"rosbags.rosbag{n}") for n in (1, 2))
    whole = frames(40)
    store_2 = compression == "zstd"
    if store_2:
        store, path = typestore(2), tmp_path / "run"
        writer = rosbag2.Writer(path, version=8, storage_plugin=rosbag2.StoragePlugin.MCAP)
        writer.set_compression(rosbag2.CompressionMode.STORAGE, rosbag2.CompressionFormat.ZSTD)
    else:
        store, path = typestore(1), tmp_path / "run.bag"
        writer = rosbag1.Writer(path)
        if compression != "none":
            writer.set_compression(writer.CompressionFormat[compression.upper()])
    writer.open()
    topic = writer.add_connection(TOPIC, PEOPLE, typestore=store)
    serialise = store.serialize_cdr if store_2 else store.serialize_ros1
    for n, frame in enumerate(whole):
        message = messages.make_people(store.types, frame)
        writer.write(topic, round(1e9 * frame.stamp), serialise(message, PEOPLE))
        if n == 20:
            _ = writer.storage.close_chunk() if store_2 else writer.write_chunk(writer.chunks[-1])
    writer.close()
    file = path if path.is_file() else path / "run.mcap"
    written = file.read_bytes()
    # Of mcap the name of the compression is followed by 8 bytes of size, in the index by more.
    begins = written.find(b"\4\0\0\0zstd", written.find(b"\4\0\0\0zstd") + 1) + 16
    if path.is_file():
        begins = written.rfind(b"size=") + 13
        written = written[: begins - 8] + bytes(8) + written[begins:]
    file.write_bytes(written[: begins + 600])
    with pytest.warns(InputWarning, match="cut short"):
        found = list(read_people(path))
    assert len(found) >= 21
    for a, b in zip(found, whole, strict=False):
        assert_array_equal(a.xy, b.xy)


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_bytes_lose_no_frame_in_silence(tmp_path, kind):
    """Values change where a container has no checksum; frames are all there, or it is said."""
    path = write(tmp_path / f"run.{kind}")
    files = [path] if path.is_file() else sorted(path.iterdir())
    length, refused = len(list(read_people(path))), 0
    rng = np.random.default_rng(0)
    for number in range(60):
        # Of a folder: metadata.yaml now and then, else the data.
        file = files[0] if number % 10 == 0 else files[-1]
        whole = file.read_bytes()
        broken = bytearray(whole)
        for _ in range(rng.integers(1, 4)):
            broken[rng.integers(len(broken))] ^= rng.integers(1, 256)
        file.write_bytes(broken)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                assert len(list(read_people(path))) == length or said, number
            except InputError:
                refused += 1
        file.write_bytes(whole)
    assert refused > 12


@pytest.mark.parametrize("place", ["data", "index"])
def test_checksums_of_mcap(tmp_path, place):
    """What recorders write, rosbags does not: the checksums of data and of index."""
    path = next(write(tmp_path / "run.mcap").glob("*.mcap"))
    whole = path.read_bytes()
    # The footer is last: 9 bytes of head, where the summary begins, its offsets, its checksum.
    (summary,) = struct.unpack_from("<Q", whole, len(whole) - 28)
    end = summary - 4  # of the record that ends the data, whose content is their checksum
    data = zlib.crc32(whole[: end - 9])
    signed = whole[:end] + struct.pack("<I", data) + whole[summary:-12]
    signed += struct.pack("<I", zlib.crc32(signed[summary:])) + whole[-8:]
    path.write_bytes(signed)
    assert len(list(read_people(path))) > 10
    at = 3000 if place == "data" else summary + 30
    path.write_bytes(signed[:at] + bytes([signed[at] ^ 1]) + signed[at + 1 :])
    with pytest.raises(InputError, match=f"its {place} do"):
        list(read_people(path))


def test_which_topic(tmp_path):
    path = tmp_path / "run.mcap"
    with BagWriter(path) as bag:
        frame = frames()[0]
        text = bag.types["std_msgs/msg/String"]("hello")
        bag.write("/chatter", frame.stamp, text)
        bag.write("/one", frame.stamp, messages.make_people(bag.types, frame))
    path = bag.path
    assert len(list(read_people(path))) == len(list(read_people(path, "/one"))) == 1
    with pytest.raises(InputError, match=r"no topic /two; there are: /chatter .*, /one"):
        list(read_people(path, "/two"))
    with pytest.raises(InputError, match=r"/chatter carries std_msgs/msg/String, not people_msgs"):
        list(read_people(path, "/chatter"))
    shutil.rmtree(path)
    with BagWriter(path.with_suffix(".db3")) as bag:
        for topic in ("/one", "/two"):
            bag.write(topic, 1.0, messages.make_people(bag.types, frame))
    with pytest.raises(InputError, match=r"which topic has the people.*/one.*/two.*--topic"):
        list(read_people(path))
    shutil.rmtree(path)
    with BagWriter(path.with_suffix(".bag")) as bag:
        bag.write("/chatter", 1.0, bag.types["std_msgs/msg/String"]("hello"))
    with pytest.raises(InputError, match="none carries people_msgs/msg/People"):
        list(read_people(bag.path))


def test_the_filtered_topic_is_preferred_and_humans_are_people_too(tmp_path):
    frame = frames()[0]
    with BagWriter(tmp_path / "run.bag") as bag:
        moved = messages.make_people(bag.types, frame._replace(xy=frame.xy + 1))
        bag.write(messages.PEOPLE_TOPICS[1], 1.0, moved)
        bag.write(TOPIC, 1.0, messages.make_people(bag.types, frame))
        humans = messages.make_trajectories(
            bag.types, 1.0, [2.0], np.array([-5, 6]), np.ones((2, 1, 2))
        )
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
    assert data_files(tmp_path) == files_below(tmp_path) == [first, second]


def test_which_topic_is_said_by_an_option(tmp_path):
    with BagWriter(tmp_path / "run.bag") as bag:
        for n, topic in enumerate(("/one", "/two")):
            frame = Frame(
                1.0 + n, np.array([7, 7, 8]), np.array([[n, 0.0], [1, 1], [-3000, -3000]])
            )
            bag.write(topic, 1.0, messages.make_people(bag.types, frame))
    with pytest.raises(InputError, match="which topic"):
        read_any(bag.path)
    with pytest.warns(InputWarning, match="2 positions are left out"):
        (tracks,) = read_any(bag.path, ReadOptions(topic="/two"))
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
        people = messages.make_people(bag.types, frames()[0])
        with pytest.raises(InputError, match="does not fit"):
            bag.write(TOPIC, -1.0, people)


def test_text_files_are_streams_too(tmp_path):
    path = tmp_path / "tracks.txt"
    path.write_text("0 1 0 0\n10 1 1 0\n10 2 5 5\n20 2 6 5\n")
    got = list(read_frames(path))
    assert [frame.ids.tolist() for frame in got] == [[1], [1, 2], [2]]
    assert [frame.stamp for frame in got] == pytest.approx([0, 0.4, 0.8])
    with pytest.raises(InputError, match="--topic is of no use"):
        read_frames(path, ReadOptions(topic="/people"))
    tracks = tracks_of_frames(iter(got), "again")
    assert_array_equal(tracks.id, [1, 1, 2, 2])
    with pytest.raises(InputError, match="nobody"):
        tracks_of_frames(iter([]), "again")


def test_agents_with_clocks_of_their_own_share_frames(tmp_path):
    path = tmp_path / "thor.csv"
    rows = [
        (n * 0.4 + offset, id, n, n + id) for id, offset in ((1, 0), (2, 0.17)) for n in range(9)
    ]
    path.write_text("".join(f"{t:.2f},{id},{x},{y},3.536,0.785\n" for t, id, x, y in rows))
    assert max(len(frame.ids) for frame in read_frames(path)) == 2


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
