"""Text files of `frame ped x y`, and the ETH/UCY leave-one-out splits made of them.

Any such file is user data, whatever its delimiter. The folder of ETH/UCY as SGAN arranges it has
`all/` (whole recordings, for testing), `train/` and `val/`. Choosing windows is not done here.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.readers.rows import FAR, frame_step, load_text, number_table, refuse_repeats
from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.errors import InputError

__all__ = [
    "PERIOD",
    "SCENES",
    "is_eth_ucy",
    "read_obsmat",
    "read_split",
    "read_text",
    "split_files",
    "text_files",
    "whole_frames",
]

PERIOD = 0.4
"""Seconds between consecutive frames of the benchmark."""

SCENES = {
    "eth": ("biwi_eth",),
    "hotel": ("biwi_hotel",),
    "univ": ("students001", "students003"),
    "zara1": ("crowds_zara01",),
    "zara2": ("crowds_zara02",),
}
"""Recordings that each of the benchmark's five scenes tests on."""

NAMES = ("frame", "ped", "x", "y")
OBSMAT = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")

DECIMALS = 4
"""SGAN rounds coordinates to this many decimals."""


def read_text(path: Path, period: float = PERIOD, stride: float | None = None) -> Tracks:
    """Read one file of rows `frame ped x y` (tab, space, comma or semicolon between them).

    Frames are taken to be `period` seconds apart, whatever the numbers count in: the most common
    step between consecutive frame numbers is one period. That is SGAN's reading, and for the eth
    recording a trap: its frames are 10 numbers apart in a video of 15 a second, so 0.67 s. With
    `stride=6`, 6 numbers are one period, and the steps of that file become 10/6 periods long.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    rows = number_table(path, load_text(path), NAMES)
    return whole_frames(path, rows, (2, 3), period, stride)


def read_obsmat(path: Path, period: float = PERIOD, stride: float | None = None) -> Tracks:
    """Read an `obsmat.txt` of ETH's own: rows `frame id x z y vx vz vy`, as `read_text` otherwise.

    There the frames of both recordings are 0.4 s apart: 6 numbers at 15 a second in eth, 10 at 25
    in hotel.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    rows = number_table(path, load_text(path), OBSMAT)
    return whole_frames(path, rows, (2, 4), period, stride)


def whole_frames(
    path: Path, rows: np.ndarray, xy: tuple[int, int], period: float, stride: float | None
) -> Tracks:
    """Tracks of rows whose columns 0 and 1 are frame and agent and whose columns `xy` metres.

    Raises:
        InputError: naming file, row and reason.
    """
    refuse_repeats(path, rows[:, 0], rows[:, 1], NAMES[:2])
    for column, name in ((0, "frame"), (1, "ped")):
        fraction = np.flatnonzero(rows[:, column] != np.round(rows[:, column]))
        if len(fraction):
            raise InputError(
                f"{path}: row {fraction[0] + 1}: {name} {rows[fraction[0], column]} is not whole"
            )
    for columns, limit in (([0, 1], 2.0**53), (list(xy), FAR)):
        row, column = np.nonzero(np.abs(rows[:, columns]) > limit)
        if len(row):
            value = rows[row[0], columns][column[0]]
            raise InputError(f"{path}: row {row[0] + 1}: {value} is too large")
    return make_tracks(
        path.stem,
        stamp=rows[:, 0] / frame_step(path, rows[:, 0], stride) * period,
        id=rows[:, 1].astype(np.int64),
        position=np.round(rows[:, list(xy)], DECIMALS),
    )


def is_eth_ucy(folder: Path) -> bool:
    """Whether `folder` is laid out as SGAN's ETH/UCY: whole recordings under `all/`."""
    return (folder / "all").is_dir()


def split_files(folder: Path, scene: str, split: str) -> list[Path]:
    """Files of one leave-one-out split.

    Args:
        folder: holds `all/`, `train/` and `val/`.
        scene: the scene left out of training, a key of `SCENES`.
        split: `test` (the scene's whole recordings), `train` or `val` (all others' parts).

    Raises:
        InputError: for an unknown scene or missing files.
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
        InputError: also naming file, row and reason of what cannot be read.
    """
    return [read_text(path) for path in split_files(folder, scene, split)]


def text_files(folder: Path) -> list[Path]:
    """Every `.txt` and `.csv` file of a folder, in order of name; there must be one."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such file or folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix in {".txt", ".csv"})
    if not paths:
        raise InputError(f"{folder}: no .txt or .csv file in it")
    return paths
