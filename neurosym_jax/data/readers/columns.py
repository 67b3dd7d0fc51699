"""A user's own table, whose columns are named, numbered or have usual names.

The time is a number, ISO 8601, or a frame number as in `eth_ucy.read_text`; ids may be texts. The
names of the columns may give their units (`t_ms`, `x [mm]`).
"""

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import islice
from pathlib import Path

import numpy as np
import polars as pl

from neurosym_jax.data.readers.meanings import keep_people, recordings_of
from neurosym_jax.data.reading import AS_IT_SAYS, METRES, ReadOptions
from neurosym_jax.data.rows import assemble, frame_step
from neurosym_jax.data.tables import Table, read_table
from neurosym_jax.data.tracks import LATE, PERIOD, Tracks
from neurosym_jax.errors import InputError

__all__ = ["names_tracks", "parse_columns", "read_columns"]

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
_ISO = r"^\d{4}-?\d\d"

COUNTED = 10
"""So many moments that are whole numbers without a unit are taken for frame numbers."""


def parse_columns(pairs: Sequence[str]) -> dict[str, str]:
    """Name or number (from 1) of the column of time (or frame), id, x, y and extras.

    Raises:
        InputError: for anything but `time=t id=person x=px y=py`, and extras as `group=g`.
    """
    columns: dict[str, str] = {}
    for pair in pairs:
        key, _, name = pair.partition("=")
        if not key.isidentifier() or not name or key in columns:
            known = "=.. ".join(_USUAL)
            raise InputError(f"{pair}: columns are given as {known}=.. (or EXTRA=..), each once")
        columns[key] = name
    return columns


def read_columns(
    path: Path, options: ReadOptions = AS_IT_SAYS, period: float = PERIOD
) -> list[Tracks]:
    """Read one table: delimited text, JSON, Parquet or Arrow.

    A column of scenes, runs or cameras splits it into recordings, and one of kinds (label, class,
    type) says which rows are people. Where there are frames beside times, the two must agree.

    Args:
        path: of the file.
        options: names of the columns, units, kinds to keep, and frames per second.
        period: seconds of the most common step between frames, where these are numbered and
            `options` do not give their rate.

    Raises:
        InputError: naming file, row (from 1, the header not counted) and reason.
    """
    columns = parse_columns(options.columns)
    table = read_table(path)
    has_time = "time" in columns or any(_is_usual("time", name) for name in table.names)
    numbered = not has_time or ("frame" in columns and "time" not in columns)
    keys = ["id", "x", "y", "frame" if numbered else "time"]
    who, x, y, clock = (_find(table, key, columns.get(key, "")) for key in keys)
    if len({clock, who, x, y}) < 4:
        raise InputError(f"{path}: {', '.join(keys)} are four columns")
    used = {name for key, name in columns.items() if key not in _USUAL}
    table, skipped, said = keep_people(table, options.keep, used)
    extras = {
        name: table.extra(_find(table, name, given))
        for name, given in columns.items()
        if name not in _USUAL
    }
    stride = options.stride_of(path, period)
    metres = _metres(path, [table.names[x], table.names[y]], options)
    names, recording = recordings_of(table, used)
    guessed = None
    if numbered:
        if options.time_unit:
            name = table.names[clock]
            raise InputError(f"{path}: --time-unit is of no use: {name!r} counts frames")
        frame = table.whole_numbers(clock)
        step = frame_step(path, frame, stride)
        time, guessed = frame / step * period, step if stride is None else None
    else:
        time = _seconds(table, clock, options, stride)
        frames = [at for at, name in enumerate(table.names) if _is_usual("frame", name)]
        if len(frames) == 1 and "time" not in columns:
            _refuse_disagreeing(table, frames[0], clock, time, recording)
    position = table.numbers(x, y) * metres
    ids, row = table.ids(who), np.arange(1, len(time) + 1) if table.row is None else table.row
    return [
        assemble(
            path,
            time[at],
            ids[at],
            position[at],
            {key: values[at] for key, values in extras.items()},
            recording=name,
            row=row[at],
            frame_step=guessed,
            skipped=skipped,
            warnings=said,
        )
        for number, name in enumerate(names)
        for at in [recording == number]
    ]


