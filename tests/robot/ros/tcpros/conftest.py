"""A master in this process, for tests of the client that need no ROS."""

import contextlib
import threading
import time
from collections import defaultdict
from collections.abc import Callable

import pytest

from neurosym_robot.ros.tcpros import Node
from neurosym_robot.ros.tcpros.wire import CallError, Refused, SlaveServer, call


class Master:
    """What clients need of https://wiki.ros.org/ROS/Master_API; `port` 0 is any free one."""

    def __init__(self):
        self.telling = threading.Lock()
        self.nodes: dict[str, str] = {}
        self.publishers: dict[str, list[str]] = defaultdict(list)
        self.subscribers: dict[str, list[str]] = defaultdict(list)
        methods = ("registerPublisher", "registerSubscriber", "lookupNode")
        methods += ("unregisterPublisher", "unregisterSubscriber")
        self.server = SlaveServer("127.0.0.1", {name: getattr(self, name) for name in methods})
        self.uri = f"http://127.0.0.1:{self.server.server_address[1]}"

    def forget(self) -> None:
        """As a restarted master."""
        for table in (self.nodes, self.publishers, self.subscribers):
            table.clear()

    def registerPublisher(self, caller, topic, type, uri):
        self._register(self.publishers[topic], caller, uri)
        self._tell(topic)
        return self.subscribers[topic]

    def registerSubscriber(self, caller, topic, type, uri):
        self._register(self.subscribers[topic], caller, uri)
        return self.publishers[topic]

    def _register(self, uris, caller, uri):
        self.nodes[caller] = uri
        if uri not in uris:
            uris.append(uri)

    def unregisterPublisher(self, caller, topic, uri):
        self.publishers[topic].remove(uri)
        self._tell(topic)
        return 1

    def unregisterSubscriber(self, caller, topic, uri):
        self.subscribers[topic].remove(uri)
        return 1

    def lookupNode(self, caller, name):
        if name not in self.nodes:
            raise Refused("unknown node")
        return self.nodes[name]

    def _tell(self, topic):
        def tell():
            with self.telling:
                publishers = list(self.publishers[topic])
                for uri in list(self.subscribers[topic]):
                    with contextlib.suppress(CallError):
                        call(uri, "publisherUpdate", "/master", topic, publishers)

        threading.Thread(target=tell).start()


@pytest.fixture
def master():
    there = Master()
    yield there
    there.server.close()


@pytest.fixture
def graph(master):
    """`graph(name)` is a node that keeps what it reported in `said`; all are closed at the end."""
    nodes = []

    def make(name: str) -> Node:
        said: list[str] = []
        node = Node(name, master.uri, said.append)
        node.said = said
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.close()


@pytest.fixture
def wait():
    """`wait(condition)` until it holds, half a minute at most."""

    def until(condition: Callable[[], object]) -> None:
        end = time.monotonic() + 30
        while not condition():
            assert time.monotonic() < end, "waited in vain"
            time.sleep(0.01)

    return until


@pytest.fixture(autouse=True)
def loopback(monkeypatch):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    monkeypatch.delenv("ROS_HOSTNAME", raising=False)
