"""The subscribing side of a topic: a thread per publisher, which survives its restarts."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterable, Mapping

from neurosym_robot.ros.tcpros.names import Topic
from neurosym_robot.ros.tcpros.wire import (
    MAX_HEADER,
    MAX_MESSAGE,
    ProtocolError,
    decode_header,
    encode_header,
    prepare,
    read_block,
)
from neurosym_robot.ros.tcpros.xmlrpc import CallError, call
from neurosym_robot.server import deadline

__all__ = ["Subscriber"]

HANDSHAKE = 5.0  # seconds for each step until messages come
PATIENCE = (0.1, 2.0)  # seconds before a lost publisher is tried again: at first, and at most
MOST = 32  # publishers of a topic that are listened to at once


class Mismatch(ProtocolError):
    """The publisher's messages are of another definition than ours."""


class Subscriber:
    """Hears all publishers of one topic; made by `Node.subscribe`."""

    def __init__(
        self,
        topic: Topic,
        caller: str,
        hear: Callable[[bytes, Mapping[str, str]], None],
        report: Callable[[str], None],
        refuse: Callable[[Mapping[str, str]], str | None] = lambda header: None,
    ):
        """A subscriber of the node `caller`.

        Args:
            topic: what is subscribed.
            caller: name of the node.
            hear: called with every serialised message and its publisher's header, in a thread.
            report: called with one line when a publisher is connected, lost or refused.
            refuse: returns the reason to refuse a publisher by its header, or None.
        """
        self.topic, self.caller, self.hear, self.report = topic, caller, hear, report
        self.refuse = refuse
        self._links: dict[str, _Link] = {}
        self._lock = threading.Lock()
        self._closed = False

    @property
    def publishers(self) -> list[str]:
        """URIs of the connected publishers."""
        with self._lock:
            return [uri for uri, link in self._links.items() if link.connected]

    def hears(self, caller: str) -> bool:
        """Whether the publisher of that name is connected."""
        with self._lock:
            links = list(self._links.values())
        return any(link.connected and link.header.get("callerid") == caller for link in links)

    def update(self, uris: Iterable[str], all_of_them: bool = True) -> None:
        """Connect to the publishers that the master names.

        A publisher that is no longer named is left when its connection ends: a restarted master
        has forgotten publishers that are still there.

        Args:
            uris: of the publishers.
            all_of_them: whether others are gone. The answer to a registration only adds, because
                it may be older than an update.
        """
        with self._lock:
            if self._closed:
                return
            wanted = list(dict.fromkeys(uris))
            self._links = {uri: link for uri, link in self._links.items() if link.is_alive()}
            for uri, link in list(self._links.items()):
                link.wanted = uri in wanted or (link.wanted and not all_of_them)
                if not link.wanted and not link.connected:
                    self._links.pop(uri).close()
            new = [uri for uri in wanted if uri not in self._links]
            room = MOST - len(self._links)
            if len(new) > room:
                self.report(f"{self.topic.name}: {len(new) - room} publishers too many are ignored")
            for uri in new[: max(room, 0)]:
                self._links[uri] = _Link(self, uri)
                self._links[uri].start()

    def close(self) -> None:
        """Leave all publishers."""
        with self._lock:
            self._closed = True
            links = list(self._links.values())
        for link in links:
            link.close()
        for link in links:
            link.join(1.0)


class _Link(threading.Thread):
    """The connection to the publisher at one URI, renewed as long as the publisher is wanted."""

    def __init__(self, subscriber: Subscriber, uri: str):
        super().__init__(daemon=True, name=f"{subscriber.topic.name} from {uri}")
        self._subscriber, self._uri = subscriber, uri
        self.wanted = True
        self.connected = False
        self._fruitful = False  # a message came; else the next try waits longer
        self._ending = threading.Event()
        self._connection: socket.socket | None = None
        self.header: dict[str, str] = {}
        self._said = ""

    def run(self) -> None:
        delay = PATIENCE[0]
        while self.wanted and not self._ending.is_set():
            try:
                with self._connect() as connection:
                    self._listen(connection)
            except Mismatch as error:
                self._say(f"refused: {error}")
                # Its definition will not change; restarted, it has another URI.
                self._ending.wait()
            except OSError as error:
                reason = error.strerror or str(error)
                self._say(f"lost: {reason}" if self.connected else f"not reached: {reason}")
            if self._fruitful:
                delay = PATIENCE[0]
            self.connected = self._fruitful = False
            self._connection = None
            self._ending.wait(delay)
            delay = min(2 * delay, PATIENCE[1])

    def close(self) -> None:
        self._ending.set()
        if self._connection is not None:
            with contextlib.suppress(OSError):  # It may have been closed in between.
                self._connection.shutdown(socket.SHUT_RDWR)

    def _connect(self) -> socket.socket:
        topic, caller = self._subscriber.topic, self._subscriber.caller
        answer = call(self._uri, "requestTopic", caller, topic.name, [["TCPROS"]])
        try:
            protocol, host, port = answer
            if protocol != "TCPROS":
                raise ValueError(protocol)
            connection = socket.create_connection((str(host), int(port)), HANDSHAKE)
        except (TypeError, ValueError, OverflowError):
            raise CallError(f"no TCPROS address: {answer!r:.80}") from None
        try:
            prepare(connection)
            self._connection = connection
            self._shake(connection)
        except BaseException:
            connection.close()
            raise
        return connection

    def _shake(self, connection: socket.socket) -> None:
        topic = self._subscriber.topic
        # With any md5sum the publisher answers, and we compare and report what is wrong.
        fields = topic.header(self._subscriber.caller, md5sum="*", tcp_nodelay="1")
        with deadline(connection, HANDSHAKE):
            connection.sendall(encode_header(fields))
            header = decode_header(read_block(connection, MAX_HEADER))
        if "error" in header:
            raise ProtocolError(f"it answers: {header['error']!r:.200}")
        theirs = f"{header.get('type')!s:.80} with md5 {header.get('md5sum')!s:.40}"
        if topic.md5 not in ("*", header.get("md5sum")):
            raise Mismatch(f"it publishes {theirs}, not {topic.type} with md5 {topic.md5}")
        if reason := self._subscriber.refuse(header):
            raise Mismatch(f"it publishes {theirs}, {reason}")
        self.header = header

    def _listen(self, connection: socket.socket) -> None:
        connection.settimeout(None)
        self.connected = True
        self._say("connected")
        while not self._ending.is_set():
            message = read_block(connection, MAX_MESSAGE)
            self._fruitful = True
            self._subscriber.hear(message, self.header)

    def _say(self, text: str) -> None:
        if text != self._said and not self._ending.is_set():
            self._said = text
            self._subscriber.report(f"{self._subscriber.topic.name} from {self._uri}: {text}")
