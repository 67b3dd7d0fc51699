"""A user's own table: CSV with a header, or JSON, whose columns are named or have usual names.

JSON is a list of objects, an object of lists, or an object a line. The time is seconds, or a frame
number that counts periods as in `eth_ucy.read_text`; ids may be texts.
"""

import csv
import dataclasses
import json
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.readers.eth_ucy import PERIOD
from neurosym_jax.data.readers.rows import assemble, frame_step, load_text, number_ids
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError

__all__ = ["Columns", "names_tracks", "parse_columns", "read_columns"]

_USUAL = {
    "time": ("time", "t", "timestamp", "stamp", "seconds", "time_s", "sec"),
    "frame": ("frame", "frame_id", "frame_number", "frame_num", "f"),
    "id": (
        *("id", "person", "person_id", "ped", "ped_id", "pedestrian", "pedestrian_id", "agent"),
        *("agent_id", "ag_id", "track", "track_id", "trackid", "p"),
    ),
    "x": ("x", "px", "pos_x", "x_m", "position_x", "x_est"),
    "y": ("y", "py", "pos_y", "y_m", "position_y", "y_est"),
}


@dataclasses.dataclass(frozen=True)
class Columns:
    """The names of a table's columns; empty for the usual ones, in any case."""

    time: str = ""
    """Seconds."""
    frame: str = ""
    """Frame numbers, where there is no time."""
    id: str = ""
    """Who: numbers or texts."""
    x: str = ""
    y: str = ""


def parse_columns(pairs: Sequence[str]) -> Columns:
    """Columns from `time=t id=person x=px y=py`; InputError for anything else."""
    known = [field.name for field in dataclasses.fields(Columns)]
    given = {}
    for pair in pairs:
        key, sign, name = pair.partition("=")
        if key not in known or not sign or not name or key in given:
            raise InputError(f"{pair}: columns are given as {'=.. '.join(known)}=.., each once")
        given[key] = name
    return Columns(**given)


def read_columns(
    path: Path,
    columns: Columns = Columns(),
    period: float = PERIOD,
    stride: float | None = None,
) -> Tracks:
    """Read one table.

    Args:
        path: of a CSV (comma, semicolon or tab between the fields) or JSON file.
        columns: their names.
        period: seconds; of use where frames are numbered.
        stride: frame numbers a period; their most common step if None.

    Raises:
        InputError: naming file, row (from 1, the header not counted) and reason.
    """
    path = Path(path)
    text = load_text(path)
    table = _json(path, text) if text.lstrip()[:1] in ("{", "[") else _csv(path, text)
    if not table:
        raise InputError(f"{path}: the table has no columns")
    clock = "frame" if columns.frame and not columns.time else "time"
    name = _find(path, table, clock, getattr(columns, clock), needed=bool(columns.time))
    if name is None:
        clock = "frame"
        name = _find(path, table, clock, columns.frame, needed=True)
    found = [name, *(_find(path, table, key, getattr(columns, key), True) for key in "xy")]
    time, x, y = (_numbers(path, str(one), table[str(one)]) for one in found)
    people = table[str(_find(path, table, "id", columns.id, True))]
    if len(people) == 0:
        raise InputError(f"{path}: the table has no rows")
    if clock == "frame":
        time = time / frame_step(path, time, stride) * period
    return assemble(path, time, number_ids(people), np.stack([x, y], axis=1))


def names_tracks(names: Sequence[str]) -> bool:
    """Whether some of a header's names are usual for a time or frame, a person, x and y."""
    known = {name.strip().lower() for name in names}
    found = {key for key, usual in _USUAL.items() if known.intersection(usual)}
    return found >= {"id", "x", "y"} and bool(found & {"time", "frame"})


def _find(
    path: Path, table: Mapping[str, Any], key: str, given: str, needed: bool = False
) -> str | None:
    """The column that serves as `key`: the one given, else the first of a usual name."""
    if given:
        if given not in table:
            raise InputError(f"{path}: no column {given!r} among {_shown(table)}")
        return given
    names = {name.strip().lower(): name for name in reversed(list(table))}
    for name in _USUAL[key]:
        if name in names:
            return names[name]
    if needed:
        what = "time or frame" if key == "frame" else key
        raise InputError(f"{path}: which column is {what}? There are {_shown(table)}")
    return None


def _shown(table: Mapping[str, Any]) -> str:
    return ", ".join(repr(name[:30]) for name in islice(table, 12))


def _csv(path: Path, text: str) -> dict[str, list[Any]]:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError(f"{path}: the file has no rows")
    separator = max(",;\t", key=lines[0].count)
    try:
        rows = list(csv.reader(lines, delimiter=separator, skipinitialspace=True))
        if separator not in lines[0]:
            rows = [line.split() for line in lines]
    except csv.Error as error:
        raise InputError(f"{path}: not CSV ({error})") from None
    header, rows = rows[0], rows[1:]
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise InputError(f"{path}: row {number} has {len(row)} of {len(header)} columns")
    table: dict[str, list[Any]] = {}
    for at, name in enumerate(header):
        table.setdefault(name, [row[at] for row in rows])  # of two with one name, the first
    return table


def _json(path: Path, text: str) -> dict[str, list[Any]]:
    try:
        try:
            table = json.loads(text)
        except json.JSONDecodeError:
            table = [json.loads(line) for line in text.split("\n") if line.strip()]
    except (ValueError, RecursionError) as error:
        reason = str(error)[:80]
        raise InputError(f"{path}: neither JSON nor a JSON object a line ({reason})") from None
    if isinstance(table, dict) and all(isinstance(column, list) for column in table.values()):
        lengths = {len(column) for column in table.values()}
        if len(lengths) > 1:
            raise InputError(f"{path}: its lists are of different lengths")
        return table
    if isinstance(table, dict):
        table = [table]
    if not isinstance(table, list) or not table:
        raise InputError(f"{path}: a table in JSON is a list of objects or an object of lists")
    for number, row in enumerate(table, 1):
        if not isinstance(row, dict) or row.keys() != table[0].keys():
            raise InputError(f"{path}: row {number} is not an object with the keys of row 1")
    return {name: [row[name] for row in table] for name in table[0]}


def _numbers(path: Path, name: str, values: Sequence[Any]) -> np.ndarray:
    out = np.empty(len(values))
    for row, value in enumerate(values):
        try:
            out[row] = float(value)
        except (TypeError, ValueError, OverflowError):
            shown = repr(value)[:60]
            raise InputError(
                f"{path}: row {row + 1}: {name[:30]} {shown} is not a number"
            ) from None
    bad = np.flatnonzero(~np.isfinite(out))
    if len(bad):
        raise InputError(f"{path}: row {bad[0] + 1}: {name[:30]} is not finite")
    return out
