"""What a format of files is."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.text import Head
from neurosym_jax.data.tracks import Tracks

__all__ = ["Format"]


def _never(head: Head) -> bool:
    return False


def _nowhere(path: Path) -> bool:
    return False


@dataclasses.dataclass(frozen=True)
class Format:
    """One format."""

    text: str
    """What it is, for people."""
    knows: Callable[[Head], bool]
    """Whether a file that begins so is of it."""
    read: Callable[[Path, ReadOptions, float], list[Tracks]]
    """Its recordings; the number is the seconds that one step of frame numbers stands for."""
    uses: frozenset[str] = frozenset()
    """The fields of `ReadOptions` that it goes by, of columns, unit, time_unit, fps, stride and
    topic."""
    general: bool = False
    """Whether it is asked only where no other format knows the file."""
    other: Callable[[Head], bool] = _never
    """Whether a file that it knows holds no tracks, so that a folder is read without it."""
    owns: Callable[[Path], bool] = _nowhere
    """Whether a path is of it by its name alone, as what is no text; a folder is then one file."""
