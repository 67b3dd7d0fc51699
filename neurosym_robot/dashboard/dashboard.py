"""The live view: a page on this computer that follows a stream of forecasts."""

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.dashboard.page import page_parts
from neurosym_robot.dashboard.server import PageServer
from neurosym_robot.dashboard.stream import Stream
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.predictor import Forecast

__all__ = ["Dashboard"]


class Dashboard:
    """Serves the page from `start` to `close`; `show` it every frame."""

    def __init__(self, moments: Moments, host: str = "127.0.0.1", port: int = 8765):
        """Nothing is served yet.

        Args:
            moments: how a stream is told.
            host: name or address to serve at; by default only this computer can look.
            port: 0 for any that is free.
        """
        self._moments, self._address = moments, (host, port)
        self._stream = Stream()
        self._server: PageServer | None = None

    @property
    def url(self) -> str:
        """Where the page is, once started."""
        assert self._server is not None
        host, port = self._server.server_address[:2]
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(str(host), str(host))
        return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"

    def start(self) -> None:
        """Serve, in threads of its own.

        Raises:
            InputError: where the address cannot be had.
        """
        before, after = page_parts()
        introduction = self._moments.introduction
        host, port = self._address
        try:
            self._server = PageServer(self._address, before + after, introduction, self._stream)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot serve at {host}, port {port} ({reason})") from None
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def show(
        self,
        frame: Frame,
        forecast: Forecast | None,
        summary: Mapping[str, Any],
        robot: np.ndarray | None = None,
    ) -> None:
        """What a frame led to.

        Args:
            frame: as the predictor saw it.
            forecast: where it completed a step.
            summary: `Analytics.summary()` then.
            robot: [3] metres, metres, radians, where that is known.
        """
        line = self._moments.moment(frame, forecast, summary, robot)
        if line is not None:
            self._stream.append(line.encode())

    def end(self, summary: Mapping[str, Any]) -> None:
        """Nothing more will be shown; what was shown can still be looked at."""
        self._stream.append(self._moments.ending(summary).encode())
        self._stream.end()

    def close(self) -> None:
        """Serve no more."""
        self._stream.end()
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
