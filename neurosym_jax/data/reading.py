"""How files are read: what a user says of them, how they begin, and what a format is."""

import abc
import codecs
import contextlib
import dataclasses
import functools
import itertools
import stat
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from neurosym_jax.configuration import NotNegative, Positive, refuse
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["AS_IT_SAYS", "Format", "Head", "ReadOptions", "numbers_in", "read_head"]
__all__ += ["read_text_file", "separator_of"]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # in each unit


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """What files do not say themselves. An option that a format does not use is refused."""

    format: str | None = None
    """Format of the files, NAME or NAME,OPTION=VALUE,...; default: detected from the content."""
    columns: tuple[str, ...] = ()
    """Columns of a table by name or number (from 1): time=t id=person x=px y=py, or frame=...;
    any other NAME=column is kept as an extra of each agent, as group=g."""
    unit: str | None = None
    """Unit of the coordinates, where the format does not fix it: m (default), cm, mm, or metres as
    a number, such as 0.032 for pixels of 3.2 cm."""
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    """Unit of a table's times; default: seconds."""
    keep: tuple[str, ...] = ()
    """Kinds of rows that are people, where a table's column label, class, type, category, ... says
    what each row is; default: person, pedestrian, human, adult, ...; others are left out."""
    fps: float | None = None
    """Frames per second, where frames are numbered; default: their most common step is 0.4 s."""
    eth_stride: float | None = None
    """Frames per 0.4 s of files called biwi_eth* only: 6 gives the true time of SGAN's eth, whose
    frames are 10 apart in a video of 15 frames per second. Published numbers use the wrong one."""
    max_gap: float = 1.0
    """Longest gap in a person's track that is filled by interpolation, seconds."""
    yes_really: bool = False
    """Accept recordings in which people move as no people do; the reasons become warnings."""

    def __post_init__(self):
        """Check the numbers and the unit.

        Raises:
            InputError: naming the option.
        """
        refuse(Positive, {"--fps": self.fps, "--eth-stride": self.eth_stride}, optional=True)
        refuse(NotNegative, {"--max-gap": self.max_gap}, optional=True)
        with contextlib.suppress(ValueError):
            if 1e-6 <= self.metres <= 1e4:
                return
        raise InputError(
            f"--unit is one of {', '.join(METRES)}, or metres as a number, not {self.unit!r} "
            "(pixels of 3.2 cm: --unit 0.032)"
        )

    @property
    def metres(self) -> float:
        """Metres in a unit of the coordinates."""
        unit = self.unit or "m"
        return METRES.get(unit) or float(unit)


AS_IT_SAYS = ReadOptions()  # everything is taken from the files


@dataclasses.dataclass(frozen=True)
class Head:
    """How a file begins; formats are recognised by it."""

    lines: list[str]  # its first 64 kB without blank lines and comments; one empty line if not text

    @property
    def names(self) -> list[str]:
        """The fields of a header line; none if the file begins otherwise."""
        first = self.lines[0]
        names = [name.strip(' "') for name in first.split(separator_of(first))]
        named = any(name[:1].isalpha() for name in names) and not numbers_in(first)
        return names if named and first.replace("\t", "").isprintable() else []

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """[R, columns] numbers of the first lines, up to the first line of another kind."""
        width = len(numbers_in(self.lines[0]))
        rows = map(numbers_in, self.lines)
        alike = list(itertools.takewhile(lambda row: row and len(row) == width, rows))
        return np.array(alike).reshape(len(alike), width)


@dataclasses.dataclass(frozen=True)
class Format(abc.ABC):
    """A format of files. A subclass with these attributes and methods is registered by name; its
    fields, if any, are options that only this format has."""

    title: ClassVar[str] = ""  # what messages call it
    uses: ClassVar[frozenset[str]] = frozenset()  # the fields of `ReadOptions` that it uses

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


def read_head(path: Path) -> Head:
    """How the file at `path` begins."""
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(_bytes_of(path, 1 << 16))
    except UnicodeDecodeError:  # The reader explains it; here it only fits no format.
        text = ""
    lines = (line.strip() for line in text.split("\n"))
    return Head([line for line in lines if line and not line.startswith("#")] or [""])


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
