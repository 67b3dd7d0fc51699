"""What cannot be used is refused in one line that names it."""

import contextlib
import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError
from neurosym_robot.commands import replay, ros2
from neurosym_robot.dashboard.dashboard import Dashboard, ReplayFile
from neurosym_robot.dashboard.foxglove_view import FoxgloveView
from neurosym_robot.dashboard.moments import read_floor_map
from neurosym_robot.online.predictor import Predictor, load_models
from neurosym_robot.online.window import Window
from neurosym_robot.ros.bags import BagWriter, read_frames
from neurosym_robot.ros.definitions import typestore
from neurosym_robot.ros.messages import make_people
from neurosym_robot.ros.tcpros import Node
from neurosym_robot.tracking.following import Frame, tracks_of_frames
from neurosym_robot.tracking.stitching import LinkOptions
from tests.robot.dashboard.conftest import predictor

pytest.importorskip("rosbags", reason="rosbags is not installed")

SGAN = Path("sgan_zara1_8")
NAMES = ("", "a b", "/a//b", "1a", "a\n")
URIS = ("localhost:11311", "https://localhost:11311", "http://localhost", "http://a:b")
ONE = np.zeros((1, 2))
MOMENTS: Any = SimpleNamespace(introduction="")
LINKS = LinkOptions(reach=0.7)
MAP = "image: room.pgm\nresolution: 0.05\norigin: [-1.0, 2.5, 0.1]\n"
MAPS = {
    **dict.fromkeys(("", "image: [", "- a"), "not a map"),
    MAP.replace("0.05", "0"): "positive",
    MAP.replace("0.05", "wide"): "not a map",
    MAP.replace(", 0.1]", "]"): "not a map",
    MAP.replace("room.pgm", "none.pgm"): "none.pgm",
    MAP.replace("room.pgm", "tracks.txt"): "cannot identify image",
    MAP.replace("room.pgm", "short.pgm"): "not a map",
    MAP.replace("room.pgm", "large.pgm"): "8193 x 8192 cells are more than",
    MAP.replace("room.pgm", "bomb.pgm"): "not a map",
}


@pytest.fixture
def folder(tmp_path):
    """Tracks, a damaged file of tracks, pictures, and a bag of people and of text."""
    (tmp_path / "tracks.txt").write_text("0 1 0 0\n")
    (tmp_path / "odd.txt").write_text("0 1 0 0\n10 1 x 0\n")
    sizes = {
        "room": b"3 2",
        "short": b"9 9",
        "large": b"8193 8192",
        "bomb": b"1000000 1000000",
    }
    for name, size in sizes.items():
        (tmp_path / f"{name}.pgm").write_bytes(b"P5\n%b\n255\n" % size + bytes(6))
    (tmp_path / "page.html").touch()
    for name, topic in (("run", "/people"), ("text", "/more")):
        with BagWriter(tmp_path / f"{name}.bag") as bag:
            bag.write("/chatter", 1.0, bag.new("std_msgs/msg/String"))
            if name == "run":
                bag.write(
                    topic, 1.0, make_people(bag.new, Frame(2.0, np.ones(1, int), ONE))
                )
    return tmp_path


def read(path: Path, format: str | None = None) -> list[Frame]:
    return list(read_frames(path, ReadOptions(format=format)))


def run(folder: Path, **options: Any) -> None:
    replay.run(
        replay.Options(
            **{"recording": (folder / "run.bag",), "model": (SGAN,), **options}
        )
    )


def show(folder: Path, **options: Any) -> None:
    run(folder, recording=(folder / "tracks.txt",), html=folder / "new.html", **options)


def write(folder: Path, stamp: float) -> None:
    with BagWriter(folder / "new" / "again.bag") as bag:
        bag.write(
            "/people", stamp, make_people(bag.new, Frame(stamp, np.ones(1, int), ONE))
        )


def twice() -> None:
    """Two pages at one port."""
    with contextlib.closing(Dashboard(MOMENTS, port=0)) as dashboard:
        Dashboard(MOMENTS, port=int(dashboard.where.rstrip("/").rpartition(":")[2]))


def look(folder: Path, text: str) -> None:
    (folder / "room.yaml").write_text(text)
    read_floor_map(folder / "room.yaml")


