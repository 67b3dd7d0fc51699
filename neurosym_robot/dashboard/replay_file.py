"""The page with everything inside: one file that any browser opens, to share."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import GrowingFile
from neurosym_robot.dashboard.moments import Moments
from neurosym_robot.dashboard.page import page_parts
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.predictor import Forecast

__all__ = ["ReplayFile", "write_replay"]


class ReplayFile:
    """A replay, written while it comes; the file is there once it is closed."""

    def __init__(self, path: Path, moments: Moments):
        """Begin the file.

        Raises:
            InputError: where it exists, is not named `.html`, or cannot be written.
        """
        if path.suffix not in (".html", ".htm"):
            raise InputError(f"{path}: a replay is written as .html")
        self.path, self._moments = path, moments
        before, self._after = page_parts()
        self._file = GrowingFile(path)
        self._file.write(f"{before}\n{moments.introduction}\n")

    def show(
        self,
        frame: Frame,
        forecast: Forecast | None,
        summary: Mapping[str, Any],
        robot: np.ndarray | None = None,
    ) -> None:
        """What a frame led to, with the `robot` [3]; see `Dashboard.show`."""
        line = self._moments.moment(frame, forecast, summary, robot)
        if line is not None:
            self._file.write(line + "\n")

    def end(self, summary: Mapping[str, Any]) -> None:
        """What the score came to; see `Dashboard.end`."""
        self._file.write(self._moments.ending(summary) + "\n")

    def close(self) -> None:
        """Finish the file."""
        self._file.close(self._after)


def write_replay(
    events: Iterable[tuple[Any, ...]],
    path: Path,
    moments: Moments,
) -> None:
    """Write all that was shown, as given to `Dashboard.show`, to one file.

    Raises:
        InputError: as `ReplayFile` does.
    """
    file = ReplayFile(path, moments)
    try:
        for event in events:
            file.show(*event)
    finally:
        file.close()
