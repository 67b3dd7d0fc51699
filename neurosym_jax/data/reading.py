"""What a user says of files that do not say it themselves; `formats.read_any` reads by it."""

import dataclasses
from pathlib import Path
from typing import Literal

from neurosym_jax.errors import InputError

__all__ = ["AS_IT_SAYS", "ReadOptions", "Unit"]

Unit = Literal["m", "cm", "mm"]

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """What files do not say themselves."""

    columns: tuple[str, ...] = ()
    """Names of a table's columns: time=t id=person x=px y=py (or frame=...)."""
    unit: Unit = "m"
    """Unit of the coordinates, where the format does not fix it."""
    stride: float | None = None
    """Frame numbers in 0.4 s, where frames are numbered; their most common step if not given."""
    eth_stride: float | None = None
    """The same for files called biwi_eth* alone: 6 gives the true time of SGAN's eth, whose frames
    are 10 apart in a video of 15 a second. Published numbers rest on the wrong one."""

    def stride_of(self, path: Path) -> float | None:
        """Frame numbers in 0.4 s in this file; None if its frames are to tell."""
        own = self.eth_stride if path.stem.startswith("biwi_eth") else None
        return self.stride if own is None else own

    def metres(self, path: Path) -> float:
        """Metres in a unit."""
        if self.unit not in _METRES:
            raise InputError(f"{path}: the unit is one of {', '.join(_METRES)}, not {self.unit!r}")
        return _METRES[self.unit]


AS_IT_SAYS = ReadOptions()
"""Nothing is said of a file that it does not say itself."""
