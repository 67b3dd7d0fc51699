"""A text file that is in its place once it is complete."""

import contextlib
import sys
from pathlib import Path

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import new_file

__all__ = ["GrowingFile"]


class GrowingFile:
    """A new text file, written bit by bit; it is at `path` once it is closed."""

    def __init__(self, path: Path | str):
        """Begin the file, beside its place.

        Raises:
            InputError: naming `path`, if it exists or cannot be written.
        """
        if Path(path).exists():
            raise InputError(f"{path}: already there, and nothing is overwritten")
        with contextlib.ExitStack() as stack:
            beside = stack.enter_context(new_file(path))
            self._file = stack.enter_context(beside.open("w", encoding="utf-8"))
            self._open = stack.pop_all()

    def write(self, text: str) -> None:
        """Add `text`; after an error nothing is left of the file.

        Raises:
            InputError: naming `path`, if it cannot be written.
        """
        try:
            self._file.write(text)
        except OSError:
            self._open.__exit__(*sys.exc_info())

    def close(self, last: str = "") -> None:
        """Add `last` and move the file into place, unless that was done.

        Raises:
            InputError: as `write`.
        """
        if not self._file.closed:
            self.write(last)
            self._open.close()
