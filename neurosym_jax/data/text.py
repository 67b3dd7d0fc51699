"""Text files as lines, fields and JSON values, strictly: what every reader of tracks begins with.

A file is read piece by piece, so that memory is a few times its size at most; what is no regular
file (a pipe would block for ever) or no text is refused before anything of it is kept.
"""

import contextlib
import dataclasses
import functools
import json
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.memory import refuse_beyond_memory

__all__ = [
    "Head",
    "JsonNumber",
    "decode_json",
    "number",
    "read_head",
    "read_lines",
    "read_number",
    "read_pieces",
    "separator_of",
    "split_row",
]

LINE = 1 << 24
"""Characters; the longest line that is read. A header of 300,000 bodies has a quarter of them."""

_HEAD = 1 << 16  # characters to tell a format by; a THÖR header is about 10 kB

_NAME = re.compile(r"""(?:^|[\s,;])["'(]*[^\W\d]""")

_GROWTH = 12.0  # bytes of memory for each of a file, at most


class NotText(InputError):
    """A file's content is no text."""


def read_lines(path: Path) -> Iterator[str]:
    """The lines of a UTF-8 file without their ends and its byte-order mark.

    Raises:
        InputError: see `read_pieces`.
    """
    for lines in read_pieces(path):
        yield from lines


def read_pieces(path: Path, size: int = 1 << 20) -> Iterator[list[str]]:
    """The lines of `read_lines`, as many at a time as have some `size` characters.

    Raises:
        InputError: for what cannot be read, is no regular file, no text, or larger than memory; for
            a line longer than `LINE`.
    """
    try:
        status = path.stat()  # Before it is opened, which blocks where it is a pipe.
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: is a {_kind(status.st_mode)}, not a file")
        refuse_beyond_memory(f"{path}: reading it", _GROWTH * status.st_size, "split it")
        with path.open(encoding="utf-8-sig") as file:
            while piece := file.read(size):
                rest = "" if "\0" in piece else file.readline(LINE)
                piece += rest
                if "\0" in piece:
                    raise NotText(f"{path}: cannot be read as text (there are zero bytes in it)")
                if len(rest) >= LINE:
                    reason = f"a line is longer than {LINE:,}"
                    raise NotText(f"{path}: cannot be read as text ({reason})")
                # str.splitlines would split at characters that JSON allows inside a text.
                yield piece.removesuffix("\n").split("\n")
    except UnicodeDecodeError as error:
        raise NotText(f"{path}: cannot be read as text ({error.reason})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _kind(mode: int) -> str:
    for test, name in (
        (stat.S_ISDIR, "folder"),
        (stat.S_ISFIFO, "pipe"),
        (stat.S_ISSOCK, "socket"),
    ):
        if test(mode):
            return name
    return "device"


@dataclasses.dataclass(frozen=True)
class Head:
    """How a file begins."""

    lines: tuple[str, ...]
    """The lines that say something, each as far as it matters."""
    text: str = ""
    """The beginning itself, comments and all."""

    @property
    def first(self) -> str:
        """The first of them."""
        return self.lines[0].strip() if self.lines else ""

    @property
    def named(self) -> bool:
        """Whether it begins with names of columns, as a header or in JSON; not in a binary file."""
        if self.first.startswith(("{", "[")):
            return True
        readable = self.first.isprintable() or "\t" in self.first
        return readable and not self.columns and _NAME.search(self.first) is not None

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """[R, columns] numbers of the first rows, as far as they are numbers and equally many."""
        found: list[list[float]] = []
        for line in self.lines:
            try:
                row = [number(field) for field in split_row(line)]
            except ValueError:
                break
            if found and len(row) != len(found[0]):
                break
            found.append(row)
        return np.array(found) if found else np.zeros((0, 0))

    @property
    def columns(self) -> int:
        """How many numbers the first row has; 0 where it has anything else."""
        return self.rows.shape[1]


def read_head(path: Path) -> Head:
    """How `path` begins.

    Raises:
        InputError: if it cannot be read.
    """
    lines: list[str] = []
    # What is wrong with the content is said by the reader, which knows more of it.
    with contextlib.suppress(NotText):
        lines = next(read_pieces(path, _HEAD), [])
    told = (line[:_HEAD].strip() for line in lines if line.split("#")[0].strip())
    return Head(tuple(told), "\n".join(lines)[:_HEAD])


def separator_of(line: str) -> str | None:
    """What stands between the fields of a row: a semicolon, else a comma, else blanks (None)."""
    return next((mark for mark in ";," if mark in line), None)


def split_row(line: str) -> list[str]:
    """The fields of a row of numbers; a separator at its end adds none, `#` begins a comment."""
    line = line.split("#")[0].strip()
    mark = separator_of(line)
    if mark is None:
        return line.split()
    return [field.strip() for field in line.removesuffix(mark).split(mark)]


def number(value: Any) -> float:
    """A number of a table, written as programs write numbers.

    Raises:
        ValueError: for anything else: true, 1_000, 1,5.
    """
    if isinstance(value, bool) or (isinstance(value, str) and "_" in value):
        raise ValueError(f"{value!r} is not a number")
    return float(value)


def read_number(path: Path, row: int, field: str) -> float:
    """The number in a field of row `row` of a file.

    Raises:
        InputError: naming file, row and field, for anything else.
    """
    try:
        return number(field)
    except ValueError:
        raise InputError(f"{path}: row {row}: {field[:60]!r} is not a number") from None


class JsonNumber(str):
    """A number in JSON as it is written, where it is no whole one: 1.0 and 1e0 stay different."""


def decode_json(text: str) -> Any:
    """The value of a JSON text; of numbers that are not whole, their text.

    Raises:
        ValueError: for what is not strict JSON, or has a key twice in one object.
    """
    try:
        return _DECODER.decode(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = dict(pairs)
    if len(keys) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"the key {twice[:40]!r} is there twice")
    return keys


def _constant(name: str) -> Any:
    raise ValueError(f"{name} is not a number in JSON")


_DECODER = json.JSONDecoder(
    object_pairs_hook=_object, parse_float=JsonNumber, parse_constant=_constant
)
