"""The page of a stream of forecasts: served live, or as one file to share.

It is one document that needs nothing else, with a place for the lines of `Moments` in it.
"""

import base64
import contextlib
import functools
import hashlib
import os
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import new_file
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.dashboard.server import PageServer
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.replay import ReplayEvent

# In the order in which they build on each other; together they are one module.
SCRIPTS = ("recording.js", "stage.js", "panels.js", "app.js")
POLICY = (
    "default-src 'none'; script-src '{script}'; style-src '{style}'; img-src data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'"
)


@functools.cache
def page_parts() -> list[str]:
    """What stands before and after the data, which is empty live.

    The document lets a browser run its own script alone, told by hash, and load nothing.
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


class View:
    """Shows a stream frame by frame, until it is closed."""

    title: str
    where: str
    """What it is, such as "the page is at", and its address or file."""

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Show a frame; `now` is `Status.now()`."""

    def end(self, score: Mapping[str, Any], scored: Sequence[Forecast] = ()) -> None:
        """Show the final `Analytics.summary()`, and the last forecasts that were scored."""

    def close(self) -> None:
        """Stop showing."""


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
            self._server = PageServer((host, port), "".join(page_parts()), moments.introduction)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot serve at {host}, port {port} ({reason})") from None
        super().__init__(moments, lambda line: self._server.stream.append(line.encode()))
        self._server.start()
        there, free = map(str, self._server.server_address[:2])
        there = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(there, there)
        self.where = f"http://[{there}]:{free}/" if ":" in there else f"http://{there}:{free}/"

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
