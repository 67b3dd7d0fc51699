"""A user's own table: CSV, or JSON, whose columns are named, numbered or have usual names.

JSON is a list of objects, an object of lists, or an object a line. The time is a number, ISO 8601,
or a frame number that counts periods as in `eth_ucy.read_text`; ids may be texts. What the columns
are called may say their units (`t_ms`, `x [mm]`).
"""

import dataclasses
import re
from array import array
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.format import Format
from neurosym_jax.data.reading import AS_IT_SAYS, METRES, ReadOptions
from neurosym_jax.data.rows import People, assemble, frame_step, refuse_unwhole
from neurosym_jax.data.tables import read_table
from neurosym_jax.data.text import number
from neurosym_jax.data.tracks import LATE, PERIOD, Tracks
from neurosym_jax.errors import InputError

__all__ = ["FORMATS", "Columns", "names_tracks", "parse_columns", "read_columns"]

_USUAL = {
    "time": ("", "time", "t", "timestamp", "stamp", "ts", "datetime"),
    "frame": ("frame", "frame_id", "frame_number", "frame_num", "f"),
    "id": (
        *("id", "person", "person_id", "ped", "ped_id", "pedestrian", "pedestrian_id", "agent"),
        *("agent_id", "ag_id", "track", "track_id", "trackid", "p"),
    ),
    "x": ("x", "px", "pos_x", "position_x", "x_est"),
    "y": ("y", "py", "pos_y", "position_y", "y_est"),
}

_SECONDS = {
    "s": 1.0,
    **dict.fromkeys(("sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "micros", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanoseconds"), 1e-9),
}
_SUFFIX = re.compile(rf"(?:^|[ _.\[(-]+)({'|'.join([*_SECONDS, *METRES])})[\])]?$")


@dataclasses.dataclass(frozen=True)
class Columns:
    """The names of a table's columns, or their numbers from 1; empty for the usual names."""

    time: str = ""
    """Seconds, or what the name or `ReadOptions.time_unit` says, or ISO 8601."""
    frame: str = ""
    """Frame numbers, where there is no time."""
    id: str = ""
    """Who: numbers or texts."""
    x: str = ""
    y: str = ""


def parse_columns(pairs: Sequence[str]) -> Columns:
    """Columns from `time=t id=person x=px y=py`.

    Raises:
        InputError: for anything else.
    """
    known = [field.name for field in dataclasses.fields(Columns)]
    given = {}
    for pair in pairs:
        key, sign, name = pair.partition("=")
        if key not in known or not sign or not name or key in given:
            raise InputError(f"{pair}: columns are given as {'=.. '.join(known)}=.., each once")
        given[key] = name
    return Columns(**given)


def read_columns(path: Path, options: ReadOptions = AS_IT_SAYS, period: float = PERIOD) -> Tracks:
    """Read one table.

    Args:
        path: of a CSV (comma, semicolon or tab between the fields) or JSON file.
        options: names of the columns, units, and how many frames a second has.
        period: seconds of the most common step between frames, where these are numbered and
            `options` do not say how many a second has.

    Raises:
        InputError: naming file, row (from 1, the header not counted) and reason.
    """
    path = Path(path)
    columns = parse_columns(options.columns)
    names, rows = read_table(path)
    who, *places = (_find(path, names, key, getattr(columns, key)) for key in ("id", "x", "y"))
    numbered = bool(columns.frame and not columns.time) or not (
        columns.time or any(_is_usual("time", name) for name in names)
    )
    key = "frame" if numbered else "time"
    clock = _find(path, names, key, getattr(columns, key))
    stride = options.stride_of(path, period)
    if numbered and options.time_unit:
        raise InputError(f"{path}: --time-unit is of no use: {names[clock]!r} counts frames")
    if not numbered and stride is not None:
        raise InputError(f"{path}: --fps and --stride count frames, and {names[clock]!r} is a time")
    metres = _metres(path, [names[place] for place in places], options)

    wanted = (clock, *places)
    if len({who, *wanted}) < 4:
        raise InputError(f"{path}: time, id, x and y are four columns, not {columns}")
    time, x, y, ids, iso = _collect(path, names, rows, wanted, who, not numbered)
    position = np.stack([x, y], axis=1) * metres
    if numbered:
        refuse_unwhole(path, time, "frame")
        step = frame_step(path, time, stride)
        guessed = step if stride is None else None
        return assemble(path, time / step * period, ids, position, frame_step=guessed)
    time = time * _seconds(path, names[clock], options, iso)
    if np.abs(time).max() > LATE:
        row = int(np.argmax(np.abs(time))) + 1
        raise InputError(
            f"{path}: row {row}: time {time[row - 1]:g} is not a usable number of seconds: say "
            "--time-unit ms, us or ns"
        )
    return assemble(path, time, ids, position)


