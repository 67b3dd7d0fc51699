"""Which reader a file is for, told from its content; and any recording on the benchmark's grid."""

import codecs
import json
from pathlib import Path

import numpy as np

from neurosym_jax.data import columns, eth_ucy, thor, trajnet
from neurosym_jax.data.tracks import SNAP, Tracks, resample
from neurosym_jax.errors import InputError

__all__ = ["FORMATS", "SUFFIXES", "data_files", "on_grid", "read_any", "sniff"]

FORMATS = {
    "text": "rows of `frame ped x y`",
    "obsmat": "ETH's obsmat (`frame id x z y vx vz vy`)",
    "cliff": "CLiFF-LHMP tracks (`time,id,x,y,speed,heading`)",
    "qtm": "QTM export (THÖR, THÖR-MAGNI)",
    "tracklets": "THÖR-MAGNI tracklets",
    "trajnet": "TrajNet++",
    "columns": "table with named columns",
}
"""What `sniff` answers: what that is."""

SUFFIXES = (".txt", ".csv", ".tsv", ".json", ".ndjson")
"""Endings of the files that are looked at in a folder."""

_HEAD = 1 << 16  # bytes to tell a format by; a THÖR header is about 10 kB


def sniff(path: Path) -> str:
    """The format of a file, a key of `FORMATS`; `text` where nothing says otherwise.

    Raises:
        InputError: if it cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    text = head.removeprefix(codecs.BOM_UTF8).decode("utf-8", errors="ignore")
    lines = [line for line in text.splitlines() if line.split("#")[0].strip()]
    if not lines:
        return "text"
    first = lines[0].lstrip()
    if first[0] in "{[":
        return "trajnet" if _is_trajnet(first) else "columns"
    for line in lines:
        if line.startswith(("Frame\t", "Frame,")) and ("Helmet" in line or " X" in line):
            return "qtm"
    fields = first.split("#")[0].replace(",", " ").replace(";", " ").split()
    if not all(_is_number(field) for field in fields):
        names = [name.strip() for name in first.split(",")]
        if set(thor.TRACKLET_COLUMNS) <= set(names):
            return "tracklets"
        # A binary file has no header; the reader of text says best what is wrong with it.
        return "columns" if first.isprintable() or "\t" in first else "text"
    return {6: "cliff", 8: "obsmat"}.get(len(fields), "text")


def _is_trajnet(line: str) -> bool:
    try:
        row = json.loads(line)
    except (ValueError, RecursionError):
        # A row cut short is TrajNet++ still, and its reader says which.
        return line.startswith(('{"track"', '{"scene"'))
    return isinstance(row, dict) and row.keys() in ({"track"}, {"scene"})


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def read_any(
    path: Path,
    *,
    names: columns.Columns | None = None,
    unit: columns.Unit = "m",
    stride: float | None = None,
) -> list[Tracks]:
    """The recordings in a file of any known format, on their own clocks.

    Args:
        path: of the file.
        names: of the columns; the file is a table if given.
        unit: of the coordinates of a table; the other formats have theirs.
        stride: frame numbers a period, where frames are numbered; their most common step if None.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    kind = sniff(path) if names is None else "columns"
    if kind == "columns":
        return [columns.read_columns(path, names or columns.Columns(), unit, stride=stride)]
    if unit != "m":
        raise InputError(f"{path}: {FORMATS[kind]} is not a table whose unit can be chosen")
    if kind == "tracklets":
        return thor.read_tracklets(path)
    if kind == "trajnet":
        return [trajnet.read_trajnet(path, stride).tracks]
    if kind == "text":
        return [eth_ucy.read_text(path, stride=stride)]
    if kind == "obsmat":
        return [eth_ucy.read_obsmat(path, stride=stride)]
    return [thor.read_cliff(path) if kind == "cliff" else thor.read_qtm(path)]


def on_grid(tracks: Tracks, period: float = eth_ucy.PERIOD) -> Tracks:
    """`tracks` as they are if all stamps lie on one grid of `period` seconds, else resampled."""
    place = (tracks.stamp - tracks.stamp.min()) / period
    # Stamps of large frame numbers are rounded by more than SNAP.
    tolerance = SNAP / period + 4 * np.finfo(float).eps * np.abs(tracks.stamp).max() / period
    if np.all(np.abs(place - np.rint(place)) <= tolerance):
        return tracks
    return resample(tracks, period)


def data_files(folder: Path) -> list[Path]:
    """Every file of a folder whose ending is one of `SUFFIXES`, in order of name; at least one."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such file or folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise InputError(f"{folder}: no {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} file in it")
    return paths
