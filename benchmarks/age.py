"""Age of information: from a frame's stamp to its forecast at another process of a ROS 1 graph.

A real roscore, our node with the model `--age-model`, and this process as tracker and planner:
people who walk in a hall, at 10 Hz with 20 ms of jitter, at 7 Hz, and 200 people at 30 Hz; without
and with the page open in a headless Chromium on the same cores.
"""

import contextlib
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import OURS

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 20.0  # measured
CASES = {  # people, Hz, standard deviation of the stamps [s]
    "10 Hz, 20 ms jitter, 8 people": (8, 10.0, 0.02),
    "7 Hz, 8 people": (8, 7.0, 0.0),
    "30 Hz, 200 people": (200, 30.0, 0.0),
}
TITLE = "age of a forecast at a listener"
FORECASTS = "/hri/human_poses_prediction"


def measure(options: Any) -> dict[str, Any]:
    """See the module."""
    if shutil.which("roscore") is None:
        return {"title": f"{TITLE}: not measured, there is no roscore here", "rows": []}
    table = []
    for case, (people, rate, jitter) in CASES.items():
        for browser in (False, True):
            ages, share = one(options.age_model, people, rate, jitter, browser)
            p50, p99 = np.percentile(ages, [50, 99])
            name = f"{case}{', page open' if browser else ''}: {share:.0%} of frames answered"
            row = {"case": name, "who": OURS, "unit": "s", "median": float(p50), "p99": float(p99)}
            row |= {"low": float(ages.min()), "high": float(ages.max()), "repeats": len(ages)}
            table.append(row)
            print(f"{name}: p50 {1e3 * p50:.0f} ms, p99 {1e3 * p99:.0f} ms", flush=True)
    return {"title": TITLE, "rows": table}


def one(
    model: str, people: int, rate: float, jitter: float, browser: bool
) -> tuple[np.ndarray, float]:
    """Ages [s] of the forecasts heard, and the share of frames that have one."""
    with contextlib.ExitStack() as stack:
        graph = _Graph(stack)
        command = ["-m", "neurosym_jax", "ros1", "--topic", "/people", "--model", model]
        command += ["--dashboard", "--port", str(graph.page)] if browser else []
        graph.node = graph.start([sys.executable, *command])
        ages, sent = graph.exchange(people, rate, jitter, browser)
    return ages, len(ages) / sent


class _Process(subprocess.Popen):
    """A process; `warm` once it says that everything is compiled."""

    def __init__(self, command: list[str], env: dict[str, str]):
        output = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        super().__init__(command, env=env, text=True, **output)  # pyright: ignore
        self.warm = False
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        for line in self.stderr or ():
            self.warm = self.warm or "everything is compiled" in line


class _Graph:
    """A master, and processes that end with it."""

    def __init__(self, stack: contextlib.ExitStack):
        self._stack = stack
        self.port, self.page = _free_port(), _free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        folder = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        self._env = {"ROS_MASTER_URI": self.uri, "ROS_IP": "127.0.0.1", "ROS_HOME": folder}
        os.environ["ROS_IP"] = "127.0.0.1"
        self.start(["roscore", "-p", str(self.port)])

    def start(self, command: list[str]) -> "_Process":
        """Start a process."""
        process = _Process(command, {**os.environ, **self._env, "PYTHONPATH": str(ROOT)})
        self._stack.callback(process.wait)
        self._stack.callback(process.send_signal, signal.SIGINT)
        return process

    def exchange(
        self, people: int, rate: float, jitter: float, browser: bool
    ) -> tuple[np.ndarray, int]:
        """Ages of the forecasts of `SECONDS`, and the number of frames sent."""
        from neurosym_robot.ros.definitions import FORECAST, PEOPLE, blank, ros1_name, typestore
        from neurosym_robot.ros.messages import make_people
        from neurosym_robot.ros.tcpros import Node, Topic
        from neurosym_robot.tracking.following import Frame

        store = typestore(1)

        def topic(name: str, kind: str) -> Topic:
            definition, md5 = store.generate_msgdef(kind, ros_version=1)
            return Topic(name, ros1_name(kind), md5, definition)

        node = Node("tracker", self.uri, lambda text: None)
        self._stack.callback(node.close)
        heard: list[tuple[float, float]] = []

        def hear(data: bytes, header: Any) -> None:
            sec, nanosec = struct.unpack_from("<II", data, 4)
            heard.append((time.time(), sec + 1e-9 * nanosec))

        for end in ("neurosym", "baseline", "anchors", "recommended"):
            node.subscribe(topic(f"{FORECASTS}_{end}/samples", FORECAST), hear)
        publisher = node.advertise(topic("/people", PEOPLE))
        rng = np.random.default_rng(0)
        side = 2.0 * people**0.5
        start, speed = rng.uniform(0, side, (people, 2)), rng.normal(0, 0.8, (people, 2))
        ids, stamps, number = np.arange(people), [], 0
        began, begin = time.monotonic(), None
        while begin is None or time.monotonic() < begin + SECONDS:
            due = began + number / rate
            time.sleep(max(0.0, due + jitter * rng.normal() - time.monotonic()))
            now, way = time.time(), start + speed * number / rate
            xy = side - np.abs(way % (2 * side) - side)
            stamps.append(now)
            message = make_people(lambda kind: blank(store, kind), Frame(now, ids, xy), "map")
            publisher.publish(bytes(store.serialize_ros1(message, PEOPLE)))
            number += 1
            if begin is None and heard and self.node.warm:
                begin = time.monotonic()
                if browser:
                    self._browse()
        time.sleep(1.0)
        since = stamps[-1] - SECONDS
        ages = [at - stamp for at, stamp in heard if stamp > since]
        return np.array(ages), sum(stamp > since for stamp in stamps)

    def _browse(self) -> None:
        chromium = shutil.which("chromium") or shutil.which("google-chrome") or "chromium"
        quiet = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0"]
        folder = self._stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        quiet += [f"--user-data-dir={folder}", "--window-size=1400,900"]
        self.start([chromium, *quiet, f"http://127.0.0.1:{self.page}/"])


def _free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


if __name__ == "__main__":
    import types

    measure(types.SimpleNamespace(age_model=sys.argv[1]))
