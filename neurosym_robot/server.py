"""TCP servers with one thread per connection, bounded in number and in time, and what they send."""

import collections
import contextlib
import socket
import socketserver
import threading
from collections.abc import Callable
from typing import Any

MOST = 64  # connections of a server at once


def deadline(connection: socket.socket, seconds: float) -> contextlib.ExitStack:
    """Close the connection unless the context, which is returned, ends within `seconds`.

    A socket's timeout is for each byte: a peer that sends one every three seconds stays
    for ever.
    """
    timer, context = (
        threading.Timer(seconds, shut, (connection,)),
        contextlib.ExitStack(),
    )
    timer.daemon = True
    timer.start()
    context.callback(timer.cancel)
    return context


def shut(connection: socket.socket) -> None:
    """End a connection, which its own thread then closes."""
    with contextlib.suppress(OSError):  # It may have been closed in between.
        connection.shutdown(socket.SHUT_RDWR)


class Ring:
    """Numbered blocks of bytes for many readers; the oldest make room for the newest."""

    def __init__(self, limit: int, size: Callable[[bytes], int] = len):
        """Empty; `limit` is that of the sum of the blocks' sizes."""
        self._limit, self._size = limit, size
        self._blocks: collections.deque[bytes] = collections.deque()
        self._used = self.newest = 0
        """Number of the newest block; the first has 1."""
        self.ended = False
        self._changed = threading.Condition()

    def append(self, block: bytes) -> None:
        """Add the newest, which is kept whatever its size."""
        with self._changed:
            self._blocks.append(block)
            self._used += self._size(block)
            self.newest += 1
            while self._used > self._limit and len(self._blocks) > 1:
                self._used -= self._size(self._blocks.popleft())
            self._changed.notify_all()

    def end(self) -> None:
        """Nothing more comes."""
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def after(
        self, number: int, timeout: float, most: int = 1
    ) -> tuple[int, list[bytes]]:
        """Blocks after that number: the number of the first, and up to `most` of them.

        Waits up to `timeout` seconds for one; those that are gone are skipped.
        """
        with self._changed:
            self._changed.wait_for(lambda: self.ended or self.newest > number, timeout)
            oldest = self.newest + 1 - len(self._blocks)
            first = max(number + 1, oldest)
            last = min(first + most, self.newest + 1)
            return first, [self._blocks[n - oldest] for n in range(first, last)]


class BoundedServer(socketserver.ThreadingMixIn, socketserver.TCPServer):
    """A server that serves in the background from `start` until `close`."""

    daemon_threads, block_on_close = True, False
    request_queue_size = MOST
    most_of_one = MOST  # connections of one address at once

    def start(self) -> None:
        """Serve from now on."""
        self.connections: dict[socket.socket, str] = {}
        """The open ones, and whose they are."""
        threading.Thread(target=self.serve_forever, args=(0.1,), daemon=True).start()

    def close(self) -> None:
        """Close the port and all connections."""
        self.shutdown()
        self.server_close()
        for connection in list(self.connections):
            shut(connection)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own; refuse it if there are too many."""
        address, addresses = client_address[0], list(self.connections.values())
        if len(addresses) >= MOST or addresses.count(address) >= self.most_of_one:
            return self.shutdown_request(request)
        self.connections[request] = address
        return super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """End a connection."""
        self.connections.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print no traceback: clients send what they like and vanish."""


class ConnectionServer(BoundedServer):
    """Passes every connection to a function; when that returns, the connection is closed."""

    def __init__(self, host: str, serve: Callable[[socket.socket], None]):
        """Bind to any free port of `host` and start."""

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                serve(self.request)

        super().__init__((host, 0), Handler)
        self.start()
