"""THÖR and THÖR-MAGNI: people with helmets in a motion-capture room, in the files people have.

- QTM exports, tab-separated (THÖR) or comma-separated (THÖR-MAGNI): metadata rows, a header that
  begins with `Frame`, a row a frame, millimetres, usually 100 a second. A body's position is its
  centroid where the file has one, else the mean of its markers that are seen.
- Tracklets of THÖR-MAGNI: `Time,...,x,y,...,ag_id,...,tracklet_id` in metres.
- Tracks of CLiFF-LHMP: `time,id,x,y,speed,heading` in metres, no header; every agent has a clock
  of its own, so `tracks.resample` must bring them to one grid before they are a scene.

Sources: A. Rudenko et al., "THÖR", RA-L 5(2), 2020; T. Schreiter et al., "THÖR-MAGNI", IJRR 2024;
Y. Zhu et al., "CLiFF-LHMP", IROS 2023. Nothing is smoothed or filled in here.
"""

import csv
import re
from collections.abc import Iterator
from itertools import islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from neurosym_jax.data.readers.rows import assemble, load_text, number_ids, number_table
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["HELMETS", "ROBOTS", "TRACKLET_COLUMNS", "read_cliff", "read_qtm", "read_tracklets"]

HELMETS = r"Helmet_(\d+)"
"""The bodies that are people; the group is the id."""

ROBOTS = r"(?:Citi|DARKO(?:_Robot)?|LO)_?(\d*)"
"""The robots' bodies (and the forklift), to be read apart from the people."""

TRACKLET_COLUMNS = ("Time", "x", "y", "ag_id", "tracklet_id")

_PREAMBLE = 200  # rows among which the header must be
_RATE = 100.0  # frames a second, where the file does not say
_COLUMN = re.compile(r"(?P<body>\S+?)(?:\s*-\s*(?P<marker>\w+))?\s+(?:Centroid_)?(?P<axis>[XYZ])")


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
    try:
        with path.open(encoding="utf-8-sig", newline=None) as lines:
            header, separator, rate, rows_above = _header(path, lines)
            clock = header.index("Time") if "Time" in header else 0
            places = _places(path, header, bodies)
            wanted = [clock, *(column for axes in places.values() for column in axes.ravel())]
            rows = _floats(path, lines, separator, wanted, rows_above)
            table: np.ndarray = np.fromiter(rows, np.dtype((np.float64, len(wanted))))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as text ({error})") from None
    if len(table) == 0:
        raise InputError(f"{path}: no rows follow the header")
    stamp = table[:, 0] if clock else table[:, 0] / rate
    if not np.isfinite(stamp).all():
        row = rows_above + 1 + int(np.flatnonzero(~np.isfinite(stamp))[0])
        raise InputError(f"{path}: row {row}: the time is not a number")

    parts, at = [], 1
    for body, axes in places.items():
        points = table[:, at : at + axes.size].reshape(len(table), *axes.shape) / 1000
        at += axes.size
        centre, seen = _centres(points)
        parts.append((stamp[seen], np.full(int(seen.sum()), body), centre[seen, :2]))
    times, ids, position = (np.concatenate(columns) for columns in zip(*parts))
    if len(times) == 0:
        raise InputError(f"{path}: none of its {len(places)} bodies is ever seen")
    return assemble(path, times, ids, position)


def _header(path: Path, lines: Iterator[str]) -> tuple[list[str], str, float, int]:
    """Names of the columns, what separates them, frames a second, and rows up to the header."""
    rate = _RATE
    for number, line in enumerate(islice(lines, _PREAMBLE), 1):
        separator = "\t" if "\t" in line else ","
        fields = [field.strip().strip('"') for field in line.rstrip("\r\n").split(separator)]
        if fields[0] == "Frame":
            return fields, separator, rate, number
        if fields[0] == "FREQUENCY" and len(fields) > 1:
            try:
                rate = float(fields[1])
            except ValueError:
                rate = 0.0
            if not 0 < rate < 1e6:
                raise InputError(f"{path}: row {number}: FREQUENCY is {fields[1][:40]!r}")
    raise InputError(f"{path}: no header that begins with `Frame` in its first {_PREAMBLE} rows")


