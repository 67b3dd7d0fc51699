"""A master in this process, for tests of the client that need no ROS."""

import contextlib
import functools
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from neurosym_robot.ros.tcpros import Node, Topic
from neurosym_robot.ros.tcpros.wire import CallError, Refused, SlaveServer, call

CHATTER = Topic("/chatter", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data")


class Master:
    """What clients need of https://wiki.ros.org/ROS/Master_API."""

    def __init__(self):
        self.telling = threading.Lock()
        self.nodes: dict[str, str] = {}
        self.publishers: dict[str, list[str]] = defaultdict(list)
        self.subscribers: dict[str, list[str]] = defaultdict(list)
        methods: dict[str, Callable[..., Any]] = {"lookupNode": self.lookup}
        for kind, ends in (("Publisher", self.publishers), ("Subscriber", self.subscribers)):
            methods[f"register{kind}"] = functools.partial(self.register, ends)
            methods[f"unregister{kind}"] = functools.partial(self.unregister, ends)
        self.server = SlaveServer("127.0.0.1", methods)
        self.uri = f"http://127.0.0.1:{self.server.server_address[1]}"

    def forget(self) -> None:
        """As a restarted master."""
        for table in (self.nodes, self.publishers, self.subscribers):
            table.clear()

    def register(self, ends, caller, topic, type, uri):
        self.nodes[caller] = uri
        if uri not in ends[topic]:
            ends[topic].append(uri)
        if ends is self.subscribers:
            return self.publishers[topic]
        self.tell(topic)
        return self.subscribers[topic]

    def unregister(self, ends, caller, topic, uri):
        ends[topic].remove(uri)
        self.tell(topic)
        return 1

    def lookup(self, caller, name):
        if name not in self.nodes:
            raise Refused("unknown node")
        return self.nodes[name]

    def tell(self, topic):
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
def pair(graph, wait):
    """A talker and a listener that are connected, their ends of a topic, and what is heard."""
    heard: list[bytes] = []
    listener, talker = graph("listener"), graph("talker")
    subscriber = listener.subscribe(CHATTER, lambda data, header: heard.append(data))
    publisher = talker.advertise(CHATTER, queue_size=100)
    wait(lambda: publisher.subscribers == ["/listener"] and subscriber.publishers)
    return SimpleNamespace(
        heard=heard, listener=listener, talker=talker, subscriber=subscriber, publisher=publisher
    )


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
