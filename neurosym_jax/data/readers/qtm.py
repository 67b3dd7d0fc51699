"""QTM exports of THÖR and THÖR-MAGNI: people with helmets in a motion-capture room.

Tab-separated (THÖR) or comma-separated (THÖR-MAGNI): metadata rows, a header that begins with
`Frame`, one row per frame, millimetres, usually 100 frames per second. A body's position is its
centroid where the file has one, else the mean of its visible markers. Nothing is smoothed or filled
in.

Sources: A. Rudenko et al., "THÖR", RA-L 5(2), 2020; T. Schreiter et al., "THÖR-MAGNI", IJRR 2024.
"""

import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import polars as pl

from neurosym_jax.data.rows import assemble
from neurosym_jax.data.tables import Table, lines_of, split_lines
from neurosym_jax.data.text import read_lines, read_pieces
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["HELMETS", "ROBOTS", "read_qtm"]

HELMETS = r"Helmet_(\d+)"
"""Names of the bodies that are people; the group is the id."""

ROBOTS = r"(?:Citi|DARKO(?:_Robot)?|LO)_?(\d*)"
"""Names of the robots' bodies (and the forklift's), to be read separately from the people."""

_PREAMBLE = 200  # rows among which the header must be
_RATE = 100.0  # frames a second, where the file does not say
_COLUMN = re.compile(r"(\S+?)(?:\s*-\s*(\w+))?\s+(Centroid_)?([XYZ])")


def read_qtm(path: Path, *_: object, bodies: str = HELMETS) -> Tracks:
    """People of a QTM export (`Exp_1_run_1.tsv`, `..._6D.tsv`, or a THÖR-MAGNI CSV).

    A body is not visible in a frame where its coordinates are all zero, or any is empty.

    Args:
        path: of the file.
        bodies: regular expression of the bodies to read; its group, if not empty, is the id.

    Raises:
        InputError: naming file, row and reason.
    """
    header, mark, rate, above = _header(path, read_lines(path))
    clock = header.index("Time") if "Time" in header else 0
    ids, columns, first = _places(path, header, bodies)
    table = _rows(path, header, mark, above)
    stamp = table.numbers(clock)[:, 0] / (1 if clock else rate)
    points = table.numbers(*columns.ravel().tolist(), missing=True)
    centre, seen = _centres(points.reshape(len(stamp), -1, 3) / 1000, first)
    frame, body = np.nonzero(seen)
    if len(frame) == 0:
        raise InputError(f"{path}: none of its {len(ids)} bodies is ever visible")
    assert table.row is not None
    return assemble(path, stamp[frame], ids[body], centre[frame, body, :2], row=table.row[frame])


def _header(path: Path, lines: Iterator[str]) -> tuple[list[str], str, float, int]:
    """Names of the columns, their separator, frames per second, and rows up to the header."""
    rate = _RATE
    for row, line in enumerate(islice(lines, _PREAMBLE), 1):
        mark = "\t" if "\t" in line else ","
        fields = [field.strip().strip('"') for field in line.split(mark)]
        if fields[0] == "Frame":
            return fields, mark, rate, row
        if fields[0] == "FREQUENCY" and len(fields) > 1:
            try:
                rate = float(fields[1])
            except ValueError:
                rate = 0.0
            if not 0 < rate < 1e6:
                raise InputError(f"{path}: row {row}: FREQUENCY is {fields[1][:40]!r}")
    raise InputError(f"{path}: no header that begins with `Frame` in its first {_PREAMBLE} rows")


def _rows(path: Path, header: list[str], mark: str, above: int) -> Table:
    """The rows after the header."""
    lines = pl.concat([lines_of(piece) for piece in read_pieces(path)])
    row = np.arange(1, len(lines) + 1)
    kept = (lines.str.strip_chars() != "").to_numpy() & (row > above)
    lines, row = lines.filter(kept), row[kept]
    if not len(lines):
        raise InputError(f"{path}: no rows follow the header")
    named = len("\t".join(header).rstrip("\t").split("\t"))
    fields = lines[0].split(mark)
    # The header or the rows may end in a separator.
    widths = {len(header), named, len(header) + (not fields[-1])}
    width = len(fields) if len(fields) in widths else len(header)
    return Table(path, header, split_lines(path, lines, mark, width, row), row)


def _places(
    path: Path, header: list[str], pattern: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[B] ids of bodies, [M, 3] columns of their markers' X, Y and Z, and [B] each one's first."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    current = None
    for column, name in enumerate(header):
        match = _COLUMN.fullmatch(name)
        if match:
            body, marker, centroid, axis = match.groups()
            current = (body, centroid or marker or "")
        elif name in ("Y", "Z") and current is not None:
            axis = name  # in 6D exports only X carries the body's name
        else:
            continue
        axes = found.setdefault(current[0], {}).setdefault(current[1], {})
        if axis in axes:
            raise InputError(f"{path}: the header names {' '.join(current)} {axis} twice"[:300])
        axes[axis] = column

    places: dict[int, list[list[int]]] = {}
    for body, markers in found.items():
        match = re.fullmatch(pattern, body)
        if not match:
            continue
        id = int(match[1][:18]) if match.groups() and match[1] else 0
        chosen = markers.get("Centroid_") or markers.get("")
        whole = [
            [axes[axis] for axis in "XYZ"]
            for axes in ([chosen] if chosen else markers.values())
            if len(axes) == 3
        ]
        if id in places:
            raise InputError(f"{path}: the header names body {id} twice ({body[:60]})")
        if whole:
            places[id] = whole
    if not places:
        known = ", ".join(islice(found, 8))[:200] or "none"
        raise InputError(f"{path}: no body fits {pattern}; the header has {known}")
    counts = [len(markers) for markers in places.values()]
    return (
        np.array(list(places)),
        np.array([axes for markers in places.values() for axes in markers]),
        np.cumsum([0, *counts[:-1]]),
    )


def _centres(points: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of the visible markers of each body.

    Args:
        points: [F, M, 3], NaN or all zero where a marker is not visible.
        first: [B] index of each body's first marker.

    Returns:
        [F, B, 3] means and [F, B] whether any marker is visible.
    """
    seen = ~np.isnan(points).any(axis=-1) & (points != 0).any(axis=-1)
    count = np.add.reduceat(seen.astype(int), first, axis=1)
    total = np.add.reduceat(np.where(seen[..., None], points, 0), first, axis=1)
    return total / np.maximum(count, 1)[..., None], count > 0
