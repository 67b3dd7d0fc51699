"""Text files of `frame ped x y`, ETH's obsmat, and the leave-one-out splits of ETH/UCY.

The folder of ETH/UCY as SGAN arranges it has `all/` (whole recordings, for testing), `train/` and
`val/`.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.rows import assemble, consecutive, frame_step
from neurosym_jax.data.tables import Table, read_table
from neurosym_jax.data.tracks import PERIOD, Tracks
from neurosym_jax.errors import InputError

__all__ = [
    "SCENES",
    "is_eth_ucy",
    "read_obsmat",
    "read_split",
    "read_text",
    "refuse_swapped",
    "split_files",
    "text_files",
]

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


def read_text(
    path: Path, period: float = PERIOD, stride: float | None = None, metres: float = 1.0
) -> Tracks:
    """Read rows `frame ped x y` (separated by commas, semicolons, or tabs and blanks).

    As in SGAN, the most common step between consecutive frame numbers is taken for `period`
    seconds, whatever the numbers count. For the eth recording this is wrong: its frames are 10
    apart in a video of 15 frames per second, which is 0.67 s. With `stride=6`, 6 frame numbers are
    one period, and the steps of that file are 10/6 periods long.

    Args:
        path: of the file.
        period: seconds.
        stride: frame numbers per period; default: their most common step.
        metres: in a unit of the coordinates.

    Raises:
        InputError: naming file, row and reason.
    """
    table = read_table(path, ("frame", "ped", "x", "y"))
    return _numbered(table, table.numbers(2, 3) * metres, period, stride)


def read_obsmat(path: Path, period: float = PERIOD, stride: float | None = None) -> Tracks:
    """Read an `obsmat.txt` of ETH, rows `frame id x z y vx vz vy`, otherwise as `read_text`.

    There the frames of both recordings are 0.4 s apart: 6 numbers at 15 frames per second in eth,
    10 at 25 in hotel.

    Raises:
        InputError: naming file, row and reason.
    """
    table = read_table(path, ("frame", "id", "x", "z", "y", "vx", "vz", "vy"))
    return _numbered(table, table.numbers(*range(2, 8))[:, [0, 2]], period, stride)


def _numbered(table: Table, metres: np.ndarray, period: float, stride: float | None) -> Tracks:
    frame = table.whole_numbers(0)
    table.whole_numbers(1)
    step = frame_step(table.path, frame, stride)
    return assemble(
        table.path,
        frame / step * period,
        table.ids(1),
        np.round(metres, DECIMALS),
        frame_step=step if stride is None else None,
    )


def refuse_swapped(path: Path, tracks: Tracks) -> None:
    """Refuse tracks whose ids would make far smoother times than their stamps, and vice versa.

    Raises:
        InputError: with the options that settle the order of the columns.
    """
    paces = []
    for times, ids in ((tracks.stamp, tracks.id), (tracks.id, tracks.stamp)):
        before, after = consecutive(times, ids)
        moved = np.linalg.norm(tracks.position[after] - tracks.position[before], axis=1)
        paces.append(np.median(moved) if len(moved) > _PAIRS else np.nan)
    if paces[1] < paces[0] / 3:
        raise InputError(
            f"{path}: its rows look like `ped frame x y`: say --columns frame=2 id=1 x=3 y=4, or "
            "--format text where they are `frame ped x y` all the same"
        )


def is_eth_ucy(folder: Path) -> bool:
    """Whether `folder` is arranged as SGAN's ETH/UCY: whole recordings in `all/`."""
    return (folder / "all").is_dir()


def split_files(folder: Path, scene: str, split: str) -> list[Path]:
    """Files of one leave-one-out split.

    Args:
        folder: holds `all/`, `train/` and `val/`.
        scene: the data set left out of training, a key of `SCENES`.
        split: `test` (its whole recordings), `train` or `val` (parts of all others).

    Raises:
        InputError: for an unknown data set or missing files.
    """
    if scene not in SCENES:
        raise InputError(f"unknown scene {scene!r}: ETH/UCY has {', '.join(SCENES)}")
    if split == "test":
        paths = [folder / "all" / f"{name}.txt" for name in SCENES[scene]]
        missing = [path for path in paths if not path.is_file()]
        if missing:
            raise InputError(f"{missing[0]}: missing, and scene {scene} needs it")
        return paths
    held_out = {f"{name}_{split}.txt" for name in SCENES[scene]}
    return [path for path in text_files(folder / split) if path.name not in held_out]


def read_split(folder: Path, scene: str, split: str) -> list[Tracks]:
    """Recordings of one split, see `split_files`, as SGAN reads them.

    Raises:
        InputError: for files that are missing or cannot be read.
    """
    return [read_text(path) for path in split_files(folder, scene, split)]


def text_files(folder: Path) -> list[Path]:
    """Every `.txt` and `.csv` file of a folder, in order of name; at least one.

    Raises:
        InputError: if there is none.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such file or folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix in {".txt", ".csv"})
    if not paths:
        raise InputError(f"{folder}: no .txt or .csv file in it")
    return paths
