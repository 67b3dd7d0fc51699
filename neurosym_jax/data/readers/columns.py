"""A user's own table, whose columns are named, numbered or have usual names.

A column of scenes, runs or cameras splits the table into recordings. Columns of kinds (label,
class, type) say which rows are people. Frames beside times must agree with them.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import polars as pl

from neurosym_jax.data.reading import Format, Head, ReadOptions
from neurosym_jax.data.table import Table, read_table
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, printable

__all__ = ["Columns", "names_tracks"]

_USUAL = {
    "time": {"time", "t", "timestamp", "stamp", "ts", "datetime"},
    "frame": {"frame", "frame_id", "frame_number", "frame_num", "f"},
    "id": {"id", "person", "person_id", "ped", "ped_id", "pedestrian", "pedestrian_id", "p"}
    | {"agent", "agent_id", "ag_id", "track", "track_id", "trackid"},
    "x": {"x", "px", "pos_x", "position_x", "x_est"},
    "y": {"y", "py", "pos_y", "position_y", "y_est"},
}
_RECORDINGS = re.compile(
    r"(scene|run|camera|cam|recording|video|sequence|session|clip|trial|take|episode|experiment|"
    r"dataset|scenario|file|day)([ _-]?(id|name|number|no|nr))?",
    re.IGNORECASE,
)
_KINDS = re.compile(
    r"((agent|actor|obj|object|track)[ _-]?)?(class|label|type|kind|category)([ _-]?(name|id))?"
    r"|lost|outside|valid",
    re.IGNORECASE,
)
_PEOPLE = (
    "person persons people human humans ped peds pedestrian pedestrians walker adult child "
    "visitor worker man woman"
)
_OTHERS = (
    "robot robots car vehicle truck bus cart bicycle bike biker cyclist bicyclist motorcycle "
    "motorcyclist scooter skater dog"
)
_FLAGS = {"lost": "0 0.0 false no", "outside": "0 0.0 false no", "valid": "1 1.0 true yes"}
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class Columns(Format):
    """A user's own table."""

    title = "table with named columns"
    uses = frozenset({"columns", "fps", "keep", "time_unit", "unit"})

    def knows(self, head: Head) -> bool:
        """A header with names."""
        return bool(head.names)

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in one table, of a file or a dataframe.

        Raises:
            InputError: naming file, row and reason.
        """
        columns: dict[str, str] = {}
        for pair in options.columns:
            key, _, name = pair.partition("=")
            if not key.isidentifier() or not name or key in columns:
                known = "=.. ".join(_USUAL)
                raise InputError(
                    f"{pair}: columns are given as {known}=.. (or EXTRA=..), each once"
                )
            columns[key] = name
        table = read_table(path)
        timed = "frame" not in columns and _places(table.names, "time")
        clock = "time" if timed or "time" in columns else "frame"
        keys = (clock, "id", "x", "y", *(columns.keys() - _USUAL))
        place = {key: _find(table, key, columns.get(key, "")) for key in keys}
        points = {place[key] for key in keys[:4]}
        if len(points) < 4:
            raise InputError(f"{table.path}: {clock}, id, x and y are four columns")
        table, said = _people(table, options.keep, points)
        runs = {at for at, name in enumerate(table.names) if _RECORDINGS.fullmatch(name)}
        keys = ["_".join(row) for row in zip(*map(table.column, sorted(runs - {*place.values()})))]
        kinds, part = np.unique(keys or [""] * len(table.row), return_inverse=True)
        names = [printable(f"{table.path.stem}_{kind}"[:200]) for kind in kinds]
        names = names if len(names) > 1 else [printable(table.path.stem)]
        if clock == "time":
            stamp = _seconds(table, place[clock], options)
            if "time" not in columns:
                _refuse_other_frames(table, place[clock], stamp, part)
        elif options.time_unit:
            raise InputError(f"{table.path}: --time-unit is of no use: the column counts frames")
        else:
            stamp = table.times(place[clock], table.ids(place["id"]), options, period)
        frames = place[clock] if clock == "frame" else None
        position = table.numbers(place["x"], place["y"]) * options.metres
        extras = {key: table.extra(at) for key, at in place.items() if key not in _USUAL}
        ids = table.ids(place["id"])
        order = np.lexsort((stamp, ids))
        over = (np.diff(ids[order]) == 0) & (np.diff(stamp[order]) <= 1)
        over &= np.diff(part[order]) != 0
        moves = np.linalg.norm(np.diff(position[order], axis=0)[over], axis=1)
        if len(moves) and np.median(moves) < 1:
            went = f"{len(moves)} times a person goes on in another recording: is it one that a"
            said.append(f"{went} column splits (--columns camera=camera does not split)?")
        return table.tracks(
            stamp, ids, position, extras, parts=(names, part), said=said, clock=frames
        )


def names_tracks(names: Sequence[str]) -> bool:
    """Whether a header has usual names for a time or frame, an id, x and y."""
    found = {key for key in _USUAL if _places(names, key)}
    return found >= {"id", "x", "y"} and bool(found & {"time", "frame"})


def _places(names: Sequence[str], key: str) -> list[int]:
    return [at for at, name in enumerate(names) if name.lower() in _USUAL.get(key, ())]


def _find(table: Table, key: str, given: str) -> int:
    """Place of the column that serves as `key`: the given one, else the only one of usual name."""
    names = table.names
    named = [at for at, name in enumerate(names) if name == given]
    places = named if given else _places(names, key)
    if not places and given.isdecimal() and 1 <= int(given[:9]) <= len(names):
        return int(given) - 1
    if len(places) != 1:
        what = "time or frame" if key == "frame" else key
        shown = ", ".join(repr(name[:30]) for name in names[:12])
        no = f"no column {given[:40]!r}: " * bool(given and not places)
        raise InputError(
            f"{table.path}: {no}which column is {what}? There are {shown}: say --columns {key}="
        )
    return places[0]


def _seconds(table: Table, place: int, options: ReadOptions) -> np.ndarray:
    """[R] seconds in a column of times."""
    path, name, unit = table.path, table.names[place], options.time_unit
    if options.fps is not None:
        raise InputError(f"{path}: --fps counts frames, and {name!r} is a time")
    texts = table.column(place)
    if re.match(r"\d{4}-\d\d-", texts[0]) and not unit:
        moments = texts.str.to_datetime(time_unit="us", time_zone="UTC", strict=False)
        wrong = moments.is_null().to_numpy()
        table.refuse(wrong, lambda at: f"{texts[at][:40]!r} is not a date and time")
        return moments.dt.timestamp("us").to_numpy() / 1e6
    stamp = table.numbers(place)[:, 0] * _SECONDS[unit or "s"]
    counts = np.unique(stamp)
    if not unit and len(counts) > 10 and (counts == np.rint(counts)).all():
        raise InputError(
            f"{path}: all of {name!r} are whole numbers: do they count frames (--columns "
            f"frame={name} --fps 25), or is that their unit (--time-unit s or ms)?"
        )
    return stamp


def _refuse_other_frames(table: Table, clock: int, stamp: np.ndarray, part: np.ndarray) -> None:
    """Refuse a column of frames that counts anything but the times [R] of each recording [R]."""
    places = _places(table.names, "frame")
    frame = table.numbers(*places, missing=True).ravel() if len(places) == 1 else np.zeros(0)
    for number in np.unique(part[: len(frame)]):
        at = (part == number) & np.isfinite(frame)
        first, index = np.unique(frame[at], return_index=True)
        if len(first) < 3:
            continue
        rate, start = np.polyfit(first - first[0], stamp[at][index], 1)
        off = np.max(np.abs(stamp[at] - start - rate * (frame[at] - first[0])))
        if rate <= 0 or off > 0.1 + 2 * rate + 1e-3 * np.ptp(stamp[at]):
            frames, times = table.names[places[0]], table.names[clock]
            raise InputError(
                f"{table.path}: columns {frames!r} and {times!r} disagree: say which is right, "
                f"--columns frame={frames} or time={times}"
            )


def _people(table: Table, keep: Sequence[str], used: set[int]) -> tuple[Table, list[str]]:
    """The rows of people by every column of kinds, and a line for what each leaves out."""
    places = [
        at
        for at, name in enumerate(table.names)
        if at not in used
        # By its name or, of the first columns (there may be millions), by what it says.
        and (_KINDS.fullmatch(name) or (at < 50 and _lower(table, at).is_in(_OTHERS.split()).any()))
    ]
    wanted, said = [kind.lower() for kind in keep] or _PEOPLE.split(), []
    if keep and all(table.names[at].lower() in _FLAGS for at in places):
        raise InputError(f"{table.path}: --keep: no column is a label, class, type or category")
    for at in places:
        name, kinds = table.names[at][:30], table.column(at)
        mask = _lower(table, at).is_in(_FLAGS.get(name.lower(), "").split() or wanted).to_numpy()
        others = kinds.filter(~mask).unique(maintain_order=True)
        shown = printable(", ".join(kind[:30] or "nothing" for kind in others[:6]))
        if not mask.any():
            raise InputError(
                f"{table.path}: column {name!r} has {shown}: say with --keep which are people"
            )
        if not mask.all():
            left = f"{np.sum(~mask)} rows with {name} {shown} are left out"
            said.append(f"{left} (--keep says who is kept)")
            table = table.take(mask)
    return table, said


def _lower(table: Table, place: int) -> pl.Series:
    return table.column(place).str.to_lowercase()
