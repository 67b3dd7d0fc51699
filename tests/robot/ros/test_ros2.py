r"""A real ROS 2: poses published with rclpy, our node's forecasts heard with rclpy.

ROS 2 is looked for in the Python that `$NEUROSYM_ROS2` names, else in this one. To make
one:

    python -m venv ros2 && ros2/bin/pip install ros-kilted-rclpy \
        ros-kilted-rmw-fastrtps-cpp ros-kilted-rmw-implementation \
        ros-kilted-geometry-msgs ros-kilted-nav-msgs ros-kilted-visualization-msgs
    NEUROSYM_ROS2=ros2/bin/python pytest tests/robot/ros/test_ros2.py
"""

import itertools
import json
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.models.disk import load_model
from neurosym_robot.online.predictor import Predictor
from tests.repository import ROOT
from tests.robot.recordings import walkers

WITH_TRACES = ("-X", "faulthandler")
MODEL = ROOT / "checkpoints" / "neurosym_zara1_8"


def start_node(log, python, environment, options):
    """Our node with these options of ROS; what it prints as errors goes to `log`."""
    node = ("-m", "neurosym_jax", "ros2", "--model", MODEL, "--ros-args", *options)
    with log.open("w") as errors:
        return subprocess.Popen(
            [python, *WITH_TRACES, *node],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )


def end_node(node):
    """What it printed, once a Ctrl-C has ended it."""
    node.send_signal(signal.SIGINT)
    try:
        words, _ = node.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        # Seen once, on a busy machine: faulthandler says where all its threads are.
        node.send_signal(signal.SIGABRT)
        words, _ = node.communicate(timeout=30)
    return words


def test_poses_in_forecasts_and_markers_out(ros2, tmp_path):
    python, environment = ros2
    frames = walkers(8.0)
    path = tmp_path / "frames.json"
    # The node sleeps for half a second.
    awake = [not 40 <= n < 45 for n in range(len(frames))]
    rows = [[frame.stamp, frame.xy.tolist(), on] for frame, on in zip(frames, awake)]
    path.write_text(json.dumps(rows))
    frames = list(itertools.compress(frames, awake))
    parameters = tmp_path / "forecast.yaml"
    words = "message: PoseArray, autostart: false, samples: 9, max_people: 4"
    parameters.write_text(f"/**: {{ros__parameters: {{{words}}}}}")
    options = ["-r", "__node:=mine", "-r", "/people_tracker/people_filtered:=/seen"]
    options += ["--params-file", parameters]
    options += ["-p", "samples:=4", "-p", "use_sim_time:=true"]
    log = tmp_path / "log"
    node = start_node(log, python, environment, options)
    try:
        end = time.monotonic() + 300
        compiled = "everything is compiled"
        while compiled not in log.read_text() and time.monotonic() < end:
            assert node.poll() is None, log.read_text()
            time.sleep(0.2)
        script = Path(__file__).with_name("rclpy_peer.py")
        peer = subprocess.run(
            [python, script, path, "0.06", "/seen"],
            env=environment,
            capture_output=True,
            text=True,
            timeout=400,
        )
    finally:
        words = end_node(node)
    errors = log.read_text()
    assert peer.returncode == 0, peer.stderr
    assert node.returncode == 0, errors
    assert f"{len(frames)} frames" in words
    assert "[mine]: listening to /seen" in errors
    assert "Traceback" not in errors
    assert "this ROS 2 has no darko_perception_msgs: nothing is published on" in errors

    heard = json.loads(peer.stdout)
    options = {"samples": 4, "max_people": 4, "hold": 1.0, "min_seen": 0.0}
    predictor = Predictor(load_model(MODEL), **options)
    forecasts = filter(None, (predictor.push(*frame) for frame in frames))
    expected = {round(forecast.stamp, 3): forecast for forecast in forecasts}
    assert len(expected) == len(frames)
    # A forecast with every frame, but for those that were skipped.
    assert len(heard) > 0.5 * len(expected)
    for message in heard:
        forecast = expected[round(message["stamp"], 3)]
        (result,) = forecast.models.values()
        central = result.samples[result.central]
        path = np.concatenate([forecast.observed[:, -1:], central], axis=1)
        people = zip(forecast.ids.tolist(), path, strict=True)
        markers = message["markers"][1:]
        for marker, (id, way) in zip(markers, people, strict=True):
            assert marker["ns"] == f"{MODEL.name}/{id}"
            assert (marker["type"], marker["frame_id"]) == (4, "odom")
            assert_allclose(marker["points"], way, atol=1e-4)


def test_people_msgs_may_be_missing(ros2):
    python, environment = ros2
    probe = subprocess.run([python, "-c", "import people_msgs"], capture_output=True)
    if probe.returncode == 0:
        pytest.skip("this ROS 2 has people_msgs")
    command = [python, "-m", "neurosym_jax", "ros2", "--model", MODEL]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (
        2,
        "error: this ROS 2 has no people_msgs\n",
    )


def test_no_arguments_of_ros_are_needed(ros2):
    """rclpy imports less of itself where it was not asked for parameters."""
    python, environment = ros2
    command = [
        python,
        "-m",
        "neurosym_jax",
        "ros2",
        "--model",
        MODEL,
        "--message",
        "PoseArray",
    ]
    node = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    assert any("everything is compiled" in line for line in node.stderr or ())
    node.send_signal(signal.SIGINT)
    assert "Traceback" not in node.communicate(timeout=120)[1]
    assert node.returncode == 0
