"""A master in this process, for tests of the client that need no ROS."""

import contextlib
import functools
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from neurosym_robot.ros.tcpros import Node, Topic
from neurosym_robot.ros.tcpros.wire import CallError, Refused, SlaveServer, call

CHATTER = Topic(
    "/chatter", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", "string data"
)


class Master:
    """What clients need of https://wiki.ros.org/ROS/Master_API."""

    def __init__(self):
        self.telling = threading.Lock()
        self.nodes: dict[str, str] = {}
        self.publishers, self.subscribers = ends = defaultdict(list), defaultdict(list)
        methods: dict[str, Callable] = {"lookupNode": self.lookup}
        for kind, end in zip(("Publisher", "Subscriber"), ends):
            methods[f"register{kind}"] = functools.partial(
                self.change, end, list.append
            )
            methods[f"unregister{kind}"] = functools.partial(
                self.change, end, list.remove
            )
        self.server = SlaveServer("127.0.0.1", methods)
        self.uri = f"http://127.0.0.1:{self.server.server_address[1]}"

    def change(self, ends, call, caller, topic, *kind_and_uri):
        """Register or unregister; tell the subscribers."""
        self.nodes[caller] = uri = kind_and_uri[-1]
        if (uri in ends[topic]) == (call is list.remove):
            call(ends[topic], uri)
        if ends is self.publishers:
            threading.Thread(target=self.tell, args=(topic,)).start()
        return self.publishers[topic]

    def lookup(self, caller, name):
        if name not in self.nodes:
            raise Refused("unknown node")
        return self.nodes[name]

    def tell(self, topic):
        with self.telling:
            for uri in list(self.subscribers[topic]):
                with contextlib.suppress(CallError):
                    call(
                        uri,
                        "publisherUpdate",
                        "/master",
                        topic,
                        list(self.publishers[topic]),
                    )


def wait(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Until the condition holds, so many seconds at most."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)


@pytest.fixture
def master():
    master = Master()
    yield master
    master.server.close()


@pytest.fixture
def graph(master):
    """`graph(name)` is a node that keeps what it reported in `said`; all are closed at the end."""
    with contextlib.ExitStack() as stack:

        def make(name: str) -> Node:
            notices: list[str] = []
            node = Node(name, master.uri, notices.append)
            node.said = notices
            stack.callback(node.close)
            return node

        yield make


@pytest.fixture
def pair(graph):
    """A talker and a listener that are connected, their ends of a topic, and what is heard."""
    heard: list[bytes] = []
    listener, talker = graph("listener"), graph("talker")
    subscriber = listener.subscribe(CHATTER, lambda data, header: heard.append(data))
    publisher = talker.advertise(CHATTER, queue_size=100)
    wait(lambda: publisher.subscribers == ["/listener"] and subscriber.publishers)
    return SimpleNamespace(
        heard=heard,
        listener=listener,
        talker=talker,
        subscriber=subscriber,
        publisher=publisher,
    )


@pytest.fixture(autouse=True)
def loopback(monkeypatch):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    monkeypatch.delenv("ROS_HOSTNAME", raising=False)
