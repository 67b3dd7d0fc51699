"""TCP servers with one thread per connection, bounded in number and in time."""

import contextlib
import socket
import socketserver
import threading
from collections.abc import Callable, Iterator
from typing import Any

__all__ = ["BoundedServer", "ConnectionServer", "deadline"]


@contextlib.contextmanager
def deadline(connection: socket.socket, seconds: float) -> Iterator[None]:
    """Close the connection unless the block ends within `seconds`.

    A socket's timeout is for each byte: a peer that sends one every three seconds stays for ever.
    """

    def end() -> None:
        with contextlib.suppress(OSError):  # It may have been closed in between.
            connection.shutdown(socket.SHUT_RDWR)

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class BoundedServer(socketserver.TCPServer):
    """A server that serves in the background from `start` until `close`."""

    most = 64  # connections at once
    most_from_one = 32  # of them from one address
    request_queue_size = 64

    def start(self) -> None:
        """Serve from now on."""
        self._open: dict[threading.Thread, socket.socket] = {}
        self._address: dict[threading.Thread, str] = {}
        self._asking: dict[socket.socket, threading.Thread] = {}
        self._serving = threading.Thread(
            target=self.serve_forever, args=(0.1,), daemon=True, name=type(self).__name__
        )
        self._serving.start()

    def close(self) -> None:
        """Close the port and all connections; wait for their threads."""
        self.shutdown()
        self._serving.join()
        self.server_close()
        for thread, connection in list(self._open.items()):
            self._forget(connection, thread)
            thread.join(1.0)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own; without room, in place of one that waits.

        That is the oldest that has not yet said what it wants, first of the same address.
        """
        address = str(client_address[0])
        from_it = [each for each, other in self._address.items() if other == address]
        if len(self._open) >= self.most or len(from_it) >= self.most_from_one:
            asking = [(each, thread) for each, thread in list(self._asking.items())]
            asking.sort(key=lambda pair: pair[1] not in from_it)
            if not asking or (len(from_it) >= self.most_from_one and asking[0][1] not in from_it):
                return self.shutdown_request(request)
            self._forget(*asking[0])
        thread = threading.Thread(target=self._serve, args=(request, client_address), daemon=True)
        self._open[thread], self._address[thread] = request, address
        self._asking[request] = thread
        thread.start()
        return None

    def asked(self, request: Any) -> None:
        """Note that a connection has said what it wants, and is not to be given up."""
        self._asking.pop(request, None)

    def _forget(self, request: socket.socket, thread: threading.Thread) -> None:
        self._asking.pop(request, None)
        self._open.pop(thread, None)
        self._address.pop(thread, None)
        with contextlib.suppress(OSError):  # It may have been closed in between.
            request.shutdown(socket.SHUT_RDWR)

    def service_actions(self) -> None:
        """Forget threads that have ended, on a busy machine long after their connection."""
        for thread, request in list(self._open.items()):
            if not thread.is_alive():
                self._forget(request, thread)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print no traceback: clients send what they like and vanish."""

    def _serve(self, request: Any, client_address: Any) -> None:
        with contextlib.suppress(Exception):
            self.finish_request(request, client_address)
        self.shutdown_request(request)


class ConnectionServer(BoundedServer):
    """Passes every connection to a function; when that returns, the connection is closed."""

    def __init__(self, host: str, serve: Callable[[socket.socket], None]):
        """Bind to any free port of `host` and start."""

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                serve(self.request)

        super().__init__((host, 0), Handler)
        self.start()
