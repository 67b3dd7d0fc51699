"""Age of information: from a frame's stamp to its forecast at a listener, another process.

People walk in a hall, and all of them are forecast: 8 at 10 Hz with 20 ms of jitter, 8
at 7 Hz, and 200 at 30 Hz; without the page, and with it open in a headless Chromium on
the same cores, whose drawings are counted, too. ROS 1 is a real roscore, and samples
are heard. ROS 2 is a real rclpy, in the Python that `$NEUROSYM_ROS2` names or else in
this one; markers are heard, whose type every ROS 2 has. Nobody but its page hears a
replay: a bag is played at its own rate, and the ages are those that the command prints,
from the moment when a frame is due to its forecast.
"""

import contextlib
import itertools
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.timing import OURS, row
from neurosym_robot.tracking.following import Frame

ROOT = Path(__file__).resolve().parents[1]
WARM = 4.0
"""Seconds of a case before it counts."""
COUNT = """() => {
  window.drawn = [];
  const draw = CanvasRenderingContext2D.prototype.drawImage;
  CanvasRenderingContext2D.prototype.drawImage = function (...all) {
    if (this.canvas.id === "scene") window.drawn.push(Date.now() / 1000);
    return draw.apply(this, all);
  };
}"""
"""The page copies its background to the canvas once whenever it draws."""

ABSENT = 3
"""Exit status of a process whose software is not there."""

Hear = Callable[[int, int], None]
"""Takes the stamp of a forecast, seconds and nanoseconds."""
Publish = Callable[[Frame], object]


class Case(NamedTuple):
    """A crowd and its tracker."""

    people: int
    rate: float  # Hz
    jitter: float  # standard deviation of the stamps, seconds
    name: str
    seconds: float = 12.0
    """While it counts."""

    def frames(self) -> Iterator[Frame]:
        """Everybody from 0 s on."""
        rng, side = np.random.default_rng(0), 2.0 * self.people**0.5
        start = rng.uniform(0, side, (self.people, 2))
        speed = rng.normal(0, 0.8, (self.people, 2))
        for now in np.arange(0, WARM + self.seconds, 1 / self.rate):
            xy = side - np.abs((start + speed * now) % (2 * side) - side)
            stamp = max(0.0, now + self.jitter * rng.normal())
            yield Frame(stamp, np.arange(self.people), xy)


CASES = (
    Case(8, 10.0, 0.02, "10 Hz with 20 ms jitter, 8 people"),
    Case(8, 7.0, 0.0, "7 Hz, 8 people"),
    Case(200, 30.0, 0.0, "30 Hz, 200 people"),
)


def measure(options: Any) -> dict[str, Any]:
    """See the module; each kind in a process of its own, in the Python that can run it."""
    title, table = "age of a forecast at a listener", []
    for kind in KINDS:
        python = (
            os.environ.get("NEUROSYM_ROS2", sys.executable)
            if kind == "ROS 2"
            else sys.executable
        )
        paths = (
            str(ROOT),
            sysconfig.get_paths()["purelib"],
            os.environ.get("PYTHONPATH", ""),
        )
        done = subprocess.run(
            [python, "-m", "benchmarks.age", kind, options.age_model],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
            stdout=subprocess.PIPE,
            text=True,
        )
        table += map(json.loads, done.stdout.splitlines())
        if done.returncode == ABSENT:
            title += f"; {kind} cannot be run here"
        elif done.returncode:
            raise RuntimeError(f"{kind}: ended with status {done.returncode}")
    return {"title": title, "rows": table}


