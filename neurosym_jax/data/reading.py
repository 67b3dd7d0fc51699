"""How files are read: what a user says of them, how they begin, and what a format is."""

import abc
import codecs
import contextlib
import dataclasses
import functools
import gzip
import itertools
import math
import re
import stat
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from neurosym_jax.configuration import NotNegative, Positive, refuse
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, option

__all__ = [
    "AS_IT_SAYS",
    "GUARDS",
    "Format",
    "Head",
    "ReadOptions",
    "header_in",
    "metres_in",
]
__all__ += ["read_head", "read_text_file", "separator_of"]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # in each unit
GUARDS = {
    # what a recording may be refused for: in words
    "slow": "people move more slowly than people walk",
    "fast": "people move faster than people walk",
    "held": "positions stay and then leap",
    "pixels": "all coordinates are whole numbers",
    "ends": "people stay where their tracks begin or end",
    "origins": "people begin at one place",
    "together": "people begin at one moment",
    "twins": "two people are at one place",
    "near": "people are too near to each other",
    "clock": "two columns, options or files disagree about the clock",
    "scale": "two columns, options or files disagree about the unit",
    "seen": "a model is validated or tested on what it learns from",
}


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """What files do not say themselves. An option that a format does not use is refused."""

    format: str | None = None
    """Format of the files, NAME or NAME,OPTION=VALUE,...; default: detected from the content."""
    columns: tuple[str, ...] = ()
    """Columns of a table by name, or by number from 1: time=t (or frame=3) id=who x=px y=py; boxes
    left top right bottom (or width height), of which the middle of the lower edge is read; lost,
    valid, confidence, which say what is no position; label; vx vy. Any other NAME=column is kept as
    an extra of each agent, as group=g. header=no: the first row is data."""
    unit: str | None = None
    """Unit of the coordinates, where the file does not say it: m (default), cm, mm, or metres as
    a number, such as 0.032 for pixels of 3.2 cm; or one of each recording, gates=0.03,quad=0.04."""
    homography: str | None = None
    """File of 3 x 3 numbers that turn coordinates of a picture (column, row, 1) into metres; with
    FILE,row-column those of (row, column, 1)."""
    flip_y: bool = False
    """Turn y round: for coordinates whose y points down, so that left is counter-clockwise."""
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    """Unit of a table's times; default: seconds."""
    keep: tuple[str, ...] = ()
    """Kinds of rows that are people, where a table's column label, class, type, category, ... says
    what each row is; default: person, pedestrian, human, adult, ...; others are left out."""
    fps: float | str | None = None
    """Frames per second, where frames are numbered; default: their most common step is 0.4 s. Or
    those of each recording, gates=10,quad=25."""
    eth_stride: float | None = None
    """Frames per 0.4 s of files called biwi_eth* only: 6 gives the true time of SGAN's eth, whose
    frames are 10 apart in a video of 15 frames per second. Published numbers use the wrong one."""
    max_gap: float = 1.0
    """Longest gap in a person's track that is filled by interpolation, seconds."""
    allow: tuple[str, ...] = ()
    """Guards to waive by the names that refusals say, such as slow or held; each becomes a
    warning."""

    def __post_init__(self):
        """Check the numbers, the unit and the guards.

        Raises:
            InputError: naming the option.
        """
        refuse(Positive, {option("eth_stride"): self.eth_stride}, optional=True)
        for part in [] if self.fps is None else str(self.fps).split(","):
            if not 0 < _number(part.rpartition("=")[2]) < math.inf:
                raise InputError(f"{option('fps')} must be positive, not {part}")
        refuse(NotNegative, {option("max_gap"): self.max_gap}, optional=True)
        if unknown := [name for name in self.allow if name not in GUARDS]:
            raise InputError(
                f"{option('allow')} is one of {', '.join(GUARDS)}, not {unknown[0]!r}"
            )
        for _, _, unit in (
            part.rpartition("=") for part in (self.unit or "m").split(",")
        ):
            metres = METRES.get(unit, 0.0)
            with contextlib.suppress(ValueError):
                metres = metres or float(unit)
            if not 1e-6 <= metres <= 1e4:
                raise InputError(
                    f"{option('unit')} is one of {', '.join(METRES)}, or metres as a number, not "
                    f"{unit!r} (pixels of 3.2 cm: {option('unit', '0.032')})"
                )

    def unit_of(self, recording: str) -> str | None:
        """The unit that was given for a file's recordings, by the file's name without ending."""
        return _value_of(self.unit or "", recording)

    def fps_of(self, recording: str) -> float | None:
        """The frames per second that were given for a file's recordings, as `unit_of`."""
        rate = _value_of(str(self.fps or ""), recording)
        return None if rate is None else float(rate)