def _places(path: Path, header: list[str], pattern: str) -> dict[int, np.ndarray]:
    """For every body, [markers, 3] columns of X, Y and Z."""
    found: dict[str, dict[str, dict[str, int]]] = {}
    current = None
    for column, name in enumerate(header):
        match = _COLUMN.fullmatch(name)
        if match:
            current = (match["body"], match["marker"] or "")
            axis = match["axis"]
        elif name in ("Y", "Z") and current is not None:
            axis = name  # in 6D exports only X carries the body's name
        else:
            continue
        found.setdefault(current[0], {}).setdefault(current[1], {}).setdefault(axis, column)

    places: dict[int, np.ndarray] = {}
    for body, markers in found.items():
        match = re.fullmatch(pattern, body)
        if not match:
            continue
        number = int(match[1][:9]) if match.groups() and match[1] else 0
        chosen = [markers[""]] if "" in markers else list(markers.values())
        whole = [[axes[axis] for axis in "XYZ"] for axes in chosen if len(axes) == 3]
        if number in places:
            raise InputError(f"{path}: the header names body {number} twice ({body})")
        if whole:
            places[number] = np.array(whole)
    if not places:
        known = ", ".join(list(found)[:8])[:200] or "none"
        raise InputError(f"{path}: no body fits {pattern}; the header has {known}")
    return places


def _floats(
    path: Path, lines: Iterator[str], separator: str, wanted: list[int], above: int
) -> Iterator[tuple[float, ...]]:
    """The wanted columns of every row; NaN where a field is empty."""
    pick = itemgetter(*wanted)
    for number, line in enumerate(lines, above + 1):
        if line.isspace():
            continue
        fields = line.rstrip("\r\n").split(separator)
        try:
            chosen = pick(fields)
        except IndexError:
            raise InputError(
                f"{path}: row {number} has {len(fields)} columns, and {max(wanted) + 1} are needed"
            ) from None
        try:
            # Most rows have no empty field, and this is the reader's innermost loop.
            yield tuple(map(float, chosen))
        except ValueError:
            yield tuple(_number(path, number, field) for field in chosen)


def _number(path: Path, row: int, field: str) -> float:
    field = field.strip().strip('"')
    try:
        return float(field or "nan")
    except ValueError:
        raise InputError(f"{path}: row {row}: {field[:60]!r} is not a number") from None


def _centres(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[F, 3] means over the markers seen of `points` [F, M, 3], and [F] whether any was."""
    seen = ~np.isnan(points).any(axis=-1) & (points != 0).any(axis=-1)
    count = seen.sum(axis=1)
    total = np.where(seen[..., None], points, 0).sum(axis=1)
    return total / np.maximum(count, 1)[:, None], count > 0


def read_tracklets(path: Path) -> list[Tracks]:
    """The runs in a file of THÖR-MAGNI tracklets, in which nothing but the order tells them apart.

    Helmets follow one another within a run; where a helmet comes back at an earlier time than it
    had, the next run begins. Consecutive tracklets of a helmet are one track.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    try:
        table = list(csv.reader(load_text(path).splitlines()))
    except csv.Error as error:
        raise InputError(f"{path}: not CSV ({error})") from None
    header = table[0] if table else []
    missing = [name for name in TRACKLET_COLUMNS if name not in header]
    if missing:
        raise InputError(f"{path}: the header lacks {', '.join(missing)}")
    pick = itemgetter(*(header.index(name) for name in TRACKLET_COLUMNS[:4]))
    numbers, helmets = [], []
    for number, fields in enumerate(table[1:], 2):
        if not fields:
            continue
        if len(fields) < len(header):
            raise InputError(f"{path}: row {number} has {len(fields)} of {len(header)} columns")
        *values, helmet = pick(fields)
        numbers.append([_number(path, number, value) for value in values])
        helmets.append(helmet.removeprefix("Helmet_"))
    if not numbers:
        raise InputError(f"{path}: the file has no rows")
    rows, ids = np.array(numbers), number_ids(helmets)

    run, latest, runs = 0, {}, np.empty(len(rows), int)
    for row, (agent, time) in enumerate(zip(ids.tolist(), rows[:, 0].tolist())):
        if time <= latest.get(agent, -np.inf):
            run, latest = run + 1, {}
        latest[agent] = time
        runs[row] = run
    return [
        assemble(path, rows[at, 0], ids[at], rows[at, 1:], f"{path.stem}_{one + 1}")
        for one in range(run + 1)
        for at in [runs == one]
    ]


def read_cliff(path: Path) -> Tracks:
    """Tracks of CLiFF-LHMP: rows `time,id,x,y,speed,heading`, metres.

    Raises:
        InputError: naming file, row and reason.
    """
    path = Path(path)
    rows = number_table(path, load_text(path), ("time", "id", "x", "y", "speed", "heading"))
    whole = np.flatnonzero((rows[:, 1] != np.rint(rows[:, 1])) | (np.abs(rows[:, 1]) > 2.0**53))
    if len(whole):
        raise InputError(f"{path}: row {whole[0] + 1}: id {rows[whole[0], 1]} is not whole")
    return assemble(path, rows[:, 0], rows[:, 1].astype(np.int64), rows[:, 2:4])
