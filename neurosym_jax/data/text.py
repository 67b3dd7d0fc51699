"""Files as text, plain or gzip, in pieces of whole lines, and the head that shows the format.

Anything that is not a regular file (opening a pipe would block), not text, or too large is refused
before its content is kept.
"""

import contextlib
import dataclasses
import functools
import gzip
import io
import re
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from neurosym_jax.errors import InputError, printable
from neurosym_jax.runtime.memory import refuse_beyond_memory

__all__ = [
    "Head",
    "numbers_in",
    "read_head",
    "read_lines",
    "read_pieces",
    "recording_name",
    "refuse_irregular",
    "separator_of",
]

LINE = 1 << 24
"""Longest line accepted, characters; a QTM header of 300,000 bodies has a quarter of that."""

UNPACKED = (256_000_000, 10)
"""Characters that a gzip file may hold: at least the first, else the second times its size."""

_HEAD = 1 << 16  # characters that formats are recognised by; a THÖR header has about 10,000
_NAME = re.compile(r"""(?:^|[\s,;])["'(]*[^\W\d]""")
_GROWTH = 12.0  # bytes of memory for each byte of a file, at most


class NotText(InputError):
    """The content of a file is not text."""


def recording_name(path: Path) -> str:
    """Name of the recording in a file: its name without the ending."""
    return printable(Path(path.name.removesuffix(".gz")).stem)


def refuse_irregular(path: Path, growth: float = _GROWTH) -> int:
    """Size in bytes of a regular file that can be read with `growth` times its size of memory.

    Raises:
        InputError: if the file cannot be read, is a folder, pipe, socket or device, or too large.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not stat.S_ISREG(status.st_mode):
        tests = {"folder": stat.S_ISDIR, "pipe": stat.S_ISFIFO, "socket": stat.S_ISSOCK}
        kind = next((name for name, test in tests.items() if test(status.st_mode)), "device")
        raise InputError(f"{path}: is a {kind}, not a file")
    refuse_beyond_memory(f"{path}: reading it", growth * status.st_size, "split it")
    return status.st_size


def read_pieces(path: Path, size: int = 1 << 20) -> Iterator[str]:
    """The text of a UTF-8 file, without byte-order mark, in pieces of whole lines.

    Args:
        path: plain text or gzip.
        size: characters in a piece, apart from the rest of its last line.

    Raises:
        InputError: if the file cannot be read, is not text, or is too large.
    """
    limit = max(UNPACKED[0], UNPACKED[1] * refuse_irregular(path))
    try:
        with path.open("rb") as raw, _unpacked(raw) as file:
            text, total = io.TextIOWrapper(file, encoding="utf-8-sig"), 0
            while piece := text.read(size):
                if "\0" not in piece:
                    rest = text.readline(LINE)
                    if len(rest) >= LINE:
                        raise NotText(f"{path}: not text (a line is longer than {LINE:,})")
                    piece += rest
                if "\0" in piece:
                    raise NotText(f"{path}: not text (it contains zero bytes)")
                total += len(piece)
                if total > limit:
                    raise InputError(f"{path}: unpacks to more than {limit:,} bytes: unpack it")
                yield piece.removesuffix("\n")
    except UnicodeDecodeError as error:
        raise NotText(f"{path}: not text ({error.reason})") from None
    except (EOFError, zlib.error) as error:
        raise InputError(f"{path}: damaged gzip file ({error})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def _unpacked(raw: IO[bytes]) -> contextlib.AbstractContextManager[IO[bytes]]:
    packed = raw.read(2) == b"\x1f\x8b"
    raw.seek(0)
    return gzip.GzipFile(fileobj=raw) if packed else contextlib.nullcontext(raw)  # pyright: ignore


def read_lines(path: Path) -> Iterator[str]:
    """The lines of a file without their ends, see `read_pieces`."""
    for piece in read_pieces(path):
        # str.splitlines would also split at characters that JSON allows inside a text.
        yield from piece.split("\n")


@dataclasses.dataclass(frozen=True)
class Head:
    """How a file begins; formats are recognised by it."""

    text: str
    """Its first lines, comments included; empty if it is not text."""
    magic: bytes = b""
    """Its first eight bytes."""

    @property
    def columnary(self) -> bool:
        """Whether the file is Parquet or Arrow (IPC, Feather)."""
        return self.magic.startswith((b"PAR1", b"ARROW1"))

    @functools.cached_property
    def lines(self) -> list[str]:
        """The first lines that are neither empty nor comments."""
        return [line.strip() for line in self.text.split("\n") if line.split("#", 1)[0].strip()]

    @property
    def first(self) -> str:
        """The first of `lines`; empty if there is none."""
        return next(iter(self.lines), "")

    @property
    def named(self) -> bool:
        """Whether it begins with the names of columns, as a header line or in JSON."""
        if self.first.startswith(("{", "[")):
            return True
        readable = self.first.isprintable() or "\t" in self.first
        return readable and not self.columns and _NAME.search(self.first) is not None

    @functools.cached_property
    def columns(self) -> int:
        """How many numbers the first line has; 0 if it has anything else."""
        return len(numbers_in(self.first))

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """[R, columns] numbers of the first lines, up to the first line of another kind."""
        found: list[list[float]] = []
        for line in self.lines:
            row = numbers_in(line)
            if not row or len(row) != self.columns:
                break
            found.append(row)
        return np.array(found) if found else np.zeros((0, 0))


def read_head(path: Path) -> Head:
    """How `path` begins.

    Raises:
        InputError: if it cannot be read.
    """
    text, magic = "", b""
    # The reader explains why content is not text; here it only fits no format.
    with contextlib.suppress(NotText):
        text = next(read_pieces(path, _HEAD), "")
    with contextlib.suppress(OSError), path.open("rb") as file:
        magic = file.read(8)
    return Head(text, magic)


def separator_of(line: str) -> str | None:
    """What separates the numbers of a row: a semicolon, else a comma, else blanks (None)."""
    return next((mark for mark in ";," if mark in line), None)


def numbers_in(line: str) -> list[float]:
    """The numbers of a row, where a final separator adds none; none if any field is another."""
    line = line.split("#", 1)[0].strip()
    mark = separator_of(line)
    try:
        return [] if "_" in line else [float(f) for f in line.removesuffix(mark or "#").split(mark)]
    except ValueError:
        return []
