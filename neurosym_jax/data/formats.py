"""Which reader a file is for, told from its content; and any recording on the benchmark's grid."""

import codecs
import dataclasses
import json
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

from neurosym_jax.data.readers import columns, eth_ucy, thor, trajnet
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import SNAP, Tracks, common, resample
from neurosym_jax.errors import InputError, InputWarning

__all__ = ["FORMATS", "SUFFIXES", "Format", "data_files", "on_grid", "read_any", "sniff"]

SUFFIXES = (".txt", ".csv", ".tsv", ".json", ".ndjson")
"""Endings of the files that are looked at in a folder."""

_HEAD = 1 << 16  # bytes to tell a format by; a THÖR header is about 10 kB


@dataclasses.dataclass(frozen=True)
class Head:
    """How a file begins."""

    lines: tuple[str, ...]
    """The lines that say something."""

    @property
    def first(self) -> str:
        """The first of them."""
        return self.lines[0].lstrip() if self.lines else ""

    @property
    def fields(self) -> list[str]:
        """What stands in the first, whatever separates it."""
        return self.first.split("#")[0].replace(",", " ").replace(";", " ").split()

    @property
    def numbers(self) -> int:
        """How many numbers the first is; 0 where it has anything else."""
        try:
            return len([float(field) for field in self.fields])
        except ValueError:
            return 0

    @property
    def names(self) -> list[str]:
        """The first as the header of a CSV file."""
        return [name.strip() for name in self.first.split(",")]


@dataclasses.dataclass(frozen=True)
class Format:
    """One format."""

    text: str
    """What it is, for people."""
    knows: Callable[[Head], bool]
    """Whether a file that begins so is of it, if it is of none before it."""
    read: Callable[[Path, ReadOptions, float], list[Tracks]]
    """Its recordings; the number is the seconds that one step of frame numbers stands for."""
    metric: bool = False
    """Whether the unit of coordinates is fixed."""


def _is_trajnet(head: Head) -> bool:
    try:
        row = json.loads(head.first)
    except (ValueError, RecursionError):
        # A row cut short is TrajNet++ still, and its reader says which.
        return head.first.startswith(('{"track"', '{"scene"'))
    return isinstance(row, dict) and row.keys() in ({"track"}, {"scene"})


def _is_qtm(head: Head) -> bool:
    return any(
        line.startswith(("Frame\t", "Frame,")) and ("Helmet" in line or " X" in line)
        for line in head.lines
    )


def _is_table(head: Head) -> bool:
    if head.first.startswith(("{", "[")):
        return True
    # A binary file has no header; the reader of text says best what is wrong with it.
    readable = head.first.isprintable() or "\t" in head.first
    return bool(head.lines) and not head.numbers and readable


FORMATS = {
    "trajnet": Format(
        "TrajNet++",
        _is_trajnet,
        lambda path, how, _: [trajnet.read_trajnet(path, how.stride_of(path)).tracks],
        metric=True,
    ),
    "qtm": Format(
        "QTM export (THÖR, THÖR-MAGNI)",
        _is_qtm,
        lambda path, *_: [thor.read_qtm(path)],
        metric=True,
    ),
    "tracklets": Format(
        "THÖR-MAGNI tracklets",
        lambda head: set(thor.TRACKLET_COLUMNS) <= set(head.names),
        lambda path, *_: thor.read_tracklets(path),
        metric=True,
    ),
    "columns": Format(
        "table with named columns",
        _is_table,
        lambda path, how, period: [
            columns.read_columns(
                path, columns.parse_columns(how.columns), period, how.stride_of(path)
            )
        ],
    ),
    "cliff": Format(
        "CLiFF-LHMP tracks (`time,id,x,y,speed,heading`)",
        lambda head: head.numbers == 6,
        lambda path, *_: [thor.read_cliff(path)],
        metric=True,
    ),
    "obsmat": Format(
        "ETH's obsmat (`frame id x z y vx vz vy`)",
        lambda head: head.numbers == 8,
        lambda path, how, period: [eth_ucy.read_obsmat(path, period, how.stride_of(path))],
        metric=True,
    ),
    "text": Format(
        "rows of `frame ped x y`",
        lambda head: True,
        lambda path, how, period: [eth_ucy.read_text(path, period, how.stride_of(path))],
    ),
}
"""By name, in the order in which they are asked whether they know a file."""


def _head(path: Path) -> Head:
    try:
        with path.open("rb") as file:
            start = file.read(_HEAD)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    text = start.removeprefix(codecs.BOM_UTF8).decode("utf-8", errors="ignore")
    return Head(tuple(line for line in text.splitlines() if line.split("#")[0].strip()))


def sniff(path: Path) -> str:
    """The format of a file, a key of `FORMATS`; `text` where nothing says otherwise.

    Raises:
        InputError: if it cannot be read.
    """
    head = _head(Path(path))
    return next(name for name, form in FORMATS.items() if form.knows(head))


def read_any(
    path: Path, options: ReadOptions = AS_IT_SAYS, frame_period: float = eth_ucy.PERIOD
) -> list[Tracks]:
    """The recordings in a file of any known format, on their own clocks.

    Args:
        path: of the file.
        options: what the file does not say; it is a table if columns are named.
        frame_period: seconds of the most common step between frames, or of the stride given, where
            frames are numbered and the format does not fix their rate.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    form = FORMATS["columns" if options.columns else sniff(path)]
    metres = options.metres(path)
    if metres == 1.0:
        return form.read(path, options, frame_period)
    if form.metric:
        raise InputError(f"{path}: {form.text}: its unit is fixed, so none can be chosen")
    return [
        dataclasses.replace(tracks, position=tracks.position * metres)
        for tracks in form.read(path, options, frame_period)
    ]


def on_grid(tracks: Tracks, period: float = eth_ucy.PERIOD) -> Tracks:
    """`tracks` as they are if they have steps of `period` seconds on one grid, else resampled.

    Raises:
        InputError: for a period that is no usable number.
    """
    if not 0 < period < np.inf:
        raise InputError(f"{tracks.recording}: the period must be positive, not {period}")
    place = (tracks.stamp - tracks.stamp.min()) / period
    # Stamps of large frame numbers are rounded by more than SNAP.
    tolerance = SNAP / period + 4 * np.finfo(float).eps * np.abs(tracks.stamp).max() / period
    steps = np.diff(np.unique(np.rint(place)))
    usual = len(steps) == 0 or common(steps) == 1.0
    if usual and np.all(np.abs(place - np.rint(place)) <= tolerance):
        return tracks
    return resample(tracks, period)


def data_files(folder: Path, options: ReadOptions = AS_IT_SAYS) -> list[Path]:
    """The recordings of a folder, by the endings `SUFFIXES`, in order of name; at least one.

    Warns:
        InputWarning: of a table that is left out, because it has no columns of tracks.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such file or folder")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise InputError(f"{folder}: no {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]} file in it")
    if options.columns:
        return paths
    others = [path for path in paths if _is_of_something_else(path)]
    for path in others:
        warnings.warn(f"{path}: left out: it has no columns of tracks", InputWarning, stacklevel=2)
    if len(others) == len(paths):
        raise InputError(f"{folder}: its tables have no columns of tracks; name them, or others")
    return [path for path in paths if path not in others]


def _is_of_something_else(path: Path) -> bool:
    """Whether this is a CSV table whose header names neither people nor places nor times."""
    head = _head(path)
    csv = "," in head.first and not head.first.startswith(("{", "["))
    return csv and sniff(path) == "columns" and not columns.names_tracks(head.names)
