"""What a user says of files that do not say it themselves, and how a file was read in the end."""

import dataclasses
from pathlib import Path
from typing import Literal

from neurosym_jax.data.tracks import PERIOD
from neurosym_jax.errors import InputError

__all__ = ["AS_IT_SAYS", "METRES", "ReadOptions", "TimeUnit", "Unit"]

Unit = Literal["m", "cm", "mm"]
TimeUnit = Literal["s", "ms", "us", "ns"]

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}
"""In each unit."""


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """What files do not say themselves; what a file's format has no use for is refused."""

    format: str | None = None
    """Format of the files, see docs/data.md; by default their content tells."""
    columns: tuple[str, ...] = ()
    """Names of a table's columns, or their numbers from 1: time=t id=person x=px y=py (or
    frame=...)."""
    unit: Unit = "m"
    """Unit of the coordinates, where the format does not fix it."""
    time_unit: TimeUnit | None = None
    """Unit of a table's times; by default what the column's name says (`t_ms`), else seconds."""
    fps: float | None = None
    """Frame numbers in a second, where frames are numbered."""
    stride: float | None = None
    """The same as frame numbers in 0.4 s; their most common step if neither is given."""
    eth_stride: float | None = None
    """The same for files called biwi_eth* alone: 6 gives the true time of SGAN's eth, whose frames
    are 10 apart in a video of 15 a second. Published numbers rest on the wrong one."""
    topic: str | None = None
    """Of the people in a bag; found by itself where there is only one."""

    def given(self) -> list[str]:
        """The options that say something, `format` and `eth_stride` not counted."""
        silent = ReadOptions()
        names = ("columns", "unit", "time_unit", "fps", "stride", "topic")
        return [name for name in names if getattr(self, name) != getattr(silent, name)]

    def stride_of(self, path: Path, period: float = PERIOD) -> float | None:
        """Frame numbers in `period` seconds in this file; None if its frames are to tell.

        Raises:
            InputError: for two answers.
        """
        if self.fps is not None and self.stride is not None:
            raise InputError(f"{path}: --fps and --stride say the same: give one of them")
        own = self.eth_stride if path.stem.startswith("biwi_eth") else None
        if own is not None:
            return own
        return self.stride if self.fps is None else self.fps * period

    def metres(self, path: Path) -> float:
        """Metres in a unit of coordinates.

        Raises:
            InputError: for a unit that is not known.
        """
        if self.unit not in METRES:
            raise InputError(f"{path}: the unit is one of {', '.join(METRES)}, not {self.unit!r}")
        return METRES[self.unit]


AS_IT_SAYS = ReadOptions()
"""Nothing is said of a file that it does not say itself."""