CASES = [
    (
        lambda at: read(at / "run.bag", "bag,topic=/no"),
        "/no is not there.*: /chatter .*",
    ),
    (
        lambda at: read(at / "run.bag", "bag,topic=/chatter"),
        "/chatter is not of a type .* --people",
    ),
    (
        lambda at: read(at / "tracks.txt", "text,topic=/x"),
        "unknown field 'topic' for Text",
    ),
    (lambda at: read(at / "none.bag"), "no such file"),
    (lambda at: read(at / "odd.txt"), "row 2"),
    (lambda at: read(at), "not a bag"),
    (
        lambda at: read(at / "text.bag"),
        r"no topic is of a type .*: /\S+ \(std_msgs/msg/String\); --people",
    ),
    (lambda at: tracks_of_frames(iter([]), "again"), "nobody"),
    (lambda at: BagWriter(at / "tracks.txt"), r"ends in \.bag"),
    (lambda at: BagWriter(at / "tracks.txt" / "run.bag"), "cannot be written"),
    (lambda at: BagWriter(at / "run.bag"), "already there"),
    (lambda at: write(at, -1.0), "does not fit"),
    (
        lambda at: run(at, read=ReadOptions(format="bag,topic=/nobody")),
        "/nobody is not there",
    ),
    (lambda at: run(at, read=ReadOptions(unit="mm")), "unit is of no use for a bag"),
    (
        lambda at: run(at, read=ReadOptions(format="text")),
        "is a bag, not format='text'",
    ),
    (
        lambda at: read(at / "run.bag", "bag,fixed_frame=map"),
        "of a stream is fixed_frame='map'",
    ),
    (lambda at: run(at, recording=(at / "odd.txt",)), "row 2"),
    (lambda at: run(at, recording=(at / "none.bag",)), "no such file"),
    (lambda at: run(at, out=at / "run.bag"), "already there"),
    (lambda at: run(at, out=at / "forecasts.csv"), r"ends in \.bag"),
    (lambda at: run(at, rate=0.0), "rate must be positive"),
    (lambda at: run(at, rate=math.nan), "rate must be positive"),
    (lambda at: run(at, at_least=2.0), r"a probability in \(0, 1\], not 2"),
    (lambda at: run(at, links=LINKS), "--links: has no effect without --stitch"),
    (
        lambda at: run(at, reach=3),
        "--reach: has no effect without --fixed-frame or --robot-frame",
    ),
    (lambda at: run(at, port=9, html=at), "--port: has no effect without --dashboard"),
    (
        lambda at: run(at, host="all", html=at),
        "--host: .* without --dashboard or --foxglove",
    ),
    (
        lambda at: run(at, host="all", foxglove=at / "a.mcap"),
        "--host: .* on a file for Foxglove",
    ),
    (
        lambda at: run(at, map=at, out=at),
        "--map: has no effect without --dashboard or --html",
    ),
    (
        lambda at: run(at, at_least=0.7),
        "--at-least: has no effect without --out or --html or",
    ),
    (
        lambda at: show(at, fixed_frame="map"),
        "--fixed-frame: has no effect on a file of tracks",
    ),
    (
        lambda at: show(at, robot_frame="base"),
        "--robot-frame: has no effect on a file of tracks",
    ),
    (
        lambda at: show(at, fixed_frame="map", out=at, reach=3),
        "--reach: has no effect on a file",
    ),
    (lambda at: show(at, only="a=b"), "--only: has no effect on a file of tracks"),
    (lambda at: ReplayFile(at / "page.html", None), "already there"),
    (lambda at: ReplayFile(at / "a.txt", None), r"\.html"),
    (lambda at: ReplayFile(at / "tracks.txt" / "b.html", MOMENTS), "cannot be written"),
    (lambda at: FoxgloveView(predictor(), at / "a.txt"), r"\.mcap"),
    *((lambda at, text=text: look(at, text), reason) for text, reason in MAPS.items()),
    (lambda at: load_models(()), "at least one"),
    (lambda at: load_models((SGAN, SGAN)), "differ in name"),
    (lambda at: Predictor({}), "steps"),
    (lambda at: Predictor(load_models((SGAN,)), samples=0), "samples"),
    (
        lambda at: Predictor(load_models((SGAN,)), samples=10**9),
        r"1000000000 samples needs .* GB",
    ),
    (lambda at: Predictor(load_models((SGAN,)), seed=-1), "seed"),
    (lambda at: Window(2, 0.0), "period"),
    (lambda at: Window(2, 0.4, timeout=0.5), "timeout"),
    (lambda at: Window(2, 0.4, hold=20.0), "hold"),
    (lambda at: Window(2, 0.4).push(0.0, [1], [[1, 2, 3]]), "xy"),
    (lambda at: Window(2, 0.4).push(0.0, ["a"], [[1, 2]]), "whole"),
    *((lambda at, n=n: Node(n, "http://localhost:1"), "not a ROS name") for n in NAMES),
    *((lambda at, uri=uri: Node("node", uri), "master's URI") for uri in URIS),
    (lambda at: Dashboard(MOMENTS, "no.such.host.invalid", 0), "cannot serve at"),
    (lambda at: Dashboard(MOMENTS, "", 70_000), "cannot serve at"),
    (lambda at: twice(), "cannot serve at"),
]


@pytest.mark.parametrize(("use", "reason"), CASES)
def test_a_line(folder, use, reason):
    with pytest.raises(InputError, match=reason) as error:
        use(folder)
    assert "\n" not in str(error.value)


def test_a_missing_library_is_named_with_its_remedy(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("rosbags.")]:
        monkeypatch.delitem(sys.modules, name)
    for library in ("rosbags", "rclpy", "foxglove"):
        monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(InputError, match=r"pip install 'neurosym-jax\[robot\]'"):
        typestore(1)
    with pytest.raises(InputError, match="this needs rclpy"):
        ros2.run(ros2.Options(model=(Path("none"),)))
    with pytest.raises(InputError, match=r"pip install 'neurosym-jax\[foxglove\]'"):
        FoxgloveView(predictor(), 0)
