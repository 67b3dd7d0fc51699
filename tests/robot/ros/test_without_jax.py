"""Nodes of an .onnx file in real graphs of ROS 1 and ROS 2, where no JAX is installed.

The folder of packages is that which docs/export.md says to install, and what they
require. Forecasts are those of JAX.
"""

import json
import os
import re
import signal
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from packaging.requirements import Requirement

from neurosym_jax.commands import export
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.ros.definitions import (
    FORECAST,
    FORECAST_TOPIC,
    ros1_name,
    seconds_of,
    typestore,
)
from neurosym_robot.ros.tcpros import Node, Topic
from tests.repository import ROOT
from tests.robot.recordings import walkers, write_people
from tests.robot.ros.ros1_graph import Process, start_graph
from tests.robot.ros.tcpros.conftest import wait

pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")
pytest.importorskip("onnx", reason="onnx is not installed")
pytestmark = pytest.mark.slow

SAMPLES = f"{FORECAST_TOPIC}/samples"
MEGABYTES, RCLPY = 120, 40
"""Most memory of a node, and what rclpy takes beside it."""
SECONDS = 5.0
"""Most of a processor before a node listens: a busy one takes 2 s, JAX more than ten."""


@pytest.fixture(scope="module")
def packages(tmp_path_factory) -> Path:
    """A folder with links to the packages of the page, and to our own metadata."""
    page = (ROOT / "docs/export.md").read_text()
    folder = tmp_path_factory.mktemp("packages")
    waiting = re.search(r"then `pip install ([\w\s-]+)`", page)[1].split()
    installed = {"neurosym-jax": distribution("neurosym-jax")}
    while waiting:
        name = waiting.pop()
        if name in installed:
            continue
        installed[name] = distribution(name)
        for text in installed[name].requires or ():
            requirement = Requirement(text)
            marker = requirement.marker
            if marker is None or marker.evaluate({"extra": ""}):
                waiting.append(requirement.name)
    assert not {"jax", "scipy", "flax"} & installed.keys()
    for package in installed.values():
        for name in {file.parts[0] for file in package.files} - {"..", "__pycache__"}:
            if not (folder / name).exists():
                (folder / name).symlink_to(package.locate_file(name))
    return folder


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """`recommended` as a file."""
    file = tmp_path_factory.mktemp("onnx") / "model.onnx"
    export.run("recommended", file, points=True)
    return file


@pytest.fixture(scope="module")
def expected() -> dict:
    """By stamp, what JAX forecasts of the people whom `frames` are of."""
    options = {"hold": 1.0, "min_seen": 0.0, "max_people": 4, "compile": "needed"}
    predictor = Predictor(load_models([Path("recommended")]), **options)
    forecasts = (predictor.push(*frame) for frame in frames())
    return {round(forecast.stamp, 3): forecast for forecast in forecasts}


def frames():
    return walkers(5.0)


def central_path(forecast) -> np.ndarray:
    """[N, 1 + T, 2] metres, from the last observed position on."""
    (result,) = forecast.models.values()
    central = result.samples[result.central]
    return np.concatenate([forecast.observed[:, -1:], central], axis=1)


def cost_of(process: subprocess.Popen) -> tuple[float, float]:
    """Seconds of a processor that a process has taken, and the most memory, MB."""
    folder = Path(f"/proc/{process.pid}")
    ticks = (folder / "stat").read_text().rpartition(")")[2].split()[11:13]
    peak = re.search(r"VmHWM:\s+(\d+) kB", (folder / "status").read_text())
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK"), int(peak[1]) / 1024


def no_jax(python, options, environment) -> None:
    """Assert that this Python finds no JAX and no SciPy."""
    code = "import importlib.util as u; print(u.find_spec('jax'), u.find_spec('scipy'))"
    words = [python, *options, "-c", code]
    assert subprocess.check_output(words, env=environment, text=True) == "None None\n"


