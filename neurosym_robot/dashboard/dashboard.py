"""The live view: a page on this computer that follows a stream of forecasts."""

from collections.abc import Mapping
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.dashboard.moments import Moments, View
from neurosym_robot.dashboard.page import page_parts
from neurosym_robot.dashboard.server import PageServer
from neurosym_robot.dashboard.stream import Stream

__all__ = ["Dashboard"]


class Dashboard(View):
    """Serves the page from `start` to `close`; call `show` every frame."""

    def __init__(self, moments: Moments, host: str = "127.0.0.1", port: int = 8765):
        """Not served yet.

        Args:
            moments: describes the stream.
            host: name or address to serve at; the default is reachable from this computer only.
            port: 0 for any free port.
        """
        self._moments, self._address = moments, (host, port)
        self._stream = Stream()
        self._server: PageServer | None = None

    @property
    def url(self) -> str:
        """Address of the page, once started."""
        assert self._server is not None
        host, port = self._server.server_address[:2]
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(str(host), str(host))
        return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"

    def start(self) -> None:
        """Serve in background threads.

        Raises:
            InputError: if the address cannot be used.
        """
        page, introduction = "".join(page_parts()), self._moments.introduction
        host, port = self._address
        try:
            self._server = PageServer(self._address, page, introduction, self._stream)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot serve at {host}, port {port} ({reason})") from None
        self._server.start()

    def _write(self, line: str) -> None:
        self._stream.append(line.encode())

    def end(self, summary: Mapping[str, Any]) -> None:
        """Show the final score; what was shown can still be looked at."""
        super().end(summary)
        self._stream.end()

    def close(self) -> None:
        """Stop serving."""
        self._stream.end()
        if self._server is not None:
            self._server.close()
