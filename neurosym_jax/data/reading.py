"""How files are read: what a user says of them, what a format is, and what a reading reports."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from neurosym_jax.configuration import Positive, refuse
from neurosym_jax.errors import InputError, printable

if TYPE_CHECKING:
    from neurosym_jax.data.text import Head
    from neurosym_jax.data.tracks import Tracks

__all__ = ["AS_IT_SAYS", "METRES", "Format", "ReadOptions", "Reading", "describe_readings"]

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

    def stride_of(self, path: Path, period: float) -> float | None:
        """Frame numbers in `period` seconds in this file; None for their most common step."""
        refuse(Positive, {"--fps": self.fps, "--eth-stride": self.eth_stride})
        if self.eth_stride is not None and path.stem.startswith("biwi_eth"):
            return self.eth_stride
        return None if self.fps is None else self.fps * period

    def metres(self, path: Path) -> float:
        """Metres in a unit of the coordinates of file `path`.

        Raises:
            InputError: for an unknown unit.
        """
        unit = self.unit or "m"
        try:
            found = METRES.get(unit) or float(unit)
        except ValueError:
            found = 0.0
        if not 1e-6 <= found <= 1e4:
            raise InputError(
                f"{path}: the unit is one of {', '.join(METRES)}, or metres as a number, not "
                f"{unit!r} (pixels of 3.2 cm: --unit 0.032)"
            )
        return found


AS_IT_SAYS = ReadOptions()  # everything is taken from the files


@dataclasses.dataclass(frozen=True)
class Format:
    """A format of files. A subclass with these attributes and methods is registered by name; its
    fields, if any, are options that only this format has."""

    title: ClassVar[str] = ""  # what messages call it
    uses: ClassVar[frozenset[str]] = frozenset()  # the fields of `ReadOptions` that it uses

    def knows(self, head: "Head") -> bool:
        """Whether a file that begins so is of this format."""
        return False

    def owns(self, path: Path) -> bool:
        """Whether a path is of this format by its name alone; it may be a folder."""
        return False

    def read(self, path: Path, options: ReadOptions, period: float) -> "list[Tracks]":
        """The recordings in a file; where frames are numbered, one step is `period` seconds."""
        raise NotImplementedError


@dataclasses.dataclass(frozen=True)
class Reading:
    """How a recording was read; people, model cards and JSON reports show it."""

    recording: str
    file: str | None = None  # path, if there is a file
    format: str | None = None  # name of the file's format
    rows: int = 0  # points that were read
    filled: int = 0  # points that were interpolated in gaps of single people's tracks
    gaps: int = 0  # gaps in time, once windows are cut; windows do not cross them
    warnings: tuple[str, ...] = ()  # what looks wrong, a line each

    def to_json(self) -> dict[str, Any]:
        """The fields by name."""
        return dataclasses.asdict(self) | {"warnings": list(self.warnings)}


def describe_readings(readings: Iterable[Reading]) -> str:
    """A line for each recording read from a file: format, rows, gaps and what was filled."""
    lines = []
    for how in {(how.file, how.recording): how for how in readings if how.file}.values():
        parts = [f"{how.format}, {how.rows} rows"]
        parts += [f"{how.filled} points filled in gaps"] * (how.filled > 0)
        parts += [f"{how.gaps} gaps in time"] * (how.gaps > 0)
        lines.append(f"read {printable(how.recording)}: {', '.join(parts)}")
    return "\n".join(lines)
