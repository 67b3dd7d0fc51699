"""A node of a ROS 1 graph: known to the master, found by others, until it is closed."""

import contextlib
import os
import re
import socket
import threading
from collections.abc import Callable, Iterable
from typing import Any
from urllib.parse import urlsplit

from neurosym_jax.errors import InputError
from neurosym_robot.ros.tcpros.topics import Hear, Publisher, Refuse, Subscriber
from neurosym_robot.ros.tcpros.wire import (
    CallError,
    Refused,
    SlaveServer,
    Topic,
    call,
    shake_hands,
)
from neurosym_robot.server import ConnectionServer

WATCH = 1.0  # seconds between looks whether the master still knows the node


class Node:
    """Subscribes and publishes; survives restarts of the master and of other nodes.

    Threads serve in the background. A master that is not there yet is waited for.
    """

    def __init__(
        self,
        name: str,
        master: str | None = None,
        report: Callable[[str], None] = print,
        remaps: Iterable[str] = (),
    ):
        """Open the ports; InputError for an invalid name or URI.

        The master ends an older node of that `name`; `report` is called with one line
        about each event of a connection; `remaps` are "FROM:=TO" each.
        """
        self.name, self.master, self._report = (
            node_name(name),
            master_uri(master),
            report,
        )
        self.names = names_of(self.name, remaps)
        self.stopped = threading.Event()
        """Set when the graph asks the node to end; its owner then closes it."""
        self._subscribers: dict[str, Subscriber] = {}
        self._publishers: dict[str, Publisher] = {}
        host = local_host(self.master)
        # With a loopback address only this computer can reach us.
        bind = host if host == "localhost" or host.startswith("127.") else ""
        self._data = ConnectionServer(bind, self._accept)
        self._slave = SlaveServer(bind, self._methods())
        self._host, self._port = host, self._data.server_address[1]
        self.uri = f"http://{host}:{self._slave.server_address[1]}/"
        self._registered: set[Publisher | Subscriber] = set()
        self._wake, self._closing = threading.Event(), threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True, name="master")
        self._watcher.start()

    def subscribe(
        self, topic: Topic, hear: Hear, refuse: Refuse = lambda header: None
    ) -> Subscriber:
        """Subscribe `topic`."""
        subscriber = Subscriber(topic, self.name, self._report, hear, refuse)
        self._subscribers[topic.name] = subscriber
        self._wake.set()
        return subscriber

    def advertise(self, topic: Topic, queue_size: int = 10) -> Publisher:
        """Advertise `topic`; a full queue drops its oldest message."""
        publisher = Publisher(topic, self.name, self._report, queue_size)
        self._publishers[topic.name] = publisher
        self._wake.set()
        return publisher

    def close(self) -> None:
        """Unregister, end all connections and threads."""
        self._closing.set()
        self._wake.set()
        self._watcher.join()
        with contextlib.suppress(CallError):  # There may be no master to tell.
            for end in [*self._subscribers.values(), *self._publishers.values()]:
                about = self.name, end.topic.name, self.uri
                call(
                    self.master, f"unregister{type(end).__name__}", *about, timeout=1.0
                )
        for subscriber in self._subscribers.values():
            subscriber.close()
        self._data.close()
        self._slave.close()

    def _watch(self) -> None:
        """Register, and again whenever the master has forgotten the node."""
        missed = False
        while not self._closing.is_set():
            self._wake.clear()
            try:
                if self._registered:
                    self._look()
                self._register()
                if missed:
                    self._report(f"master at {self.master}: there again")
                missed = False
            except CallError as error:
                if not missed:
                    self._report(f"waiting for the master at {self.master}: {error}")
                missed = True
            self._wake.wait(WATCH)

    def _look(self) -> None:
        try:
            address = call(self.master, "lookupNode", self.name, self.name)
        except Refused:
            self._report(
                f"master at {self.master}: forgot this node, which registers again"
            )
            self._registered.clear()
        else:
            if address != self.uri:
                self._report(f"another node is {self.name} now, at {address}")
                self.stopped.set()

    def _register(self) -> None:
        ends = [*self._publishers.values(), *self._subscribers.values()]
        for end in [
            candidate for candidate in ends if candidate not in self._registered
        ]:
            about = self.name, end.topic.name, end.topic.type, self.uri
            answer = call(self.master, f"register{type(end).__name__}", *about)
            if isinstance(end, Subscriber):
                end.update(_uris(answer), all_of_them=False)
            self._registered.add(end)

    def _accept(self, connection: socket.socket) -> None:
        """Serve a connection to our TCPROS port."""
        header = shake_hands(connection)
        publisher = self._publishers.get(header.get("topic", ""))
        if publisher is not None:
            publisher.serve(connection, header)

    def _methods(self) -> dict[str, Callable[..., Any]]:
        """The slave API; the first argument is always the caller's name."""
        return {
            "getPid": lambda caller: os.getpid(),
            "getMasterUri": lambda caller: self.master,
            "getBusStats": lambda caller: [[], [], []],
            "getBusInfo": lambda caller: self._bus_info(),
            "getSubscriptions": lambda caller: _types(self._subscribers),
            "getPublications": lambda caller: _types(self._publishers),
            "paramUpdate": lambda caller, key, value: 0,
            "publisherUpdate": self._publisher_update,
            "requestTopic": self._request_topic,
            "shutdown": self._shutdown,
        }

    def _publisher_update(self, caller: str, topic: str, uris: Any) -> int:
        if topic in self._subscribers:
            self._subscribers[topic].update(_uris(uris))
        return 0

    def _request_topic(self, caller: str, topic: str, protocols: Any) -> list[Any]:
        if topic not in self._publishers:
            raise Refused(f"{self.name} does not publish {topic}")
        return ["TCPROS", self._host, self._port]

    def _shutdown(self, caller: str, reason: str = "") -> int:
        self._report(f"asked to end by {caller!s:.80}: {reason!s:.200}")
        self.stopped.set()
        return 0

    def _bus_info(self) -> list[list[Any]]:
        """[id, other side, direction, transport, topic, connected] of every connection."""
        ends = []
        for link in self._subscribers.values():
            ends += [(peer, "i", link.topic) for peer in link.publishers]
        for link in self._publishers.values():
            ends += [(peer, "o", link.topic) for peer in link.subscribers]
        rows = []
        for number, (peer, way, topic) in enumerate(ends):
            rows.append([number, peer, way, "TCPROS", topic.name, True])
        return rows


