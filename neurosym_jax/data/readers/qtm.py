"""QTM exports of THÖR and THÖR-MAGNI: people with helmets in a motion-capture room.

Tab-separated (THÖR) or comma-separated (THÖR-MAGNI): metadata rows, a header that begins with
`Frame`, a row a frame, millimetres, usually 100 a second. A body's position is its centroid where
the file has one, else the mean of its markers that are seen. Nothing is smoothed or filled in.

Sources: A. Rudenko et al., "THÖR", RA-L 5(2), 2020; T. Schreiter et al., "THÖR-MAGNI", IJRR 2024.
"""

import re
from collections.abc import Iterator
from itertools import islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from neurosym_jax.data.format import Format
from neurosym_jax.data.rows import assemble
from neurosym_jax.data.text import Head, number, read_lines, read_number
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["FORMATS", "HELMETS", "ROBOTS", "read_qtm"]

HELMETS = r"Helmet_(\d+)"
"""The bodies that are people; the group is the id."""

ROBOTS = r"(?:Citi|DARKO(?:_Robot)?|LO)_?(\d*)"
"""The robots' bodies (and the forklift), to be read apart from the people."""

_PREAMBLE = 200  # rows among which the header must be
_RATE = 100.0  # frames a second, where the file does not say
_PIECE = 1 << 20  # numbers that are worked on at a time
_COLUMN = re.compile(r"(\S+?)(?:\s*-\s*(\w+))?\s+(Centroid_)?([XYZ])")


def read_qtm(path: Path, bodies: str = HELMETS) -> Tracks:
    """People of a QTM export (`Exp_1_run_1.tsv`, `..._6D.tsv`, or a THÖR-MAGNI CSV).

    A body is missing in a frame where its coordinates are all zero, or any is empty.

    Args:
        path: of the file.
        bodies: regular expression of the bodies to read; its group, if not empty, is the id.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    lines = read_lines(path)
    header, separator, rate, above = _header(path, lines)
    clock = header.index("Time") if "Time" in header else 0
    ids, columns, first = _places(path, header, bodies)
    wanted = [clock, *columns.ravel().tolist()]
    rows = _floats(path, lines, separator, wanted, header, above)
    parts: list[tuple[np.ndarray, ...]] = []
    kind = np.dtype((np.float64, 1 + len(wanted)))
    while True:
        table: np.ndarray = np.fromiter(islice(rows, _PIECE // len(wanted) + 1), kind)
        if not len(table):
            break
        row, stamp = table[:, 0].astype(int), table[:, 1] / (1 if clock else rate)
        bad = np.flatnonzero(~np.isfinite(stamp))
        if len(bad):
            raise InputError(f"{path}: row {row[bad[0]]}: the time is not a number")
        centre, seen = _centres(table[:, 2:].reshape(len(table), -1, 3) / 1000, first)
        frame, body = np.nonzero(seen)
        parts.append((stamp[frame], ids[body], centre[frame, body, :2], row[frame]))
    if not parts:
        raise InputError(f"{path}: no rows follow the header")
    stamps, people, position, row = (np.concatenate(part) for part in zip(*parts))
    if len(stamps) == 0:
        raise InputError(f"{path}: none of its {len(ids)} bodies is ever seen")
    return assemble(path, stamps, people, position, row=row)


def _header(path: Path, lines: Iterator[str]) -> tuple[list[str], str, float, int]:
    """Names of the columns, what separates them, frames a second, and rows up to the header."""
    rate = _RATE
    for row, line in enumerate(islice(lines, _PREAMBLE), 1):
        separator = "\t" if "\t" in line else ","
        fields = [field.strip().strip('"') for field in line.split(separator)]
        if fields[0] == "Frame":
            return fields, separator, rate, row
        if fields[0] == "FREQUENCY" and len(fields) > 1:
            try:
                rate = number(fields[1])
            except ValueError:
                rate = 0.0
            if not 0 < rate < 1e6:
                raise InputError(f"{path}: row {row}: FREQUENCY is {fields[1][:40]!r}")
    raise InputError(f"{path}: no header that begins with `Frame` in its first {_PREAMBLE} rows")


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


def _floats(
    path: Path, lines: Iterator[str], separator: str, wanted: list[int], header: list[str], row: int
) -> Iterator[tuple[float, ...]]:
    """The number and the wanted columns of every row; NaN where a field is empty."""
    pick, width = itemgetter(*wanted), 0
    named = len(header)
    while named and not header[named - 1]:
        named -= 1
    for line in lines:
        row += 1
        if not line or line.isspace():
            continue
        fields = line.split(separator)
        if not width and len(fields) in (len(header), named, len(header) + (not fields[-1])):
            width = len(fields)
        if len(fields) != width:
            wide = width or len(header)
            raise InputError(f"{path}: row {row} has {len(fields)} columns, not {wide}")
        chosen = pick(fields)
        try:
            # Most rows have no empty field, and this is the reader's innermost loop.
            if "_" in line:
                raise ValueError
            yield (row, *map(float, chosen))
        except ValueError:
            plain = (field.strip().strip('"') for field in chosen)
            yield (row, *(read_number(path, row, field or "nan") for field in plain))


def _centres(points: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[F, B, 3] means over each body's markers seen of `points [F, M, 3]`, and [F, B] whether any
    was; body b has the markers from `first[b]` on."""
    seen = ~np.isnan(points).any(axis=-1) & (points != 0).any(axis=-1)
    count = np.add.reduceat(seen.astype(int), first, axis=1)
    total = np.add.reduceat(np.where(seen[..., None], points, 0), first, axis=1)
    return total / np.maximum(count, 1)[..., None], count > 0


def _is_qtm(head: Head) -> bool:
    return any(
        line.startswith(("Frame\t", "Frame,")) and ("Helmet" in line or " X" in line)
        for line in head.lines
    )


FORMATS = {
    "qtm": Format("QTM export (THÖR, THÖR-MAGNI)", _is_qtm, lambda path, *_: [read_qtm(path)]),
}