def _collect(
    path: Path,
    names: Sequence[str],
    rows: Iterator[Sequence[Any]],
    wanted: Sequence[int],
    who: int,
    may_be_iso: bool,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]:
    """[R] times, x and y (the columns `wanted`), [R] ids, and whether the times are ISO 8601."""
    people, codes = People(path), array("q")
    numbers = array("d"), array("d"), array("d")
    iso = False
    for row, fields in enumerate(rows, 1):
        iso = iso or (row == 1 and may_be_iso and _is_iso(fields[wanted[0]]))
        codes.append(people.code(fields[who], row))
        for column, out in zip(wanted, numbers):
            if iso and column == wanted[0]:
                out.append(_moment(path, row, fields[column]))
                continue
            try:
                out.append(number(fields[column]))
            except (TypeError, ValueError, OverflowError):
                shown = f"{names[column][:30]} {fields[column]!r}"[:90]
                hint = " (numbers are written with points)" if "," in str(fields[column]) else ""
                raise InputError(f"{path}: row {row}: {shown} is not a number{hint}") from None
    if not codes:
        raise InputError(f"{path}: the table has no rows")
    time, x, y = (np.array(values) for values in numbers)
    for column, values in zip(wanted, (time, x, y)):
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise InputError(f"{path}: row {bad[0] + 1}: {names[column][:30]} is not finite")
    return time, x, y, people.numbers(codes), iso


def names_tracks(names: Sequence[str]) -> bool:
    """Whether some of a header's names are usual for a time or frame, a person, x and y."""
    found = {key for key in _USUAL for name in names if _is_usual(key, name)}
    return found >= {"id", "x", "y"} and bool(found & {"time", "frame"})


def _unit(name: str) -> tuple[str, str]:
    """What a column's name is without the unit that it says, and the unit or nothing."""
    plain = name.strip().lower()
    match = _SUFFIX.search(plain) if len(plain) < 60 else None
    return (plain[: match.start()], match[1]) if match else (plain, "")


def _is_usual(key: str, name: str) -> bool:
    plain, unit = _unit(name)
    units = {"time": _SECONDS, "x": METRES, "y": METRES}.get(key, {})
    if unit and unit not in units:
        plain, unit = name.strip().lower(), ""
    return bool(plain or unit) and plain in _USUAL[key]


def _find(path: Path, names: Sequence[str], key: str, given: str) -> int:
    """The place of the column that serves as `key`: the one given, else the one usual name."""
    places = [
        at for at, name in enumerate(names) if (name == given if given else _is_usual(key, name))
    ]
    if given and not places and given.isdecimal() and 1 <= int(given[:9]) <= len(names):
        return int(given) - 1
    shown = ", ".join(repr(name[:30]) for name in islice(names, 12))
    if given and not places:
        raise InputError(f"{path}: no column {given[:40]!r} among {shown}")
    if len(places) > 1:
        which = " or ".join(repr(names[at][:30]) for at in places[:4])
        raise InputError(f"{path}: which column is {key}, {which}? Say --columns {key}=NUMBER")
    if not places:
        what = "time or frame" if key == "frame" else key
        raise InputError(f"{path}: which column is {what}? There are {shown}: say --columns {key}=")
    return places[0]


def _metres(path: Path, names: Sequence[str], options: ReadOptions) -> float:
    """Metres in the unit of two columns, as their names or the options say."""
    units = {_unit(name)[1] for name in names} & METRES.keys()
    if options.unit != AS_IT_SAYS.unit:
        units.add(options.unit)
    if len(units) > 1:
        raise InputError(f"{path}: {names[0]!r}, {names[1]!r} and --unit {options.unit} differ")
    return METRES[units.pop()] if units else options.metres(path)


def _seconds(path: Path, name: str, options: ReadOptions, iso: bool) -> float:
    """Seconds in the unit of a column of times."""
    if iso and options.time_unit:
        raise InputError(f"{path}: --time-unit is of no use: {name!r} has dates and times")
    own = _SECONDS.get(_unit(name)[1])
    asked = _SECONDS[options.time_unit] if options.time_unit else own
    if own is not None and asked != own and not iso:
        raise InputError(f"{path}: {name!r} says its unit, and --time-unit {options.time_unit}")
    return 1.0 if iso or asked is None else asked


def _is_iso(value: Any) -> bool:
    try:
        number(value)
    except (TypeError, ValueError):
        return isinstance(value, str) and bool(re.match(r"\s*\d{4}-?\d\d", value))
    return False


def _moment(path: Path, row: int, value: Any) -> float:
    """Seconds since 1970 of a date and time; without a zone it is taken for UTC."""
    try:
        moment = datetime.fromisoformat(str(value).strip())
    except ValueError:
        raise InputError(f"{path}: row {row}: {str(value)[:40]!r} is no date and time") from None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


FORMATS = {
    "columns": Format(
        "table with named columns",
        lambda head: head.named,
        lambda path, how, period: [read_columns(path, how, period)],
        uses=frozenset({"columns", "unit", "time_unit", "fps", "stride"}),
        general=True,
        other=lambda head: (
            head.named
            and "," in head.first
            and head.first[:1] not in ("{", "[")
            and not names_tracks(head.first.split(","))
        ),
    ),
}
