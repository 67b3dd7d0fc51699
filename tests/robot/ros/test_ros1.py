"""The node in a real ROS 1 graph: roscore, rospy and rosbag as Debian packages them."""

import signal
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.models.disk import save_model
from neurosym_jax.simulation.scenarios import TrackerFaults
from neurosym_robot.commands import replay
from neurosym_robot.ros.bags import read_messages, read_people
from neurosym_robot.ros.definitions import (
    TRUTH_TOPIC,
    seconds_of,
)
from neurosym_robot.ros.tcpros.wire import CallError, call
from tests.repository import ROOT
from tests.robot.recordings import walkers, write_people
from tests.robot.ros.ros1_graph import OURS, SYSTEM, start_graph
from tests.robot.ros.tcpros.conftest import wait

pytest.importorskip("rosbags", reason="rosbags is not installed")

FORECASTS = (
    "/hri/human_poses_prediction",
    "/hri/human_poses_prediction_pool_net",
)
SAMPLES = f"{FORECASTS[0]}/samples"
TELL = """
import rosbag, sys
for _, m, _ in rosbag.Bag(sys.argv[1]).read_messages(sys.argv[2]):
    whole = len(m.futures) == 2 * m.samples * m.steps * len(m.ids)
    print(m.header.frame_id, m.samples, m.steps, whole)
"""
"""The samples of a bag as ROS's own Python reads them."""


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    graph = start_graph(tmp_path_factory.mktemp("ros"))
    yield graph
    graph.close()


@pytest.fixture(scope="module")
def models(tmp_path_factory, model):
    """Two folders of models."""
    folder = tmp_path_factory.mktemp("models")
    for pooling in ("pool_net", "as_described"):
        save_model(folder / pooling, model(pooling))
    return sorted(folder.iterdir())


@pytest.fixture(scope="module")
def node(graph, models):
    """Our node, which lives through everything that the tests below do to the graph."""
    command = (
        sys.executable,
        "-m",
        "neurosym_jax",
        "ros1",
        "--topic",
        "/people",
        "--samples",
        3,
    )
    node = graph.start(*command, "--max-people", 4, "--model", *models, **OURS)
    node.wait_for(lambda line: "listening" in line)
    return node


def count(topic: str, rows: list[dict]) -> int:
    return sum(row["topic"] == topic for row in rows)


def both(rows: list[dict]) -> bool:
    """Whether both models were heard."""
    return all(count(topic, rows) for topic in FORECASTS)


def test_a_rospy_tracker_is_answered_and_a_rospy_listener_hears_it(graph, node):
    listener = graph.listener()
    talker = graph.talker(rate=10)
    rows = listener.wait_heard(lambda rows: both(rows) and count(TRUTH_TOPIC, rows) > 1)
    talker.end()
    begin = min(row["stamp"] for row in rows[1:])
    # Before, nobody is forecast, or by a line through what was seen.
    late = [row for row in rows[1:] if row["stamp"] > begin + 1.3]
    whole = [row for row in late if row["steps"][0]]
    assert len(whole) > 5
    for row in whole:
        steps = np.array(row["steps"])
        assert steps.shape == (7, 2, 3)
        assert row["frame"] == "odom"
        assert (steps[:, :, 0] == [1, 2]).all()
        length = 7 if row["topic"] == TRUTH_TOPIC else 4
        # They walk along x at 1 m/s, and the stamp is that of the last step observed.
        start = steps[3, 0, 1]
        assert_allclose(
            steps[:length, 0, 1] - start, 0.4 * np.arange(-3, length - 3), atol=1e-5
        )
        assert_allclose(steps[:length, :, 2], [[1, 2]] * length, atol=1e-9)
    delays = [row["late"] for row in rows if row["topic"] in FORECASTS]
    print(
        "from a frame's stamp to its forecast at a rospy listener, ms:",
        1e3 * np.median(delays),
    )
    assert np.median(delays) < 0.5


def samples_by_stamp(bag):
    """The messages of samples in a bag."""
    messages = [message for topic, message in read_messages(bag) if topic == SAMPLES]
    return {round(seconds_of(message.header.stamp), 6): message for message in messages}


