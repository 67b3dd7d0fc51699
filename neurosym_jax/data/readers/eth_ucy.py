"""Text files of `frame ped x y`, ETH's obsmat, and the leave-one-out splits of ETH/UCY.

As SGAN arranges it, the folder has `all/` (whole recordings, for testing), `train/` and `val/`.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.reading import Format, Head, ReadOptions
from neurosym_jax.data.table import read_table
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["SCENES", "Obsmat", "Text", "split_files"]

SCENES = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""The recordings that each of the benchmark's five data sets tests on."""


class Text(Format):
    """Rows `frame ped x y`, as SGAN arranges ETH/UCY."""

    title = "rows of `frame ped x y`"
    uses = frozenset({"unit", "fps"})
    names = ("frame", "ped", "x", "y")

    def knows(self, head: Head) -> bool:
        """Anything, also binary files, which the reader refuses with the reason."""
        return True

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The rows, with coordinates rounded to four decimals as in SGAN."""
        table = read_table(path, self.names)
        values = table.numbers(*range(len(self.names)))
        metres = values[:, [self.names.index("x"), self.names.index("y")]] * options.metres
        table.whole_numbers(1)
        ids = table.ids(1)
        stamp = table.times(0, ids, options, period)
        return table.tracks(stamp, ids, np.round(metres, 4), clock=0)


class Obsmat(Text):
    """ETH's own rows, of which z and vz are zero; 6 frames are 0.4 s in eth, 10 in hotel."""

    title = "ETH's obsmat (`frame id x z y vx vz vy`)"
    uses = frozenset({"fps"})
    names = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")

    def knows(self, head: Head) -> bool:
        """Eight numbers a row, of which z and vz are zero."""
        return head.rows.shape[1] == 8 and not head.rows[:, [3, 6]].any()


def split_files(folder: Path, scene: str | None, split: str) -> list[Path]:
    """Files of one leave-one-out split: `test` has the whole recordings of the data set `scene`,
    `train` and `val` have parts of all others (None leaves out none).

    Raises:
        InputError: for an unknown data set or missing files.
    """
    if scene is not None and scene not in SCENES:
        raise InputError(f"unknown scene {scene!r}: ETH/UCY has {', '.join(SCENES)}")
    own = SCENES[scene] if scene else ()
    paths = [folder / "all" / f"{name}.txt" for name in own]
    if split != "test":
        held_out = {f"{name}_{split}" for name in own}
        found = sorted((folder / split).glob("*.txt"))
        paths = [path for path in found if path.stem not in held_out]
    missing = [path for path in paths or [folder / split / "*.txt"] if not path.is_file()]
    if missing:
        raise InputError(f"{missing[0]}: missing, and scene {scene} needs it")
    return paths
