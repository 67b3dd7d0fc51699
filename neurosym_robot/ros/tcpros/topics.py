"""Both sides of a topic.

A publisher keeps its newest messages, so that no subscriber delays another; a
subscriber has a thread per publisher, which survives its restarts.
"""

import select
import socket
import threading
from collections.abc import Callable, Iterable, Mapping

from neurosym_robot.ros.tcpros.wire import (
    HANDSHAKE,
    CallError,
    ProtocolError,
    Topic,
    call,
    encode_block,
    encode_header,
    read_block,
    shake_hands,
)
from neurosym_robot.server import Ring, shut

PATIENCE = (
    0.1,
    2.0,
)  # seconds before a lost publisher is tried again: at first, and at most
MOST = 32  # publishers of a topic that are listened to at once
SLOW = 5.0  # seconds that a subscriber may take for one message before it is dropped
# seconds between checks for subscribers that have left, while nothing is sent
LOOK = 1.0

Hear = Callable[[bytes, Mapping[str, str]], None]
"""Called with every serialised message and its publisher's header, in a thread."""
Refuse = Callable[[Mapping[str, str]], str | None]
"""The reason to refuse a publisher by its header, or None."""


class Publisher:
    """Publishes messages of one topic; made by `Node.advertise`."""

    def __init__(
        self,
        topic: Topic,
        caller: str,
        report: Callable[[str], None],
        queue_size: int = 10,
    ):
        """A publisher of the node `caller`; a full queue drops its oldest message."""
        self.topic, self._caller, self._report = topic, caller, report
        self._newest = Ring(queue_size, lambda block: 1)
        self._peers: dict[socket.socket, str] = {}

    @property
    def subscribers(self) -> list[str]:
        """Names of the connected subscribers."""
        return list(self._peers.values())

    def publish(self, message: bytes) -> None:
        """Send a serialised message to every subscriber, without waiting."""
        self._newest.append(encode_block(message))

    def serve(self, connection: socket.socket, header: dict[str, str]) -> None:
        """Serve a subscriber that sent `header` until one side is closed."""
        topic, peer = self.topic, header.get("callerid", "somebody")
        if header.get("md5sum") not in ("*", topic.md5):
            reason = (
                f"{topic.name} is {topic.type} with md5 {topic.md5}, "
                f"not {header.get('type')} with md5 {header.get('md5sum')}"
            )
            self._report(f"refused the subscriber {peer}: {reason}")
            connection.sendall(encode_header({"error": reason}))
            return
        connection.settimeout(SLOW)
        # A subscriber that has read the header misses nothing that is published from
        # then on.
        sent = self._newest.newest
        self._peers[connection] = peer
        try:
            connection.sendall(encode_header(topic.header(self._caller, latching="0")))
            # Subscribers send nothing, so that something to read is the end.
            while not select.select([connection], [], [], 0)[0] or connection.recv(
                4096
            ):
                first, blocks = self._newest.after(sent, LOOK)
                sent = first + len(blocks) - 1
                connection.sendall(b"".join(blocks))
        except TimeoutError:
            self._report(
                f"{topic.name}: dropped the subscriber {peer}, which does not read"
            )
        finally:
            del self._peers[connection]


class Mismatch(ProtocolError):
    """The publisher's messages are of another definition than ours."""


