"""How files are read: what a user says of them, what a format is, and what a reading reports."""

import dataclasses
import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from neurosym_jax.errors import InputError, printable

if TYPE_CHECKING:
    from neurosym_jax.data.text import Head
    from neurosym_jax.data.tracks import Tracks

__all__ = ["AS_IT_SAYS", "METRES", "Format", "ReadOptions", "Reading", "describe_readings"]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""Metres in each unit."""


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """What files do not say themselves. An option that a format does not use is refused."""

    format: str | None = None
    """Format of the files, NAME or NAME,OPTION=VALUE,...; default: detected from the content."""
    columns: tuple[str, ...] = ()
    """Columns of a table by name or number (from 1): time=t id=person x=px y=py, or frame=...;
    any other NAME=column is kept as an extra of each agent, as group=g."""
    keep: tuple[str, ...] = ()
    """Values of a table's column of kinds (label, class, type) that are people."""
    unit: str | None = None
    """Unit of the coordinates, where the format does not fix it: m (default), cm, mm, or metres as
    a number, such as 0.032 for pixels of 3.2 cm."""
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    """Unit of a table's times; default: the one in the column's name (`t_ms`), else seconds."""
    fps: float | None = None
    """Frames per second, where frames are numbered."""
    stride: float | None = None
    """Frame numbers per 0.4 s, instead of fps; default: their most common step."""
    eth_stride: float | None = None
    """Stride of files called biwi_eth* only: 6 gives the true time of SGAN's eth, whose frames are
    10 apart in a video of 15 frames per second. Published numbers use the wrong one."""
    max_gap: float = 1.0
    """Longest gap in a person's track that is filled by interpolation, seconds."""
    yes_really: bool = False
    """Accept recordings in which people move as no people do; the reasons become warnings."""

    def given(self) -> list[str]:
        """Names of the options that are set and that some formats do not use."""
        names = {"columns", "keep", "unit", "time_unit", "fps", "stride"}
        return sorted(name for name in names if getattr(self, name) != getattr(AS_IT_SAYS, name))

    def stride_of(self, path: Path, period: float) -> float | None:
        """Frame numbers in `period` seconds in this file; None for their most common step.

        Raises:
            InputError: if both fps and stride are given.
        """
        if self.fps is not None and self.stride is not None:
            raise InputError(f"{path}: --fps and --stride say the same: give one of them")
        if self.eth_stride is not None and path.stem.startswith("biwi_eth"):
            return self.eth_stride
        return self.stride if self.fps is None else self.fps * period

    def metres(self, path: Path) -> float:
        """Metres in a unit of the coordinates.

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


AS_IT_SAYS = ReadOptions()
"""No option is set: everything is taken from the files."""


@dataclasses.dataclass(frozen=True)
class Format:
    """A format of files. A subclass with these attributes and methods is registered by name; its
    fields, if any, are options that only this format has."""

    title: ClassVar[str] = ""
    """What messages call it."""
    uses: ClassVar[frozenset[str]] = frozenset()
    """The fields of `ReadOptions` that it uses."""
    general: ClassVar[bool] = False
    """Whether it is asked only if no other format knows the file."""
    reader: ClassVar[str] = ""
    """`module:function` that reads a file, imported when it does."""

    def knows(self, head: "Head") -> bool:
        """Whether a file that begins so is of this format."""
        return False

    def owns(self, path: Path) -> bool:
        """Whether a path is of this format by its name alone; it may be a folder."""
        return False

    def lacks_tracks(self, head: "Head") -> bool:
        """Whether a file of this format holds something else, so that folders are read without."""
        return False

    def read(self, path: Path, options: ReadOptions, period: float) -> "list[Tracks]":
        """The recordings in a file; where frames are numbered, one step is `period` seconds.

        Raises:
            InputError: naming file, row and reason.
        """
        module, _, function = self.reader.partition(":")
        found = getattr(importlib.import_module(module), function)(path, options, period)
        return found if isinstance(found, list) else [found]


@dataclasses.dataclass(frozen=True)
class Reading:
    """How a recording was read; people, model cards and JSON reports show it."""

    recording: str
    file: str | None = None
    """Path of the file; None for recordings that come from none."""
    format: str | None = None
    """Name of the file's format."""
    rows: int = 0
    """Rows, or points, that were read."""
    skipped: int = 0
    """Rows that are no observation of a person."""
    frame_step: float | None = None
    """Frame numbers that were assumed to be one step, where the user did not give the rate."""
    filled: int = 0
    """Points that were interpolated in gaps of single people's tracks."""
    runs: int = 1
    """Parts between gaps in time, once windows are cut; windows do not cross gaps."""
    gaps: int = 0
    """Gaps in time between the runs."""
    warnings: tuple[str, ...] = ()
    """What looks wrong, a line each."""

    def to_json(self) -> dict[str, Any]:
        """The fields by name."""
        return {**dataclasses.asdict(self), "warnings": list(self.warnings)}


def describe_readings(readings: Iterable[Reading]) -> str:
    """A line for each recording read from a file: format, rows, gaps and what was filled."""
    lines = []
    for how in {(how.file, how.recording): how for how in readings if how.file}.values():
        parts = [f"{how.format}, {how.rows} rows"]
        parts += [f"{how.skipped} left out"] * (how.skipped > 0)
        parts += [f"{how.filled} points filled in gaps"] * (how.filled > 0)
        parts += [f"{how.gaps} gaps in time between {how.runs} runs"] * (how.gaps > 0)
        lines.append(f"read {printable(how.recording)}: {', '.join(parts)}")
    return "\n".join(lines)
