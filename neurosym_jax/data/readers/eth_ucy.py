"""Text files of `frame ped x y`, and the ETH/UCY leave-one-out splits made of them.

Any such file is user data, whatever its delimiter. The folder of ETH/UCY as SGAN arranges it has
`all/` (whole recordings, for testing), `train/` and `val/`. Choosing windows is not done here.
"""

from pathlib import Path

import numpy as np

from neurosym_jax.data.format import Format
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.rows import (
    assemble,
    consecutive,
    frame_step,
    number_table,
    refuse_unwhole,
)
from neurosym_jax.data.text import Head
from neurosym_jax.data.tracks import PERIOD, Tracks
from neurosym_jax.errors import InputError

__all__ = [
    "FORMATS",
    "SCENES",
    "is_eth_ucy",
    "read_obsmat",
    "read_split",
    "read_text",
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
"""Recordings that each of the benchmark's five scenes tests on."""

NAMES = ("frame", "ped", "x", "y")
OBSMAT = ("frame", "id", "x", "z", "y", "vx", "vz", "vy")

DECIMALS = 4
"""SGAN rounds coordinates to this many decimals."""


def read_text(
    path: Path, period: float = PERIOD, stride: float | None = None, metres: float = 1.0
) -> Tracks:
    """Read one file of rows `frame ped x y` (tab, space, comma or semicolon between them).

    Frames are taken to be `period` seconds apart, whatever the numbers count in: the most common
    step between consecutive frame numbers is one period. That is SGAN's reading, and for the eth
    recording a trap: its frames are 10 numbers apart in a video of 15 a second, so 0.67 s. With
    `stride=6`, 6 numbers are one period, and the steps of that file become 10/6 periods long.

    Args:
        path: of the file.
        period: seconds.
        stride: frame numbers a period; their most common step if None.
        metres: in a unit of the coordinates.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    rows, ids = number_table(path, NAMES)
    refuse_unwhole(path, rows[:, 1], "ped")
    frame, position = rows[:, 0].copy(), rows[:, 2:] * metres
    del rows  # The memory of a large file.
    return _whole_frames(path, frame, ids, position, period, stride)


def read_obsmat(path: Path, period: float = PERIOD, stride: float | None = None) -> Tracks:
    """Read an `obsmat.txt` of ETH's own: rows `frame id x z y vx vz vy`, as `read_text` otherwise.

    There the frames of both recordings are 0.4 s apart: 6 numbers at 15 a second in eth, 10 at 25
    in hotel.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    rows, ids = number_table(path, OBSMAT)
    refuse_unwhole(path, rows[:, 1], "id")
    return _whole_frames(path, rows[:, 0], ids, rows[:, [2, 4]], period, stride)


def _whole_frames(
    path: Path,
    frame: np.ndarray,
    ids: np.ndarray,
    metres: np.ndarray,
    period: float,
    stride: float | None,
) -> Tracks:
    refuse_unwhole(path, frame, "frame")
    step = frame_step(path, frame, stride)
    return assemble(
        path,
        frame / step * period,
        ids,
        np.round(metres, DECIMALS),
        frame_step=step if stride is None else None,
    )


def _is_obsmat(head: Head) -> bool:
    """Eight numbers a row, of which z and its velocity are zero and the others agree."""
    if head.columns != len(OBSMAT) or head.rows[:, [3, 6]].any():
        return False
    before, after = consecutive(head.rows[:, 0], head.rows[:, 1])
    apart = head.rows[after, 0] > head.rows[before, 0]
    before, after = before[apart], after[apart]
    frames = (head.rows[after] - head.rows[before])[:, :1]
    moved = (head.rows[after] - head.rows[before])[:, [2, 4]] / frames
    velocity = (head.rows[after] + head.rows[before])[:, [5, 7]] / 2
    # Whatever the frames count in.
    scale = np.vdot(moved, velocity) / max(float(np.vdot(velocity, velocity)), 1e-12)
    error = np.abs(moved - scale * velocity).sum()
    return bool(scale > 0 and error < 0.5 * np.abs(moved).sum())


def _read_text(path: Path, options: ReadOptions, period: float) -> list[Tracks]:
    tracks = read_text(path, period, options.stride_of(path, period), options.metres(path))
    paces = [
        np.median(np.linalg.norm(tracks.position[after] - tracks.position[before], axis=1))
        if len(after) > _PAIRS
        else np.nan
        for times, ids in ((tracks.stamp, tracks.id), (tracks.id, tracks.stamp))
        for before, after in [consecutive(times, ids)]
    ]
    if options.format is None and paces[1] < paces[0] / 3:
        raise InputError(
            f"{path}: its rows look like `ped frame x y`: say --columns frame=2 id=1 x=3 y=4, or "
            "--format text where they are `frame ped x y` all the same"
        )
    return [tracks]


_PAIRS = 20  # points that follow on another, from which on they tell an order of columns

FORMATS = {
    "obsmat": Format(
        "ETH's obsmat (`frame id x z y vx vz vy`)",
        _is_obsmat,
        lambda path, how, period: [read_obsmat(path, period, how.stride_of(path, period))],
        uses=frozenset({"stride", "fps"}),
    ),
    "text": Format(
        "rows of `frame ped x y`",
        lambda head: not head.named,
        _read_text,
        uses=frozenset({"unit", "stride", "fps"}),
        general=True,
    ),
}


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
    """Every `.txt` and `.csv` file of a folder, in order of name; there must be one.

    Raises:
        InputError: where there is none.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such file or folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix in {".txt", ".csv"})
    if not paths:
        raise InputError(f"{folder}: no .txt or .csv file in it")
    return paths