def _value_of(text: str, recording: str) -> str | None:
    """The value of a recording in `VALUE` or `RECORDING=VALUE,...`."""
    values = {
        name: value for name, _, value in (x.rpartition("=") for x in text.split(","))
    }
    return values.get(recording) or values.get("") or None


def metres_in(unit: str) -> float:
    """Metres in a unit of coordinates."""
    return METRES.get(unit) or float(unit)


AS_IT_SAYS = ReadOptions()  # everything is taken from the files


@dataclasses.dataclass(frozen=True)
class Head:
    """How a file begins; formats are recognised by it."""

    lines: list[
        str
    ]  # its first 64 kB without blank lines and comments; one empty line if not text
    magic: bytes = b""  # its first 16 bytes
    comments: tuple[str, ...] = ()  # lines with #, without that

    @functools.cached_property
    def fields(self) -> list[list[str]]:
        """The fields of the first 50 lines."""
        mark = separator_of(self.lines[0])
        lines = self.lines[:50]
        return [
            [
                field.strip(' "')
                for field in (line.split(mark) if mark != " " else line.split())
            ]
            for line in lines
        ]

    @property
    def names(self) -> list[str]:
        """The fields of a header line; none if the file begins otherwise."""
        first = self.lines[0].replace("\t", "")
        named = header_in(self.fields) and any(
            name[:1].isalpha() for name in self.fields[0]
        )
        return self.fields[0] if named and first.isprintable() else []

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """[R, columns] numbers of the first lines, up to one of another width; NaN where a field is
        none."""
        width = len(self.fields[0])
        rows = [
            list(map(_number, row))
            for row in itertools.takewhile(lambda row: len(row) == width, self.fields)
        ]
        return np.array(rows).reshape(len(rows), width)


def _number(field: str) -> float:
    try:
        return float(field.replace(",", "."))
    except ValueError:
        return math.nan


def header_in(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first of some rows of fields has names: no number where others have numbers.

    Names stand in no column of text, so a text beside numbers is data.
    """
    first, *others = rows
    is_number = [bool(_NUMBER.fullmatch(field)) for field in first]
    columns = range(len(first))
    numeric = [
        at
        for at in columns
        if sum(at < len(row) and bool(_NUMBER.fullmatch(row[at])) for row in others) * 2
        > len(others)
    ]
    return not any(is_number[at] for at in numeric or columns) and any(first)


_NUMBER = re.compile(
    r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE
)


@dataclasses.dataclass(frozen=True)
class Format(abc.ABC):
    """A format of files. A subclass with these attributes and methods is registered by name; its
    fields, if any, are options that only this format has."""

    title: ClassVar[str] = ""  # what messages call it
    uses: ClassVar[frozenset[str]] = (
        frozenset()
    )  # the fields of `ReadOptions` that it uses

    def knows(self, head: Head) -> bool:
        """Whether a file that begins so is of this format."""
        return False

    def owns(self, path: Path) -> bool:
        """Whether a path is of this format by its name alone; it may be a folder."""
        return False

    @abc.abstractmethod
    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in a file; where frames are numbered, one step is `period` seconds."""


def read_text_file(path: Path) -> str:
    """The text of a UTF-8 file, without byte-order mark.

    Raises:
        InputError: if the file cannot be read or is not text.
    """
    try:
        return _bytes_of(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: not text in UTF-8 ({error.reason}): save it so"
        ) from None


def _bytes_of(path: Path, size: int = -1) -> bytes:
    """The first `size` bytes of a regular file."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # Opening a pipe would block.
            raise InputError(f"{path}: is a folder, pipe or device, not a file")
        with path.open("rb") as file:
            if file.read(2) == b"\x1f\x8b":
                return gzip.open(path).read(size)
            file.seek(0)
            return file.read(size)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(
            f"{path}: cannot be read ({getattr(error, 'strerror', 0) or error})"
        ) from None


def read_head(path: Path) -> Head:
    """How the file at `path` begins."""
    content = _bytes_of(path, 1 << 16)
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(content)
    except UnicodeDecodeError:  # The reader explains it; here it only fits no format.
        text = ""
    lines = [line.strip() for line in text.split("\n")]
    comments = tuple(line.strip("# ") for line in lines if line.startswith("#"))
    lines = [line for line in lines if line and not line.startswith("#")]
    return Head(lines or [""], content[:16], comments)


def separator_of(line: str) -> str:
    """What separates the fields of a line: semicolons, tabs or commas, else blanks."""
    mark = max(";,\t", key=line.count)
    if mark == "," and (other := next((m for m in ";\t" if line.count(m) > 1), "")):
        mark = other  # The commas are decimal.
    return mark if mark in line else " "
