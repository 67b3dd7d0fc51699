"""A small HTTP server of one page and one stream of events.

Slow or vanished readers and malformed requests cost a thread for some seconds and delay no other
reader. Requests for a host name that is not ours are refused, because another site can point its
name at this address ("DNS rebinding").
"""

import collections
import contextlib
import ipaddress
import secrets
import socket
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any

from neurosym_robot.server import BoundedServer, deadline

ASKING = 3.0  # seconds that a request may take to arrive
PATIENCE = 10.0  # seconds that an event may take to be taken
HEARTBEAT = 5.0  # seconds of silence after which a reader is written to, to see whether it is there
BUFFER = 2**18  # bytes on the way to a reader; by itself the system would let megabytes pile up
BATCH = 64  # events that a reader takes at once, and so what it may hold that the stream has let go
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class Stream:
    """A ring of numbered texts, bounded in bytes; the oldest make room for the newest."""

    def __init__(self, limit: int = 32 * 2**20):
        """Empty; `limit` is in bytes."""
        self._limit, self._size = limit, 0
        self._events: collections.deque[bytes] = collections.deque()
        self._first = 1  # number of the oldest
        self._changed = threading.Condition()
        self.ended = False
        self.session = secrets.token_hex(8)
        """Tells this stream from those of other runs."""

    def append(self, event: bytes) -> None:
        """Add the newest."""
        with self._changed:
            self._events.append(event)
            self._size += len(event)
            while self._size > self._limit and len(self._events) > 1:
                self._size -= len(self._events.popleft())
                self._first += 1
            self._changed.notify_all()

    def end(self) -> None:
        """Nothing more comes."""
        with self._changed:
            self.ended = True
            self._changed.notify_all()

    def after(self, number: int, timeout: float) -> tuple[int, list[bytes]]:
        """Events after that number: the number of the first, and up to `BATCH` of them.

        Waits up to `timeout` seconds for one; those that are gone are skipped.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self.ended or self._first + len(self._events) > number + 1, timeout
            )
            first = max(number + 1, self._first)
            last = min(first + BATCH, self._first + len(self._events))
            return first, [self._events[n - self._first] for n in range(first, last)]


class PageServer(BoundedServer):
    """Serves a page at / and a `stream` at /events."""

    allow_reuse_address = sys.platform != "win32"  # There it would share the port.

    def __init__(self, address: tuple[str, int], page: str, introduction: str):
        """Bind to an address, whose port may be 0 for any free one; OSError if it cannot be."""
        family, *_, place = socket.getaddrinfo(*address, type=socket.SOCK_STREAM)[0]
        self.address_family = family
        self.page, self.introduction, self.stream = page.encode(), introduction.encode(), Stream()
        self.names = {"localhost", address[0].lower(), socket.gethostname().lower()}
        super().__init__(place[:2], _Handler)  # pyright: ignore

    def close(self) -> None:
        """Close the port; connected readers get the rest of the stream."""
        self.shutdown()
        self.server_close()

    def knows(self, host: str) -> bool:
        """Whether a Host header names us: by address, or by a name that is ours."""
        name = host.strip().lower()
        name = name[1:].partition("]")[0] if name.startswith("[") else name.partition(":")[0]
        try:
            return bool(ipaddress.ip_address(name))
        except ValueError:
            return name.removesuffix(".local") in self.names


class _Handler(BaseHTTPRequestHandler):
    server: PageServer  # pyright: ignore
    timeout = PATIENCE
    server_version, sys_version = "neurosym_jax", ""
    error_message_format, error_content_type = "%(code)d %(message)s\n", "text/plain"

    def setup(self) -> None:
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        # For the whole request, and not for each of its bytes.
        self._arriving = contextlib.ExitStack()
        self._arriving.enter_context(deadline(self.request, ASKING))
        super().setup()

    def finish(self) -> None:
        self._arriving.close()
        super().finish()

    def do_GET(self) -> None:
        self._arriving.close()
        path = self.path.partition("?")[0]
        if not self.server.knows(self.headers.get("Host", "")):
            self.send_error(HTTPStatus.FORBIDDEN, "Ask for this computer by its own name")
        elif path == "/":
            self._begin("text/html; charset=utf-8")
            self.wfile.write(self.server.page)
        elif path == "/events":
            self._begin("text/event-stream")
            self._send_events()
        else:
            self.send_error(HTTPStatus.NOT_FOUND, "Not found")

    def _begin(self, kind: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def _send_events(self) -> None:
        """What is remembered, then what comes, until the reader is gone or nothing comes."""
        stream = self.server.stream
        said, _, number = self.headers.get("Last-Event-ID", "").partition("-")
        known = int(number) if said == stream.session and number.isdecimal() else 0
        self.wfile.write(b"event: introduction\ndata: %b\n\n" % self.server.introduction)
        if not known:
            self.wfile.write(b"event: anew\ndata:\n\n")
        while True:
            ended = stream.ended
            first, events = stream.after(known, HEARTBEAT)
            for known, event in enumerate(events, first):
                self.wfile.write(
                    b"id: %b-%d\ndata: %b\n\n" % (stream.session.encode(), known, event)
                )
            if not events:
                if ended:
                    break
                self.wfile.write(b": still here\n\n")
        self.wfile.write(b"event: end\ndata:\n\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""
