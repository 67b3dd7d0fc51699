"""Files as text, and the head of a file that shows its format."""

import codecs
import dataclasses
import functools
import itertools
import stat
from pathlib import Path

import numpy as np

from neurosym_jax.errors import InputError, printable

__all__ = ["Head", "numbers_in", "read_head", "read_text_file", "recording_name", "separator_of"]


def recording_name(path: Path) -> str:
    """Name of the recording in a file: its name without the ending."""
    return printable(path.stem)


def read_text_file(path: Path) -> str:
    """The text of a UTF-8 file, without byte-order mark.

    Raises:
        InputError: if the file cannot be read or is not text.
    """
    try:
        return _bytes_of(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not text ({error.reason})") from None


def _bytes_of(path: Path, size: int = -1) -> bytes:
    """The first `size` bytes of a regular file."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # Opening a pipe would block.
            raise InputError(f"{path}: is a folder, pipe or device, not a file")
        with path.open("rb") as file:
            return file.read(size)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


@dataclasses.dataclass(frozen=True)
class Head:
    """How a file begins; formats are recognised by it."""

    text: str  # its first 64 kB; empty if they are not text

    @functools.cached_property
    def lines(self) -> list[str]:
        """The first lines that are neither empty nor comments."""
        lines = (line.strip() for line in self.text.split("\n"))
        return [line for line in lines if line and not line.startswith("#")]

    @property
    def first(self) -> str:
        """The first of `lines`, if there is one."""
        return self.lines[0] if self.lines else ""

    @property
    def names(self) -> list[str]:
        """The fields of a header line; none if the file begins otherwise."""
        names = [name.strip(' "') for name in self.first.split(separator_of(self.first))]
        named = any(name[:1].isalpha() for name in names) and not numbers_in(self.first)
        return names if named and self.first.replace("\t", "").isprintable() else []

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """[R, columns] numbers of the first lines, up to the first line of another kind."""
        width = len(numbers_in(self.first))
        rows = map(numbers_in, self.lines if width else ())
        alike = list(itertools.takewhile(lambda row: len(row) == width, rows))
        return np.array(alike).reshape(len(alike), width)


def read_head(path: Path) -> Head:
    """How the file at `path` begins."""
    try:
        return Head(codecs.getincrementaldecoder("utf-8-sig")().decode(_bytes_of(path, 1 << 16)))
    except UnicodeDecodeError:  # The reader explains it; here it only fits no format.
        return Head("")


def separator_of(line: str) -> str:
    """What separates the fields of a line: semicolons, commas or tabs, else blanks."""
    mark = max(";,\t", key=line.count)
    return mark if mark in line else " "


def numbers_in(line: str) -> list[float]:
    """The numbers of a row; none if any field is another."""
    mark = separator_of(line)
    try:
        return [float(field) for field in line.split(None if mark == " " else mark)]
    except ValueError:
        return []
