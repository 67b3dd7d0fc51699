"""A small HTTP server of one page and one stream of events, and of nothing else.

Readers that are slow or vanish, requests that are no HTTP, and floods of connections cost a thread
for some seconds and delay nobody. Pages of other sites that point a name of theirs at this address
("DNS rebinding") are refused by the name they ask for.
"""

import contextlib
import ipaddress
import socket
import sys
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from neurosym_jax.runtime.deadline import deadline
from neurosym_robot.dashboard.stream import Stream

__all__ = ["PageServer"]

CONNECTIONS = 64
"""At once; others are closed unheard."""
PATIENCE = 10.0
"""Seconds that a request may take to arrive, or an event to be taken."""
HEARTBEAT = 5.0
"""Seconds of silence after which a reader is written to, to see whether it is there."""
BUFFER = 2**18
"""Bytes on the way to a reader; by itself the system would let megabytes pile up."""
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class PageServer(ThreadingHTTPServer):
    """Serves `page` at / and `stream` at /events."""

    daemon_threads = True
    block_on_close = False
    request_queue_size = CONNECTIONS

    def __init__(self, address: tuple[str, int], page: str, introduction: str, stream: Stream):
        """Bind to an address, whose port may be 0 for any that is free.

        Raises:
            OSError: where that cannot be had.
        """
        family, *_, place = socket.getaddrinfo(*address, type=socket.SOCK_STREAM)[0]
        self.address_family = family
        self.page, self.introduction, self.stream = page.encode(), introduction.encode(), stream
        self.names = {"localhost", address[0].lower(), socket.gethostname().lower()}
        self._room = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(place[:2], _Handler)  # pyright: ignore

    def server_bind(self) -> None:
        """Bind, without HTTPServer's look-up of our own name, which can take seconds."""
        if sys.platform == "win32":
            self.allow_reuse_address = False  # There it would share the port.
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread, if there is room."""
        if not self._room.acquire(blocking=False):
            return self.shutdown_request(request)
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and make room."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._room.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Readers come and go as they like: say nothing."""

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
        self._arriving.enter_context(deadline(self.request, PATIENCE))
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
            self._begin("text/html; charset=utf-8", len(self.server.page))
            if self.command == "GET":
                self.wfile.write(self.server.page)
        elif path == "/events" and self.command == "GET":
            self._begin("text/event-stream")
            self._send_events()
        else:
            self.send_error(HTTPStatus.NOT_FOUND, "Not found")

    do_HEAD = do_GET

    def _begin(self, kind: str, length: int | None = None) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.end_headers()

    def _send_events(self) -> None:
        """What is remembered, then what comes, until the reader is gone or nothing comes."""
        stream = self.server.stream
        session = stream.session.encode()
        said, _, number = self.headers.get("Last-Event-ID", "").partition("-")
        known = int(number) if said == stream.session and number.isdecimal() else 0
        self.wfile.write(b"event: introduction\ndata: %b\n\n" % self.server.introduction)
        if not known:
            self.wfile.write(b"event: anew\ndata:\n\n")
        while True:
            ended = stream.ended
            first, events = stream.after(known, HEARTBEAT)
            for number, event in enumerate(events, first):
                self.wfile.write(b"id: %b-%d\ndata: %b\n\n" % (session, number, event))
                known = number
            if not events:
                if ended:
                    break
                self.wfile.write(b": still here\n\n")
        self.wfile.write(b"event: end\ndata:\n\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""