def _refuse_disagreeing(
    table: Table, frames: int, clock: int, time: np.ndarray, recording: np.ndarray
) -> None:
    """Refuse frame numbers that are not the times, up to a constant rate, in any recording."""
    frame = table.numbers(frames, missing=True)[:, 0]
    for number in range(int(recording.max()) + 1):
        at = np.flatnonzero((recording == number) & np.isfinite(frame))
        first, index = np.unique(frame[at], return_index=True)
        if len(first) < 3:
            continue
        rate, start = np.polyfit(first - first[0], time[at][index], 1)
        off = np.abs(time[at] - start - rate * (frame[at] - first[0]))
        if rate <= 0 or off.max() > 0.1 + 2 * rate + 1e-3 * np.ptp(time[at]):
            row = at[int(np.argmax(off))]
            names = table.names[frames], table.names[clock]
            raise InputError(
                f"{table.path}: row {row + 1 if table.row is None else table.row[row]}: "
                f"{names[0]!r} and {names[1]!r} disagree by {off.max():.2f} s: say which is right, "
                f"--columns frame={names[0]} or time={names[1]}"
            )


def names_tracks(names: Sequence[str]) -> bool:
    """Whether a header has usual names for a time or frame, an id, x and y."""
    found = {key for key in _USUAL for name in names if _is_usual(key, name)}
    return found >= {"id", "x", "y"} and bool(found & {"time", "frame"})


def _unit(name: str) -> tuple[str, str]:
    """A column's name without the unit in it, and the unit or nothing."""
    plain = name.strip().lower()
    match = _SUFFIX.search(plain) if len(plain) < 60 else None
    return (plain[: match.start()], match[1]) if match else (plain, "")


def _is_usual(key: str, name: str) -> bool:
    plain, unit = _unit(name)
    units = {"time": _SECONDS, "x": METRES, "y": METRES}.get(key, {})
    if unit and unit not in units:
        plain, unit = name.strip().lower(), ""
    return bool(plain or unit) and plain in _USUAL[key]


def _find(table: Table, key: str, given: str) -> int:
    """Place of the column that serves as `key`: the given one, else the only one of usual name."""
    path, names = table.path, table.names
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
    """Metres in the unit of x and y, as their names or the options say."""
    units = {_unit(name)[1] for name in names} & METRES.keys()
    if options.unit is not None:
        units.add(options.unit)
    if len(units) > 1:
        raise InputError(f"{path}: {names[0]!r}, {names[1]!r} and --unit {options.unit} differ")
    return METRES[units.pop()] if units & METRES.keys() else options.metres(path)


def _seconds(table: Table, place: int, options: ReadOptions, stride: float | None) -> np.ndarray:
    """[R] seconds in a column of times."""
    path, name, unit = table.path, table.names[place], options.time_unit
    if stride is not None:
        raise InputError(f"{path}: --fps and --stride count frames, and {name!r} is a time")
    texts = table.column(place)
    if re.match(_ISO, texts[0] or "") and texts[:1].cast(pl.Float64, strict=False).null_count():
        if unit:
            raise InputError(f"{path}: --time-unit is of no use: {name!r} has dates and times")
        return _moments(table, texts)
    own = _SECONDS.get(_unit(name)[1])
    asked = own if unit is None else _SECONDS[unit]
    if own is not None and asked != own:
        raise InputError(f"{path}: {name!r} says its unit, and --time-unit {unit}")
    time = table.numbers(place)[:, 0] * (1.0 if asked is None else asked)
    table.refuse(
        np.abs(time) > LATE,
        lambda at: (
            f"time {time[at]:g} is not a usable number of seconds: say --time-unit ms, us or ns"
        ),
    )
    moments = np.unique(time)
    if asked is None and len(moments) > COUNTED and (moments == np.rint(moments)).all():
        raise InputError(
            f"{path}: all of {name!r} are whole numbers: do they count frames (--columns "
            f"frame={name} --fps 25), or is that their unit (--time-unit s or ms)?"
        )
    return time


def _moments(table: Table, texts: pl.Series) -> np.ndarray:
    """[R] seconds since 1970 of dates and times; UTC where they name no zone."""

    def moment(text: str | None) -> float:
        try:
            found = datetime.fromisoformat(text or "")
        except ValueError:
            return np.nan
        return (found if found.tzinfo else found.replace(tzinfo=UTC)).timestamp()

    seconds = np.array([moment(text) for text in texts])
    table.refuse(np.isnan(seconds), lambda at: f"{str(texts[at])[:40]!r} is not a date and time")
    return seconds