class Subscriber:
    """Hears all publishers of one topic; made by `Node.subscribe`."""

    def __init__(
        self,
        topic: Topic,
        caller: str,
        report: Callable[[str], None],
        hear: Hear,
        refuse: Refuse,
    ):
        """A subscriber of the node `caller`; `report` is called with one line about connections."""
        self.topic, self.caller, self.report = topic, caller, report
        self.hear, self.refuse = hear, refuse
        self._links: dict[str, _Link] = {}
        self._lock = threading.Lock()

    @property
    def publishers(self) -> dict[str, str]:
        """Names of the connected publishers by URI."""
        with self._lock:
            return {
                uri: link.header.get("callerid", "")
                for uri, link in self._links.items()
                if link.header
            }

    def update(self, uris: Iterable[str], all_of_them: bool = True) -> None:
        """Connect to the publishers that the master names.

        A publisher that is no longer named is left when its connection ends: a
        restarted master has forgotten publishers that are still there. The answer to a
        registration only adds, because it may be older than an update: it is not
        `all_of_them`.
        """
        with self._lock:
            current = dict.fromkeys(uris)
            for uri, link in list(self._links.items()):
                link.wanted = uri in current or (link.wanted and not all_of_them)
                if not link.is_alive() or not (link.wanted or link.header):
                    self._links.pop(uri).close()
            for uri in current:
                if uri not in self._links and len(self._links) < MOST:
                    self._links[uri] = _Link(self, uri)
                    self._links[uri].start()

    def close(self) -> None:
        """Leave all publishers."""
        with self._lock:
            for link in self._links.values():
                link.close()


class _Link(threading.Thread):
    """The connection to the publisher at one URI, renewed as long as the publisher is wanted."""

    def __init__(self, subscriber: Subscriber, uri: str):
        super().__init__(daemon=True, name=f"{subscriber.topic.name} from {uri}")
        self._subscriber, self._uri = subscriber, uri
        self.wanted = True
        self.header: dict[str, str] = {}  # the publisher's, while it is connected
        self._ending = threading.Event()
        self._connection: socket.socket | None = None
        self._said = ""

    def run(self) -> None:
        delay, most = PATIENCE
        while self.wanted and not self._ending.is_set():
            try:
                with self._connect() as self._connection:
                    self.header = self._shake(self._connection)
                    self._say("connected")
                    while not self._ending.is_set():
                        message = read_block(self._connection)
                        delay = PATIENCE[
                            0
                        ]  # A message came; else the next try waits longer.
                        self._subscriber.hear(message, self.header)
            except Mismatch as error:
                self._say(f"refused: {error}")
                # Its definition will not change; restarted, it has another URI.
                self._ending.wait()
            except OSError as error:
                self._say(f"{'lost' if self.header else 'not reached'}: {error}")
            self.header = {}
            self._ending.wait(delay)
            delay = min(2 * delay, most)

    def close(self) -> None:
        self._ending.set()
        if self._connection is not None:
            shut(self._connection)

    def _connect(self) -> socket.socket:
        topic, caller = self._subscriber.topic, self._subscriber.caller
        answer = call(self._uri, "requestTopic", caller, topic.name, [["TCPROS"]])
        try:
            _, host, port = answer
            return socket.create_connection((str(host), int(port)), HANDSHAKE)
        except (TypeError, ValueError, OverflowError):
            raise CallError(f"no TCPROS address: {answer!r:.80}") from None

    def _shake(self, connection: socket.socket) -> dict[str, str]:
        topic = self._subscriber.topic
        # With any md5sum the publisher answers, and we compare and report what is
        # wrong.
        fields = topic.header(self._subscriber.caller, md5sum="*", tcp_nodelay="1")
        header = shake_hands(connection, fields)
        if "error" in header:
            raise ProtocolError(f"it answers: {header['error']!r:.200}")
        type_and_md5 = (
            f"{header.get('type')!s:.80} with md5 {header.get('md5sum')!s:.40}"
        )
        if topic.md5 not in ("*", header.get("md5sum")):
            raise Mismatch(
                f"it publishes {type_and_md5}, not {topic.type} with md5 {topic.md5}"
            )
        reason = self._subscriber.refuse(header)
        if reason:
            raise Mismatch(f"it publishes {type_and_md5}, {reason}")
        connection.settimeout(None)
        return header

    def _say(self, text: str) -> None:
        if text != self._said and not self._ending.is_set():
            self._said = text
            self._subscriber.report(
                f"{self._subscriber.topic.name} from {self._uri}: {text}"
            )
