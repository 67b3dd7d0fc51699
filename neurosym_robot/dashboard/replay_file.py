"""The page with its data inside: one file that any browser opens, to share."""

from pathlib import Path

from neurosym_jax.errors import InputError
from neurosym_robot.dashboard.moments import Moments, View
from neurosym_robot.dashboard.page import page_parts
from neurosym_robot.online.growing_file import GrowingFile

__all__ = ["ReplayFile"]


class ReplayFile(View):
    """A replay, written frame by frame; the file is in its place once it is closed."""

    def __init__(self, path: Path, moments: Moments):
        """Begin the file.

        Raises:
            InputError: if it exists, is not named `.html`, or cannot be written.
        """
        if path.suffix not in (".html", ".htm"):
            raise InputError(f"{path}: a replay is written as .html")
        self.path, self._moments = path, moments
        before, self._after = page_parts()
        self._file = GrowingFile(path)
        self._file.write(f"{before}\n{moments.introduction}\n")

    def _write(self, line: str) -> None:
        self._file.write(line + "\n")

    def close(self) -> None:
        """Finish the file."""
        self._file.close(self._after)