def live(
    join: Callable[[contextlib.ExitStack, Hear], Publish],
    command: list[str],
    kind: str,
    cases: Sequence[Case] = CASES,
) -> None:
    """All cases in a graph, one after the other; this process is the tracker and the planner."""
    heard: list[tuple[float, float]] = []

    def hear(sec: int, nanosec: int) -> None:
        heard.append((time.time(), sec + 1e-9 * nanosec))

    with contextlib.ExitStack() as graph:
        publish = join(graph, hear)
        for is_open in (False, True):
            with contextlib.ExitStack() as stack:
                node = _Process(stack, [*command, "--topic", "/people"], is_open)
                node.line("everything is compiled")
                for case in cases:
                    began, stamps = time.monotonic(), []
                    for moment, ids, xy in case.frames():
                        time.sleep(max(0.0, began + moment - time.monotonic()))
                        stamps.append(time.time())
                        publish(Frame(stamps[-1], ids, xy))
                    time.sleep(1.0)
                    since = stamps[-1] - case.seconds
                    ages = [at - stamp for at, stamp in heard if stamp > since]
                    share = len(ages) / sum(stamp > since for stamp in stamps)
                    drawn = node.drawn(since, stamps[-1])
                    _tell(kind, case, ages, drawn, answered=share)


def ros1(stack: contextlib.ExitStack, hear: Hear) -> Publish:
    """Join a new graph of ROS 1."""
    from neurosym_robot.ros.definitions import (
        FORECAST,
        FORECAST_TOPIC,
        PEOPLE,
        blank,
        ros1_name,
        typestore,
    )
    from neurosym_robot.ros.messages import make_people
    from neurosym_robot.ros.tcpros import Node, Topic

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{port}", ROS_IP="127.0.0.1")
    _Process(stack, ["roscore", "-p", port])
    store, node = typestore(1), Node("tracker", None, lambda text: None)
    stack.callback(node.close)

    def topic(name: str, kind: str) -> Topic:
        definition, md5 = store.generate_msgdef(kind, ros_version=1)
        return Topic(name, ros1_name(kind), md5, definition)

    samples = topic(f"{FORECAST_TOPIC}/samples", FORECAST)
    node.subscribe(
        samples, lambda data, header: hear(*struct.unpack_from("<II", data, 4))
    )
    publisher = node.advertise(topic("/people", PEOPLE))

    def publish(frame: Frame) -> None:
        message = make_people(lambda kind: blank(store, kind), frame)
        publisher.publish(bytes(store.serialize_ros1(message, PEOPLE)))

    return publish


def ros2(stack: contextlib.ExitStack, hear: Hear) -> Publish:
    """Join a graph of ROS 2 on this computer, with a number of its own."""
    import rclpy  # pyright: ignore
    from geometry_msgs.msg import Point, Pose, PoseArray  # pyright: ignore
    from rclpy.executors import ExternalShutdownException  # pyright: ignore
    from visualization_msgs.msg import MarkerArray  # pyright: ignore

    from neurosym_robot.ros.definitions import FORECAST_TOPIC

    own = str(1 + os.getpid() % 100)
    os.environ.update(ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", ROS_DOMAIN_ID=own)
    rclpy.init()
    node = rclpy.create_node("tracker")

    def markers(data: bytes) -> None:
        hear(*struct.unpack_from("<II", data, 8))  # the header of the first

    topic = f"{FORECAST_TOPIC}/markers"
    node.create_subscription(MarkerArray, topic, markers, 10, raw=True)
    publisher = node.create_publisher(PoseArray, "/people", 10)

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException):
            rclpy.spin(node)

    listening = threading.Thread(target=spin)
    listening.start()
    stack.callback(listening.join)
    stack.callback(rclpy.try_shutdown)

    def publish(frame: Frame) -> None:
        poses = [Pose(position=Point(x=x, y=y)) for x, y in frame.xy.tolist()]
        message = PoseArray(poses=poses)
        message.header.frame_id, stamp = "map", divmod(round(1e9 * frame.stamp), 10**9)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp
        publisher.publish(message)

    return publish


