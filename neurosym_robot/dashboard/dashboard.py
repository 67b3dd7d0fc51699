"""The page of a stream of forecasts: served live, or as one file to share.

It is one document that needs nothing else, with a place for the lines of `Moments` in
it. Slow or vanished readers and malformed requests cost its server a thread for some
seconds and delay no other reader. Requests for a host name that is not ours are
refused, because another site can point its name at this address ("DNS rebinding").
"""

import base64
import contextlib
import functools
import hashlib
import ipaddress
import json
import math
import os
import secrets
import socket
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from importlib import resources
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import new_file
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.dashboard.view import View
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import ReplayEvent
from neurosym_robot.server import BoundedServer, Ring, deadline

# In the order in which they build on each other; together they are one module.
SCRIPTS = ("recording.js", "stage.js", "panels.js", "app.js")
POLICY = (
    "default-src 'none'; script-src '{script}'; style-src '{style}'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)

ASKING = 3.0  # seconds that a request may take to arrive
PATIENCE = 10.0  # seconds that an event may take to be taken
HEARTBEAT = 1.0  # seconds between two statements of how old and how frequent people are
# bytes on the way to a reader; by itself the system would let megabytes pile up
BUFFER = 2**18
BATCH = 64  # events that a reader takes at once, and so what it may hold that the stream has let go
KEPT = 32 * 2**20  # bytes of the newest events
TABS = 16  # connections of one address at once
HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


@functools.cache
def page_parts() -> list[str]:
    """What stands before and after the data, which is empty live.

    The document lets a browser run its own script alone, told by hash, and load
    nothing.
    """
    folder = resources.files("neurosym_robot.dashboard")
    page, style = ((folder / name).read_text() for name in ("page.html", "page.css"))
    script = "\n".join((folder / name).read_text() for name in SCRIPTS)
    policy = POLICY.format(script=_digest(script), style=_digest(style))
    for place, text in (("policy", policy), ("style", style), ("script", script)):
        page = page.replace(f"@{place}@", text)
    return page.split("@data@")


def _digest(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


class PageServer(BoundedServer):
    """Serves a page at / and a `stream` at /events."""

    most_of_one = TABS
    allow_reuse_address = sys.platform != "win32"  # There it would share the port.

    def __init__(self, address: tuple[str, int], page: str, introduction: str):
        """Bind to an address, whose port may be 0 for any free one; OSError if it cannot be."""
        family, *_, place = socket.getaddrinfo(*address, type=socket.SOCK_STREAM)[0]
        self.address_family = family
        self.page, self.introduction, self.stream = (
            page.encode(),
            introduction.encode(),
            Ring(KEPT),
        )
        self.session = secrets.token_hex(8)
        """Tells this stream from those of other runs."""
        self.fresh: tuple[Mapping[str, Any], float] | None = None
        """`Status.now()` at the newest frame, and when that was."""
        self.names = {"localhost", address[0].lower(), socket.gethostname().lower()}
        super().__init__(place[:2], _Handler)  # pyright: ignore

    def close(self) -> None:
        """Close the port; connected readers get the rest of the stream."""
        self.shutdown()
        self.server_close()

    def beat(self) -> str:
        """How old the newest people are at this moment [s], and how many frames come a second."""
        if self.fresh is None:
            return '{"age":null,"rate":0}'
        now, shown_at = self.fresh
        silence, rate = time.monotonic() - shown_at, now["rate"]
        rate = 1 / silence if silence * rate > 2 else rate
        return json.dumps(
            {"age": round((now["lag"] or 0) + silence, 3), "rate": round(rate, 2)}
        )

    def knows(self, host: str) -> bool:
        """Whether a Host header names us: by address, or by a name that is ours."""
        name = host.strip().lower()
        name = (
            name[1:].partition("]")[0]
            if name.startswith("[")
            else name.partition(":")[0]
        )
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
        self._arriving = deadline(self.request, ASKING)
        super().setup()

    def finish(self) -> None:
        self._arriving.close()
        super().finish()

    def do_GET(self) -> None:
        self._arriving.close()
        path = self.path.partition("?")[0]
        if not self.server.knows(self.headers.get("Host", "")):
            self.send_error(
                HTTPStatus.FORBIDDEN, "Ask for this computer by its own name"
            )
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
        stream, session = self.server.stream, self.server.session
        last_session, _, number = self.headers.get("Last-Event-ID", "").partition("-")
        newest = int(number) if last_session == session and number.isdecimal() else 0
        self.wfile.write(
            b"event: introduction\ndata: %b\n\n" % self.server.introduction
        )
        if not newest:
            self.wfile.write(b"event: anew\ndata:\n\n")
        beaten_at = -math.inf
        while True:
            ended = stream.ended
            first, events = stream.after(newest, HEARTBEAT, BATCH)
            for newest, event in enumerate(events, first):
                self.wfile.write(
                    b"id: %b-%d\ndata: %b\n\n" % (session.encode(), newest, event)
                )
            # What was kept is history: freshness is stated once a reader has all of it.
            if (
                newest >= stream.newest
                and time.monotonic() - beaten_at >= HEARTBEAT / 2
            ):
                beaten_at = time.monotonic()
                self.wfile.write(
                    b"event: beat\ndata: %b\n\n" % self.server.beat().encode()
                )
            if ended and not events:
                break
        self.wfile.write(b"event: end\ndata:\n\n")

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing."""


class Page(View):
    """A view of the lines of `Moments`."""

    def __init__(self, moments: Moments, write: Callable[[str], object]):
        self._moments, self._write = moments, write

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Write the line of a frame."""
        line = self._moments.moment(event, now)
        if line is not None:
            self._write(line)

    def end(self, score: Mapping[str, Any], scored: Sequence[Forecast] = ()) -> None:
        """Write the last line; what was shown can still be looked at."""
        self._write(self._moments.ending(score))


class Dashboard(Page):
    """Serves the page until `close`; call `show` every frame."""

    title = "the page is at"

    def __init__(self, moments: Moments, host: str = "127.0.0.1", port: int = 8765):
        """Serve in background threads at an address; port 0 is any free one.

        InputError if it cannot be used.
        """
        try:
            self._server = PageServer(
                (host, port), "".join(page_parts()), moments.introduction
            )
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(
                f"cannot serve at {host}, port {port} ({reason})"
            ) from None
        super().__init__(
            moments, lambda line: self._server.stream.append(line.encode())
        )
        self._server.start()
        address, free = map(str, self._server.server_address[:2])
        address = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(address, address)
        self.where = (
            f"http://[{address}]:{free}/"
            if ":" in address
            else f"http://{address}:{free}/"
        )

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Show a frame, and note how fresh it is."""
        self._server.fresh = now, time.monotonic()
        super().show(event, now)

    def end(self, score: Mapping[str, Any], scored: Sequence[Forecast] = ()) -> None:
        """Show the final score; what was shown can still be looked at."""
        super().end(score)
        self._server.stream.end()

    def close(self) -> None:
        """Stop serving."""
        self._server.stream.end()
        self._server.close()


class ReplayFile(Page):
    """The page with its data inside, written frame by frame; in its place once it is closed."""

    title = "forecasts are in"

    def __init__(self, path: Path, moments: Moments):
        """Begin the file; InputError if it exists, is not `.html`, or cannot be written."""
        if path.suffix not in (".html", ".htm"):
            raise InputError(f"{path}: a replay is written as .html")
        if os.path.exists(path):
            raise InputError(f"{path}: already there, and nothing is overwritten")
        self.where, self._files = str(path), contextlib.ExitStack()
        beside = self._files.enter_context(new_file(path))
        file = self._files.enter_context(beside.open("w", encoding="utf-8"))
        super().__init__(moments, functools.partial(print, file=file))
        self._write(f"{page_parts()[0]}\n{moments.introduction}")

    def close(self) -> None:
        """Finish the file."""
        with self._files:
            self._write(page_parts()[1])
