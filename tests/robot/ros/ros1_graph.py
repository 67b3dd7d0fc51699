"""A real ROS 1 graph around our node: roscore, rospy and rosbag as Debian packages them."""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest

from neurosym_robot.ros.definitions import (
    GRID,
    HUMANS_TRAJS,
    MARKERS,
    PEOPLE,
    typestore,
)
from neurosym_robot.ros.tcpros.wire import CallError, call
from tests.repository import ROOT
from tests.robot.ros.tcpros.conftest import wait

OURS = {
    name: os.environ[name]
    for name in os.environ
    if name.startswith(("XDG", "JAX", "XLA"))
}
OURS["PYTHONPATH"] = str(ROOT)
PEER = Path(__file__).with_name("rospy_peer.py")
SYSTEM = "/usr/bin/python3"
PACKAGES = "python3-rospy python3-roslaunch python3-rosbag"


class Process:
    """A process that ends with the test; what it prints is kept line by line."""

    def __init__(self, log: Path, *command, env):
        self._log = log
        with log.open("w") as output:
            self.process = subprocess.Popen(
                [str(part) for part in command],
                env=env,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    @property
    def lines(self) -> list[str]:
        return self._log.read_text().splitlines()

    def wait_for(self, condition) -> None:
        """Until a line, from now on or before, fulfils `condition`."""
        self.wait(lambda: any(map(condition, self.lines)))

    def wait(self, condition) -> None:
        """Until `condition` holds, two minutes at most."""

        def holds() -> bool:
            with contextlib.suppress(CallError):
                return bool(condition()) or self.process.poll() is not None
            return False

        wait(holds, 120)
        assert condition(), self.lines

    def wait_heard(self, condition) -> list[dict]:
        """The rows that a listener has printed, once `condition` holds for them."""

        def heard() -> list[dict]:
            return [
                json.loads(line)
                for line in self.lines
                if line[:2] == '{"' and line[-1] == "}"
            ]

        self.wait(lambda: condition(heard()))
        return heard()

    def end(self, number=signal.SIGKILL) -> int:
        """Send a signal to the process and its children, wait, return the exit status."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, number)
        return self.process.wait(90)  # The compiler is waited for.


class Graph:
    """A master on a port of its own, and processes around it."""

    def __init__(self, folder: Path):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.uri, self._folder = f"http://127.0.0.1:{self.port}", folder
        self.env = {
            "PATH": os.environ["PATH"],
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "HOME": str(folder),
        }
        self._processes = contextlib.ExitStack()
        store = typestore(1)
        texts = {
            name.replace("/msg/", "/"): store.generate_msgdef(name, ros_version=1)[0]
            for name in (PEOPLE, HUMANS_TRAJS, MARKERS, GRID)
        }
        (folder / "definitions.json").write_text(json.dumps(texts))
        self.start_core()

    def start_core(self):
        """A new master on the same port."""
        self.core = self.start("roscore", "-p", self.port)
        # The log's node is the last thing that roscore starts.
        self.core.wait(lambda: call(self.uri, "lookupNode", "/tests", "/rosout"))

    def start(self, *command, **options) -> Process:
        """A process in this graph."""
        log = self._folder / f"{time.monotonic_ns()}.txt"
        process = Process(log, *command, env={**self.env, **options})
        self._processes.callback(process.end)
        return process

    def talker(self, rate: float = 50, topic: str = "/people") -> Process:
        """A rospy node that publishes people."""
        definitions = self._folder / "definitions.json"
        return self.start(SYSTEM, PEER, "talk", "tracker", definitions, rate, topic)

    def hearer(self, *topics: str) -> Process:
        """A rospy node that says on which topics, each TOPIC=TYPE, messages came."""
        name = f"hearer{time.monotonic_ns()}"
        definitions = self._folder / "definitions.json"
        return self.start(SYSTEM, PEER, "hear", name, definitions, 0, *topics)

    def listener(self) -> Process:
        """A rospy node that hears our topics."""
        name = f"listener{time.monotonic_ns()}"
        listener = self.start(
            SYSTEM, PEER, "listen", name, self._folder / "definitions.json"
        )
        listener.wait_for(lambda line: "ready" in line)
        return listener

    def close(self):
        """End all."""
        # First, and gently: roscore's children are in process groups of their own.
        self.core.end(signal.SIGINT)
        self._processes.close()


def start_graph(folder: Path) -> Graph:
    """A new graph; skips the test where there is no ROS 1."""
    usable = shutil.which("roscore") and Path(SYSTEM).exists()
    probe = [SYSTEM, "-c", "import rospy"]
    if not usable or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip(
            f"no ROS 1 here: apt-get install --no-install-recommends {PACKAGES}"
        )
    return Graph(folder)
