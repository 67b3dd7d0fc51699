"""A time by which the other side of a connection must be done, however slowly it goes on.

A socket's timeout is for each byte: who sends one every three seconds stays for ever.
"""

import contextlib
import socket
import threading
from collections.abc import Iterator

__all__ = ["deadline"]


@contextlib.contextmanager
def deadline(connection: socket.socket, seconds: float) -> Iterator[None]:
    """Close the connection unless what is done here ends within `seconds`."""

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