def test_ros2(ros2, packages, model, expected, tmp_path):
    python, environment = ros2
    environment |= {"PYTHONPATH": os.pathsep.join([str(packages), str(ROOT)])}
    no_jax(python, (), environment)
    rows = [[frame.stamp, frame.xy.tolist(), True] for frame in frames()]
    (tmp_path / "frames.json").write_text(json.dumps(rows))
    words = ("-m", "neurosym_jax", "ros2", "--message", "PoseArray", "--topic", "/seen")
    options = ("--model", model, "--max-people", 4, "--no-autostart")
    named = ("--ros-args", "-r", "__node:=mine")
    node = Process(tmp_path / "node", python, *words, *options, *named, env=environment)
    try:
        node.wait_for(lambda line: "listening to /seen" in line)
        seconds, _ = cost_of(node.process)
        script = Path(__file__).with_name("rclpy_peer.py")
        peer = subprocess.run(
            [python, script, tmp_path / "frames.json", "0.06", "/seen"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=400,
        )
        assert peer.returncode == 0, peer.stderr
        megabytes = cost_of(node.process)[1]
        print(f"ROS 2: {seconds:.2f} s, {megabytes:.0f} MB")
        assert seconds < SECONDS
        assert megabytes < MEGABYTES + RCLPY
    finally:
        status = node.end(signal.SIGINT)
    assert status == 0, node.lines
    assert f"{len(rows)} frames" in "\n".join(node.lines)

    heard = json.loads(peer.stdout)
    assert len(heard) > len(rows) / 2
    for message in heard:
        path = central_path(expected[round(message["stamp"], 3)])
        lines = [marker["points"] for marker in message["markers"][1:]]
        assert len(lines) == len(path)
        assert_allclose(np.reshape(lines, path.shape), path, atol=1e-4)


def test_ros1(packages, model, expected, tmp_path):
    """A bag is played, and waits for forecasts where the machine is busy."""
    graph = start_graph(tmp_path)
    environment = {"PYTHONPATH": os.pathsep.join([str(packages), str(ROOT)])}
    no_jax(sys.executable, ["-S"], graph.env | environment)
    bag = write_people(tmp_path / "people.bag", frames())
    store, heard = typestore(1), []
    definition, md5 = store.generate_msgdef(FORECAST, ros_version=1)
    topic = Topic(SAMPLES, ros1_name(FORECAST), md5, definition)
    words = ("-S", "-m", "neurosym_jax", "ros1", "--topic", "/people")
    options = ("--model", model, "--max-people", 4)
    ear = Node("ear", graph.uri, print)
    try:
        node = graph.start(sys.executable, *words, *options, **environment)
        node.wait_for(lambda line: "listening to /people" in line)
        seconds, _ = cost_of(node.process)
        subscriber = ear.subscribe(topic, lambda data, header: heard.append(data))
        wait(lambda: subscriber.publishers, 60)
        paced = ("--rate-control-topic", SAMPLES, "--rate-control-max-delay", "0.8")
        play = graph.start("rosbag", "play", "--quiet", "--delay", "1", *paced, bag)
        assert play.process.wait(300) == 0, play.lines
        wait(lambda: heard and stamp_of(store, heard[-1]) == max(expected), 60)
        megabytes = cost_of(node.process)[1]
        print(f"ROS 1: {seconds:.2f} s, {megabytes:.0f} MB")
        assert seconds < SECONDS
        assert megabytes < MEGABYTES
        assert node.end(signal.SIGINT) == 0, node.lines
    finally:
        ear.close()
        graph.close()

    assert len(heard) > len(expected) / 2
    for data in heard:
        message = store.deserialize_ros1(data, FORECAST)
        forecast = expected[stamp_of(store, data)]
        path = central_path(forecast)
        shape = message.samples, len(path), message.steps, 2
        assert_array_equal(message.ids, forecast.ids)
        assert_allclose(message.position.reshape(-1, 2), path[:, 0], atol=1e-4)
        central = message.futures.reshape(shape)[message.central]
        assert_allclose(central, path[:, 1:] - path[:, :1], atol=1e-4)
        radius = message.radius.reshape(len(message.levels), *shape[1:3])
        assert (radius > 0).all()


def test_ros2_says_where_people_are(ros2, packages, model, tmp_path):
    """On another topic, of another type, or of two publishers."""
    python, environment = ros2
    environment |= {"PYTHONPATH": os.pathsep.join([str(packages), str(ROOT)])}
    script = Path(__file__).with_name("rclpy_walkers.py")
    words = ("/seen", "/never=geometry_msgs/msg/PoseArray")
    peers = [
        Process(tmp_path / name, python, script, *words, env=environment)
        for name in ("peer", "other")
    ]
    words = (python, "-m", "neurosym_jax", "ros2", "--model", model, "--topic")
    pose = ("--message", "geometry_msgs/PoseStamped", "--people", "pose")
    cases = {
        ("/sen", "--message", "PoseArray"): "nobody publishes /sen; there are people "
        "on /seen (geometry_msgs/PoseArray)",
        ("/seen", *pose): "/seen is of geometry_msgs/PoseArray, but is heard as "
        "geometry_msgs/PoseStamped: --message names its type",
        ("/seen", "--message", "PoseArray"): "people of a second publisher, /walkers (",
    }
    try:
        for number, (options, text) in enumerate(cases.items()):
            log = tmp_path / f"node{number}"
            node = Process(log, *words, *options, env=environment)
            try:
                node.wait_for(lambda line, text=text: text in line)
            finally:
                assert node.end(signal.SIGINT) == 0
    finally:
        for peer in peers:
            peer.end()


def test_ros1_says_where_people_are(packages, model, tmp_path):
    graph = start_graph(tmp_path)
    environment = {"PYTHONPATH": os.pathsep.join([str(packages), str(ROOT)])}
    words = ("-S", "-m", "neurosym_jax", "ros1", "--topic", "/people")
    try:
        talker = graph.talker(10, "/others")
        node = graph.start(sys.executable, *words, "--model", model, **environment)
        text = (
            "nobody publishes /people; there are people on /others (people_msgs/People)"
        )
        node.wait_for(lambda line: line == text)
        talker.end()
        node.end(signal.SIGINT)
    finally:
        graph.close()


def stamp_of(store, data: bytes) -> float:
    """The stamp of a serialised forecast."""
    return round(seconds_of(store.deserialize_ros1(data, FORECAST).header.stamp), 3)