def _types(ends: Any) -> list[list[str]]:
    return [[name, end.topic.type] for name, end in list(ends.items())]


def _uris(value: Any) -> list[str]:
    if not isinstance(value, list) or not all(isinstance(uri, str) for uri in value):
        raise CallError(f"not a list of publishers: {value!r:.80}")
    return value


def global_name(name: str, namespace: str = "/") -> str:
    """`name` in `namespace`, unless it begins with a slash; InputError if it is no ROS name."""
    if not re.fullmatch(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", name, re.ASCII):
        raise InputError(f"not a ROS name: {name!r}")
    return re.sub("/+", "/", name if name.startswith("/") else f"/{namespace}/{name}")


def node_name(name: str) -> str:
    """The global name of a node, in `$ROS_NAMESPACE` if that is set."""
    return global_name(name, os.environ.get("ROS_NAMESPACE", ""))


def names_of(node: str, remaps: Iterable[str] = ()) -> Callable[[str], str]:
    """What gives a node's names their global ones, see https://wiki.ros.org/Names."""
    namespace, new = node.rpartition("/")[0], {}
    for text in remaps:
        name, assigned, other = text.partition(":=")
        if not assigned:
            raise InputError(f"a remapping is FROM:=TO, not {text!r}")
        new[global_name(name, namespace)] = global_name(other, namespace)

    def name_of(name: str) -> str:
        resolved = global_name(name, namespace)
        return new.get(resolved, resolved)

    return name_of


def master_uri(given: str | None = None) -> str:
    """`given`, else `$ROS_MASTER_URI`, else the default; InputError unless http://HOST:PORT."""
    uri = given or os.environ.get("ROS_MASTER_URI") or "http://localhost:11311"
    if not re.fullmatch(r"http://([^\s/:]+|\[[0-9a-fA-F:]+\]):[0-9]{1,5}/?", uri):
        raise InputError(f"not a ROS master's URI (http://HOST:PORT): {uri!r}")
    return uri


def local_host(master: str) -> str:
    """Our host name: `$ROS_HOSTNAME`, `$ROS_IP`, else the address that faces `master`.

    With the master on this computer it is the computer's name, as with rospy, because
    other computers cannot reach the loopback address.
    """
    named = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP")
    if named:
        return named
    parts = urlsplit(master)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((parts.hostname, parts.port))  # Sends nothing.
            address = probe.getsockname()[0]
        if not address.startswith("127."):
            return address
        socket.gethostbyname(socket.gethostname())
    except (OSError, ValueError):
        return "localhost"
    return socket.gethostname()
