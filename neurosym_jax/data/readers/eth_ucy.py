"""Text files of `frame ped x y`, ETH's obsmat, and the leave-one-out splits of ETH/UCY.

The folder of ETH/UCY as SGAN arranges it has `all/` (whole recordings, for testing), `train/` and
`val/`.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.rows import assemble, consecutive, frame_step
from neurosym_jax.data.tables import Table, read_table
from neurosym_jax.data.tracks import PERIOD, Tracks
from neurosym_jax.errors import InputError

__all__ = ["SCENES", "read_obsmat", "read_split", "read_text", "split_files"]

SCENES = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""The recordings that each of the benchmark's five data sets tests on."""

DECIMALS = 4
"""SGAN rounds coordinates to this many decimals."""

_PAIRS = 20  # steps that are enough to tell the order of two columns


def read_text(path: Path, options: ReadOptions = AS_IT_SAYS, period: float = PERIOD) -> Tracks:
    """Read rows `frame ped x y` (separated by commas, semicolons, or tabs and blanks).

    As in SGAN, the most common step between consecutive frame numbers is taken for `period`
    seconds, if it is a usual one. For the eth recording this is wrong: its frames are 10 apart in a
    video of 15 frames per second, which is 0.67 s. With `stride=6`, 6 frame numbers are one period,
    and the steps of that file are 10/6 periods long.

    Raises:
        InputError: naming file, row and reason.
    """
    table = read_table(path, ("frame", "ped", "x", "y"))
    metres = table.numbers(2, 3) * options.metres(path)
    if options.format is None:
        frame, ped = table.numbers(0, 1).T
        _refuse_swapped(path, frame, ped, metres)
    return _numbered(table, metres, options, period)


def read_obsmat(path: Path, options: ReadOptions = AS_IT_SAYS, period: float = PERIOD) -> Tracks:
    """Read an `obsmat.txt` of ETH, rows `frame id x z y vx vz vy`, otherwise as `read_text`.

    There the frames of both recordings are 0.4 s apart: 6 numbers at 15 frames per second in eth,
    10 at 25 in hotel.

    Raises:
        InputError: naming file, row and reason.
    """
    table = read_table(path, ("frame", "id", "x", "z", "y", "vx", "vz", "vy"))
    return _numbered(table, table.numbers(*range(2, 8))[:, [0, 2]], options, period)


def _numbered(table: Table, metres: np.ndarray, options: ReadOptions, period: float) -> Tracks:
    frame = table.whole_numbers(0)
    table.whole_numbers(1)
    stride = options.stride_of(table.path, period)
    step = frame_step(table.path, frame, stride)
    return assemble(
        table.path,
        frame / step * period,
        table.ids(1),
        np.round(metres, DECIMALS),
        frame_step=step if stride is None else None,
    )


def _refuse_swapped(path: Path, frame: np.ndarray, ped: np.ndarray, metres: np.ndarray) -> None:
    """Refuse rows whose second column would make far smoother times than the first."""
    paces = []
    for times, ids in ((frame, ped), (ped, frame)):
        before, after = consecutive(times, ids)
        moved = np.linalg.norm(metres[after] - metres[before], axis=1)
        paces.append(np.median(moved) if len(moved) > _PAIRS else np.nan)
    if paces[1] < paces[0] / 3:
        raise InputError(
            f"{path}: its rows look like `ped frame x y`: say --columns frame=2 id=1 x=3 y=4, or "
            "--format text where they are `frame ped x y` all the same"
        )


def split_files(folder: Path, scene: str | None, split: str) -> list[Path]:
    """Files of one leave-one-out split.

    Args:
        folder: holds `all/`, `train/` and `val/`.
        scene: the data set left out of training, a key of `SCENES`; None leaves out none.
        split: `test` (its whole recordings), `train` or `val` (parts of all others).

    Raises:
        InputError: for an unknown data set or missing files.
    """
    if scene is not None and scene not in SCENES:
        raise InputError(f"unknown scene {scene!r}: ETH/UCY has {', '.join(SCENES)}")
    own = SCENES[scene] if scene else ()
    if split == "test":
        paths = [folder / "all" / f"{name}.txt" for name in own]
        missing = [path for path in paths if not path.is_file()]
        if missing:
            raise InputError(f"{missing[0]}: missing, and scene {scene} needs it")
        return paths
    held_out = {f"{name}_{split}" for name in own}
    paths = sorted((folder / split).glob("*.txt")) + sorted((folder / split).glob("*.csv"))
    if not paths:
        raise InputError(f"{folder / split}: no .txt or .csv file in it")
    return [path for path in paths if path.stem not in held_out]


def read_split(folder: Path, scene: str, split: str) -> list[Tracks]:
    """Recordings of one split, see `split_files`, as SGAN reads them.

    Raises:
        InputError: for files that are missing or cannot be read.
    """
    return [read_text(path) for path in split_files(folder, scene, split)]
