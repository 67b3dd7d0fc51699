"""TCP servers with one thread per connection, bounded in number and in time."""

import contextlib
import socket
import socketserver
import threading
from collections.abc import Callable, Iterator
from typing import Any

MOST = 64  # connections of a server at once


@contextlib.contextmanager
def deadline(connection: socket.socket, seconds: float) -> Iterator[None]:
    """Close the connection unless the block ends within `seconds`.

    A socket's timeout is for each byte: a peer that sends one every three seconds stays for ever.
    """
    timer = threading.Timer(seconds, shut, (connection,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def shut(connection: socket.socket) -> None:
    """End a connection, which its own thread then closes."""
    with contextlib.suppress(OSError):  # It may have been closed in between.
        connection.shutdown(socket.SHUT_RDWR)


class BoundedServer(socketserver.ThreadingMixIn, socketserver.TCPServer):
    """A server that serves in the background from `start` until `close`."""

    daemon_threads, block_on_close = True, False
    request_queue_size = MOST

    def start(self) -> None:
        """Serve from now on."""
        self.connections: set[socket.socket] = set()
        threading.Thread(target=self.serve_forever, args=(0.1,), daemon=True).start()

    def close(self) -> None:
        """Close the port and all connections."""
        self.shutdown()
        self.server_close()
        for connection in list(self.connections):
            shut(connection)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own; refuse it if there are too many."""
        if len(self.connections) >= MOST:
            return self.shutdown_request(request)
        self.connections.add(request)
        return super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """End a connection."""
        self.connections.discard(request)
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