def replay(model: str, kind: str) -> None:
    """All cases, each from a bag of its own."""
    from neurosym_robot.ros.bags import BagWriter
    from neurosym_robot.ros.messages import make_people

    for is_open, case in itertools.product((False, True), CASES):
        with contextlib.ExitStack() as stack:
            bag = (
                Path(stack.enter_context(tempfile.TemporaryDirectory())) / "people.bag"
            )
            with BagWriter(bag) as writer:
                for frame in case.frames():
                    writer.write("/people", frame.stamp, make_people(writer.new, frame))
            command = _ours("replay", str(bag), "--rate", "1", "--model", model)
            process = _Process(stack, command, is_open)
            printed = re.findall(
                r"p\d+ ([\d.]+) ms", process.line("age of information")
            )
            ages = [1e-3 * float(age) for age in printed]
            now = time.time()
            _tell(kind, case, ages, process.drawn(now - case.seconds, now))


KINDS: dict[str, Callable[[str, str], None]] = {
    "ROS 1": lambda model, kind: live(ros1, _ours("ros1", "--model", model), kind),
    "ROS 2": lambda model, kind: live(
        ros2, _ours("ros2", "--message", "PoseArray", "--model", model), kind
    ),
    "replay": replay,
}


def _tell(
    kind: str, case: Case, ages: list[float], drawn: float | None, **columns: Any
) -> None:
    """Print the row of a case; of a replay, `ages` are the median and the 99th percentile."""
    name = f"{kind}, {case.name}{'' if drawn is None else ', page open'}"
    if not ages:
        raise RuntimeError(f"{name}: no forecast was heard")
    print(name, file=sys.stderr, flush=True)
    columns |= {} if drawn is None else {"drawn": drawn}
    entry = row(name, OURS, ages, **columns, p99=float(np.percentile(ages, 99)))
    if kind == "replay":
        entry |= {"median": ages[0], "p99": ages[1]}
    print(json.dumps(entry), flush=True)


def _ours(*words: str) -> list[str]:
    """A command of ours that forecasts everybody of all cases."""
    most = max(case.people for case in CASES)
    every = ["--max-people", str(most)]
    return [sys.executable, "-m", "neurosym_jax", *words, *every]


class _Process:
    """A process that ends with its stack, what it prints, and the page that shows it."""

    def __init__(
        self, stack: contextlib.ExitStack, command: list[str], is_open: bool = False
    ):
        """Start `command`, and open its page."""
        page = ["--dashboard", "--port", "0"] if is_open else []
        into = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        self._process: Any = subprocess.Popen([*command, *page], **into)
        stack.callback(self._process.wait)
        stack.callback(self._process.send_signal, signal.SIGINT)
        self._lines: list[str] = []
        threading.Thread(target=self._read, daemon=True).start()
        self._page = self._browse(stack) if is_open else None

    def _read(self) -> None:
        for line in self._process.stdout:
            self._lines.append(line)

    def line(self, text: str) -> str:
        """Wait for a line with this text."""
        while self._process.poll() is None:
            for line in self._lines:
                if text in line:
                    return line
            time.sleep(0.05)
        raise RuntimeError(f"it ended without {text!r}: {''.join(self._lines)}")

    def _browse(self, stack: contextlib.ExitStack) -> Any:
        from playwright.sync_api import sync_playwright

        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        browser = stack.enter_context(sync_playwright()).chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(self.line("page is at").split()[-1])
        page.evaluate(COUNT)
        return page

    def drawn(self, start: float, end: float) -> float | None:
        """Drawings a second of the page from `start` to `end`; None if it is not open."""
        if self._page is None:
            return None
        times = np.array(self._page.evaluate("drawn"))
        count = ((times > start) & (times <= end)).sum()
        return float(count / (end - start))


if __name__ == "__main__":
    kind, model = sys.argv[1:]
    try:
        KINDS[kind](model, kind)
    except (ImportError, FileNotFoundError) as error:
        print(f"{kind}: {error}", file=sys.stderr)
        sys.exit(ABSENT)
