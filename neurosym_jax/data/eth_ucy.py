"""Text files of `frame ped x y`, and the ETH/UCY leave-one-out splits made of them.

Any such file is user data, whatever its delimiter. The folder of ETH/UCY as SGAN arranges it has
`all/` (whole recordings, for testing), `train/` and `val/`. Choosing windows is not done here.
"""

import warnings
from pathlib import Path

import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.errors import InputError

__all__ = ["PERIOD", "SCENES", "is_eth_ucy", "read_split", "read_text", "text_files"]

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

FAR = 1e9
"""Metres; farther than any map's coordinates."""

DECIMALS = 4
"""SGAN rounds coordinates to this many decimals."""


def read_text(path: Path, period: float = PERIOD) -> Tracks:
    """Read one file of rows `frame ped x y` (tab, space, comma or semicolon between them).

    Frames are taken to be `period` seconds apart, whatever the numbers count in: the most common
    step between consecutive frame numbers is one period.

    Raises:
        InputError: naming file, row and reason.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None
    rows = _parse(path, text.replace(",", " ").replace(";", " "))
    frame = rows[:, 0]
    steps = np.diff(np.unique(frame))
    step = 1.0 if len(steps) == 0 else _most_common(steps)
    for column, name in ((0, "frame"), (1, "ped")):
        fraction = np.flatnonzero(rows[:, column] != np.round(rows[:, column]))
        if len(fraction):
            raise InputError(
                f"{path}: row {fraction[0] + 1}: {name} {rows[fraction[0], column]} is not whole"
            )
    for columns, limit in ((slice(0, 2), 2.0**53), (slice(2, 4), FAR)):
        row, column = np.nonzero(np.abs(rows[:, columns]) > limit)
        if len(row):
            value = rows[row[0], columns][column[0]]
            raise InputError(f"{path}: row {row[0] + 1}: {value} is too large")
    return make_tracks(
        Path(path).stem,
        stamp=frame / step * period,
        id=rows[:, 1].astype(np.int64),
        position=np.round(rows[:, 2:], DECIMALS),
    )


def _parse(path: Path, text: str) -> np.ndarray:
    """[R, 4] numbers, finite, with (frame, ped) unique."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # numpy's own for an empty file
            rows = np.loadtxt(text.splitlines(), ndmin=2, comments="#")
    except ValueError:
        raise InputError(_malformed(path, text)) from None
    if rows.size == 0:
        raise InputError(f"{path}: the file has no rows")
    if rows.shape[1] != 4:
        raise InputError(f"{path}: row 1 has {rows.shape[1]} columns, not `frame ped x y`")
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise InputError(f"{path}: row {bad[0] + 1} is not finite: {rows[bad[0]].tolist()}")
    order = np.lexsort((rows[:, 0], rows[:, 1]))
    again = np.flatnonzero((np.diff(rows[order, :2], axis=0) == 0).all(axis=1))
    if len(again):
        row = int(max(order[again[0]], order[again[0] + 1]))
        frame, ped = rows[row, :2]
        raise InputError(f"{path}: row {row + 1} repeats (frame {frame:g}, ped {ped:g})")
    return rows


def _malformed(path: Path, text: str) -> str:
    number = 0
    for line in text.splitlines():
        fields = line.split("#")[0].split()
        if not fields:
            continue
        number += 1
        if len(fields) != 4:
            shown = line if len(line) < 60 else f"{line[:60]}..."
            return f"{path}: row {number} has {len(fields)} columns, not `frame ped x y`: {shown!r}"
        for field in fields:
            try:
                float(field)
            except ValueError:
                return f"{path}: row {number}: {field[:60]!r} is not a number"
    return f"{path}: not a table of `frame ped x y`"


def _most_common(values: np.ndarray) -> float:
    unique, counts = np.unique(values, return_counts=True)
    return float(unique[np.argmax(counts)])


def is_eth_ucy(folder: Path) -> bool:
    """Whether `folder` is laid out as SGAN's ETH/UCY: whole recordings under `all/`."""
    return (folder / "all").is_dir()


def read_split(folder: Path, scene: str, split: str) -> list[Tracks]:
    """Recordings of one leave-one-out split.

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
    else:
        held_out = {f"{name}_{split}.txt" for name in SCENES[scene]}
        paths = [path for path in text_files(folder / split) if path.name not in held_out]
    return [read_text(path) for path in paths]


def text_files(folder: Path) -> list[Path]:
    """Every `.txt` and `.csv` file of a folder, in order of name; there must be one."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such file or folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix in {".txt", ".csv"})
    if not paths:
        raise InputError(f"{folder}: no .txt or .csv file in it")
    return paths
