"""Every command in a block of the robot's pages runs, in order, with the real programs around it."""

import itertools
import os
import re
import shlex
import signal
import sys
import tomllib

import pytest

from neurosym_jax.__main__ import main
from neurosym_robot.ros.definitions import GRID, MARKERS, ros1_name
from neurosym_robot.ros.messages import outputs
from neurosym_robot.tracking.following import tracks_of_frames
from tests.repository import ROOT
from tests.robot.recordings import walkers, write_people
from tests.robot.ros.ros1_graph import OURS, Process, start_graph

pytest.importorskip("rosbags", reason="rosbags is not installed")
pytestmark = pytest.mark.slow

PAGES = ("robot", "nav2", "ros", "predictor")
COMMAND = re.compile(r"(?m)^ {4,}((?:pip|neurosym|python|roslaunch|ros2|colcon) .*)$")
TOPIC = "/my_tracker/people"
HEARD = {
    output.topic: output.kind
    for output in outputs(["recommended"])
    if output.kind in (MARKERS, GRID)
}
"""What RViz and Nav2 listen to."""
NOT_HERE = {"ros2 launch": "launch_ros is not on PyPI"}


def commands() -> dict[str, list[str]]:
    """The commands of each page."""
    texts = {name: (ROOT / "docs" / f"{name}.md").read_text() for name in PAGES}
    return {name: COMMAND.findall(text) for name, text in texts.items()}


def of_kind(*words: str) -> list[str]:
    """Commands of all pages that begin so, each once, in their order."""
    lines = itertools.chain(*commands().values())
    return [line for line in dict.fromkeys(lines) if line.startswith(words)]


def ours(line: str) -> list[str]:
    """A command of ours as words."""
    program, *words = shlex.split(line)
    assert program == "neurosym"
    if "--dashboard" in words:
        # Tests run at the same time, and of those some serve at the same port.
        words += ["--port", "0"]
    return [sys.executable, "-m", "neurosym_jax", *words]


def test_no_command_is_forgotten():
    lines = list(itertools.chain(*commands().values()))
    begin = ("pip install -e", "roslaunch", *NOT_HERE)
    begin += tuple(f"neurosym {name} " for name in ("ros1", "ros2", "replay", "stitch"))
    assert [line for line in lines if not line.startswith(begin)] == []
    assert all(commands().values())
    assert len(lines) > 12


def test_what_is_installed_is_an_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = of_kind("pip")
    assert lines
    for line in lines:
        extras = re.search(r"\.\[([\w,-]+)\]", line)
        assert extras
        assert set(extras[1].split(",")) <= project["optional-dependencies"].keys()


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    graph = start_graph(tmp_path_factory.mktemp("ros"))
    yield graph
    graph.close()


@pytest.mark.parametrize("line", of_kind("neurosym ros1", "roslaunch"))
def test_on_ros_1(graph, line):
    """A tracker of rospy publishes; what RViz shows comes."""
    options = dict(OURS)
    if line.startswith("neurosym"):
        command = ours(line)
    else:
        options |= {
            "ROS_PACKAGE_PATH": str(ROOT / "ros"),
            "NEUROSYM_PYTHON": sys.executable,
        }
        line = line.replace("/models/mine", "recommended")
        command = shlex.split(line.replace("rviz:=true", "rviz:=false"))
    talker = graph.talker(10, TOPIC)
    hearer = graph.hearer(*(f"{name}={ros1_name(HEARD[name])}" for name in HEARD))
    node = graph.start(*command, **options)
    hearer.wait(lambda: {f"heard {topic}" for topic in HEARD} <= {*hearer.lines})
    assert node.end(signal.SIGINT) == 0, node.lines
    talker.end()
    hearer.end()
    said = "\n".join(node.lines)
    assert "Traceback" not in said, said


@pytest.mark.parametrize("line", of_kind("neurosym ros2"))
def test_on_ros_2(ros2, tmp_path, line):
    """The same by rclpy."""
    python, environment = ros2
    node = Process(tmp_path / "node", python, *ours(line)[1:], env=environment)
    script = ROOT / "tests/robot/ros/rclpy_walkers.py"
    heard = [f"{topic}={kind}" for topic, kind in HEARD.items()]
    peer = Process(tmp_path / "peer", python, script, TOPIC, *heard, env=environment)
    try:
        node.wait(lambda: peer.process.poll() is not None)
        assert {f"heard {topic}" for topic in HEARD} == {*peer.lines}
        assert node.end(signal.SIGINT) == 0, node.lines
        assert "Traceback" not in "\n".join(node.lines)
    finally:
        peer.end()
        node.end()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a reader's recordings."""
    folder = tmp_path_factory.mktemp("recordings")
    frames = walkers(6.0)
    write_people(folder / "recording.bag", frames)
    tracks = tracks_of_frames(iter(frames))
    rows = zip(tracks.stamp - 1.7e9, tracks.id, tracks.position)
    lines = [f"{stamp:.1f},{id},{x:.3f},{y:.3f}" for stamp, id, (x, y) in rows]
    for name in ("my_tracks.txt", "tracks.txt"):
        (folder / name).write_text("\n".join(["time,id,x,y", *lines]))
    return folder


OF_A_RECORDING = of_kind("neurosym replay", "neurosym stitch")
SERVED = [line for line in OF_A_RECORDING if "--dashboard" in line]


@pytest.mark.parametrize("line", SERVED)
def test_what_is_served_live_is_stopped_when_it_says_so(folder, line):
    environment = dict(os.environ, PYTHONPATH=str(ROOT), PYTHONUNBUFFERED="1")
    here = ["bash", "-c", f"cd {folder} && exec {shlex.join(ours(line))}"]
    process = Process(folder / "log", *here, env=environment)
    process.wait_for(lambda text: text == "live until interrupted")
    assert process.end(signal.SIGINT) == 130
    said = "\n".join(process.lines)
    assert "Traceback" not in said, said


@pytest.mark.parametrize(
    "line", [line for line in OF_A_RECORDING if line not in SERVED]
)
def test_of_a_recording(folder, line, monkeypatch):
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit) as end:
        main(shlex.split(line)[1:])
    assert not end.value.code
    for written in re.findall(r"--(?:out|html|foxglove) (\S+)", line):
        assert (folder / written).stat().st_size > 1000