@pytest.mark.slow
def test_rosbag_plays_our_bag_and_records_our_answers(graph, node, models, tmp_path):
    path, recorded = tmp_path / "people.bag", tmp_path / "recorded.bag"
    # Of five people the nearest four are forecast, and some are lost for a moment.
    faults = TrackerFaults(dropout=0.01, dropout_seconds=0.5)
    write_people(path, walkers(8.0, people=5, faults=faults))
    listener = graph.listener()
    recorder = graph.start(
        "rosbag", "record", "-O", recorded, "/people", *FORECASTS, SAMPLES
    )
    uri = call(graph.uri, "lookupNode", "/tests", "/neurosym_jax")
    recorder.wait(
        lambda: (
            sum("record" in row[1] for row in call(uri, "getBusInfo", "/tests")) == 3
        )
    )
    # On a busy machine it waits for forecasts: of many frames that wait, the node skips some.
    paced = ["--rate-control-topic", SAMPLES, "--rate-control-max-delay", "0.8"]
    done = subprocess.run(
        ["rosbag", "play", "--quiet", "--rate", "4", "--delay", "0.5", *paced, path],
        env=graph.env,
        capture_output=True,
        text=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
    )
    assert done.returncode == 0, done.stderr
    assert "Rate control topic is bad" not in done.stdout
    rows = listener.wait_heard(lambda rows: both(rows) and count(TRUTH_TOPIC, rows))
    heard = {
        (row["topic"], round(row["stamp"], 6))
        for row in rows
        # Not the last ones of a talker before.
        if row["topic"] in FORECASTS and row["stamp"] < 1.7e9 + 9
    }
    assert all(stamp >= 1.7e9 for _, stamp in heard)
    recorder.end(signal.SIGINT)
    wait(recorded.exists)  # Its child gives the file its name.
    topics = {
        (topic, round(seconds_of(message.header.stamp), 6))
        for topic, message in read_messages(recorded)
        if topic in FORECASTS
    }
    assert len(heard & topics) > 10
    output = subprocess.run(
        [SYSTEM, "-c", TELL, recorded, SAMPLES], capture_output=True, text=True
    )
    rows = [line.split() for line in output.stdout.splitlines()]
    assert len(rows) > 10, output.stderr
    assert {tuple(row) for row in rows} == {("odom", "3", "3", "True")}
    assert 40 < len(list(read_people(recorded, "/people"))) <= 81
    # What was played live is what a replay of the bag says, frame by frame.
    out = tmp_path / "replayed.bag"
    few = {"samples": 3, "max_people": 4}
    replay.run(replay.Options(recording=(path,), model=tuple(models), out=out, **few))
    live, again = samples_by_stamp(recorded), samples_by_stamp(out)
    assert len(live.keys() & again.keys()) > 10
    assert live.keys() <= again.keys()
    assert any(message.extrapolated.any() for message in live.values())
    for stamp, message in live.items():
        for field in ("ids", "position", "extrapolated", "futures"):
            assert_allclose(
                getattr(message, field), getattr(again[stamp], field), atol=1e-5
            )


@pytest.mark.slow
def test_the_master_is_restarted(graph, node):
    graph.core.end(signal.SIGINT)
    node.wait_for(lambda line: "waiting for the master" in line)
    graph.start_core()
    node.wait_for(lambda line: "registers again" in line)
    listener = graph.listener()
    talker = graph.talker()
    listener.wait_heard(both)
    talker.end()


@pytest.mark.slow
def test_it_leaves_the_graph_when_told_to(graph, node):
    listener, talker = graph.listener(), graph.talker()
    listener.wait_heard(lambda rows: count(TRUTH_TOPIC, rows))
    talker.end()
    assert node.end(signal.SIGTERM) == 0
    with pytest.raises(CallError, match="unknown node"):
        call(graph.uri, "lookupNode", "/tests", "/neurosym_jax")
    assert "Traceback" not in "\n".join(node.lines)
    assert any(line.split()[:2] == ["published", "ADE"] for line in node.lines), (
        node.lines[-8:]
    )


@pytest.mark.slow
def test_roslaunch_starts_it_with_remaps_and_parameters(graph, models, tmp_path):
    parameters = tmp_path / "forecast.yaml"
    parameters.write_text(
        "{samples: 3, max_people: 4, only: name=2, stitch: true, links: {max_gap: 3.0}}"
    )
    launched = graph.start(
        *(
            "roslaunch",
            "--wait",
            "neurosym_ros",
            "forecast.launch",
            f"parameters:={parameters}",
        ),
        f"model:=[{', '.join(map(str, models))}]",
        *("people:=/people", "mended:=/mended", "name:=launched"),
        **OURS,
        ROS_PACKAGE_PATH=str(ROOT / "ros"),
        NEUROSYM_PYTHON=sys.executable,
    )
    launched.wait_for(lambda line: "/launched: listening to /people" in line)
    listener = graph.listener()
    talker = graph.talker()
    rows = listener.wait_heard(
        lambda rows: both(rows) and len(rows[-1]["steps"][-1]) == 1
    )
    talker.end()
    steps = np.array(rows[-1]["steps"])
    assert steps.shape[1:] == (1, 3)
    assert (steps[:, :, 0] == 2).all()  # The only one who is a person.
    published = {
        name for name, _ in call(graph.uri, "getPublishedTopics", "/tests", "")
    }
    assert {
        "/mended",
        "/diagnostics",
        *(f"{topic}/markers" for topic in FORECASTS),
    } <= published
    launched.wait_for(lambda line: "stale: the newest people are" in line)
    assert launched.end(signal.SIGINT) == 0
    assert "Traceback" not in "\n".join(launched.lines)
