"""The publishing side of a topic: a short queue per subscriber, so that none delays another."""

import collections
import select
import socket
import threading
from collections.abc import Callable

from neurosym_robot.ros.tcpros.names import Topic
from neurosym_robot.ros.tcpros.wire import encode_block, encode_header

__all__ = ["Publisher"]

SLOW = 5.0  # seconds that a subscriber may take for one message before it is dropped
LOOK = 1.0  # seconds between checks for subscribers that have left, while nothing is sent


class Publisher:
    """Publishes messages of one topic; made by `Node.advertise`."""

    def __init__(
        self, topic: Topic, caller: str, report: Callable[[str], None], queue_size: int = 10
    ):
        """A publisher of the node `caller`; a full queue drops its oldest message."""
        self.topic, self._caller, self._report = topic, caller, report
        self._queue_size = queue_size
        self._queues: dict[socket.socket, tuple[str, collections.deque[bytes]]] = {}
        self._changed = threading.Condition()

    @property
    def subscribers(self) -> list[str]:
        """Names of the connected subscribers."""
        with self._changed:
            return [peer for peer, _ in self._queues.values()]

    def publish(self, message: bytes) -> None:
        """Send a serialised message to every subscriber, without waiting."""
        block = encode_block(message)
        with self._changed:
            for _, queue in self._queues.values():
                queue.append(block)
            self._changed.notify_all()

    def serve(self, connection: socket.socket, header: dict[str, str]) -> None:
        """Serve a subscriber that sent `header` until one side is closed."""
        topic, peer = self.topic, header.get("callerid", "somebody")
        if header.get("md5sum") not in ("*", topic.md5):
            wanted = f"{header.get('type')} with md5 {header.get('md5sum')}"
            reason = f"{topic.name} is {topic.type} with md5 {topic.md5}, not {wanted}"
            self._report(f"refused the subscriber {peer}: {reason}")
            connection.sendall(encode_header({"error": reason}))
            return
        connection.sendall(encode_header(topic.header(self._caller, latching="0")))
        connection.settimeout(SLOW)
        queue: collections.deque[bytes] = collections.deque(maxlen=self._queue_size)
        with self._changed:
            self._queues[connection] = peer, queue
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: queue, LOOK)
                    block = queue.popleft() if queue else b""
                # Subscribers send nothing, so that something to read is the end.
                if select.select([connection], [], [], 0)[0] and not connection.recv(4096):
                    return
                connection.sendall(block)
        except TimeoutError:
            self._report(f"{topic.name}: dropped the subscriber {peer}, which does not read")
        finally:
            with self._changed:
                del self._queues[connection]
