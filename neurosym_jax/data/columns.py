"""What the columns of a table mean: names and roles, proposals for those without a name,
what stands beside the table, positions in metres, and times.
"""

import contextlib
import dataclasses
import functools
import glob
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.evidence import doubts_of, roughness
from neurosym_jax.data.tables import (
    METRES,
    STEPS,
    Question,
    ReadOptions,
    Table,
    Unsaid,
    absent,
    metres_in,
    read_table,
    read_text_file,
)
from neurosym_jax.data.tracks import Tracks, common, make_tracks
from neurosym_jax.errors import InputError, option
from neurosym_jax.runtime.foreign import SETTINGS, read_json

__all__ = [
    "BOX",
    "FLAGS",
    "RATE_NAMES",
    "ROLES",
    "SWAP",
    "Schema",
    "column_name",
    "facts_of",
    "kinds_beside",
    "names_in_comments",
    "names_tracks",
    "outside",
    "parse_columns",
    "plain_name",
    "positions_of",
    "project",
    "propose",
    "read_homography",
    "role_of",
    "schema_of",
    "stamps_of",
    "usual_step",
    "vocabulary",
]


# Which columns may be the clock, the id and positions, by their values alone.

ROUGHEST = 0.5
"""Sum of the roughness of x and y above which nothing is proposed: of 7 tables of walkers it is at
most 0.06, of boxes of one moment in seven cameras 1.3."""
SET_BACK = 10.0
"""Roughness that is added to what may be a height; that of a track is less."""
SAMPLED, MOST = 20_000, 12  # rows and columns that are looked at
JUDGED = 24  # smoothest readings whose people are judged
SMOOTHER = 0.7
"""Share of the roughness of an earlier reading that makes a later one better."""


def propose(table: Table, places: Mapping[str, int]) -> dict[str, int]:
    """Columns for the roles that are missing, by values: the reading with the fewest doubts.

    The id repeats, the clock is a number; x and y follow each other, perhaps with one
    between. Of readings that are doubted alike the smoothest is taken, of those as
    smooth the first.
    """
    part = _complete(table.take(np.arange(len(table.row)) < SAMPLED))
    readings = []
    for reading in _possible(part, places):
        rough = reading.roughness
        if rough < np.inf and rough % SET_BACK <= ROUGHEST:
            readings.append(reading)
    readings.sort(key=lambda reading: reading.roughness)
    readings = readings[:JUDGED]
    if not readings:
        return {}
    doubts = [doubts_of(reading.tracks()) for reading in readings]
    fewest = min(doubts)
    least_doubted = [
        reading for reading, count in zip(readings, doubts) if count == fewest
    ]
    limit = least_doubted[0].roughness / SMOOTHER
    smooth = [reading for reading in least_doubted if reading.roughness <= limit]
    best = min(smooth, key=lambda reading: reading.columns)

    moment, person, x, y = best.columns
    clock = "frame" if (best.moment % 1 == 0).all() else "time"
    roles = {clock: moment, "id": person, "x": x, "y": y}
    if {"time", "frame"} & places.keys():
        del roles[clock]
    if "left" in places:
        del roles["x"], roles["y"]
    return {role: at for role, at in roles.items() if role not in places}


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """Columns that may be the clock, the id and positions."""

    columns: tuple[int, int, int, int]
    moment: np.ndarray  # [R]
    ids: np.ndarray  # [R]
    position: np.ndarray  # [R, 2]
    roughness: float

    def tracks(self) -> Tracks:
        """The tracks that it gives, at steps of a second or so and about their middle."""
        moments = np.unique(self.moment)
        stamp = (self.moment - moments[0]) / np.median(np.diff(moments))
        position = self.position - self.position.mean(axis=0)
        return make_tracks("proposal", stamp, self.ids, position)


def _complete(table: Table) -> Table:
    """The rows without an empty field if there are some: others have no position."""
    columns = range(min(len(table.names), MOST))
    is_empty = [absent(table.column(at)).to_numpy() for at in columns]
    is_complete = ~np.any(is_empty, axis=0)
    if is_complete.mean() > 0.25:
        return table.take(is_complete)
    return table


def _possible(table: Table, places: Mapping[str, int]) -> Iterator[_Candidate]:
    """The readings of a table in which nobody is at two places at one moment."""
    columns = range(min(len(table.names), MOST))
    free = [at for at in columns if at not in places.values()]
    clock = places.get("time", places.get("frame"))
    x = places.get("x", places.get("left"))
    y = places.get("y", places.get("top"))
    numbers = {}
    for at in sorted({*free, clock, x, y} - {None}):
        values = _numbers(table, at)
        if values is not None:
            numbers[at] = values
    moments = [at for at in free if at in numbers]
    if clock is not None:
        moments = [clock]
    people = [at for at in free if _repeats(table, at)]
    if "id" in places:
        people = [places["id"]]
    pairs = []
    for first, second in itertools.combinations(numbers, 2):
        is_near = second - first <= 2
        if is_near and x in (None, first) and y in (None, second):
            pairs.append((first, second))
    if x is not None and y is not None:
        pairs = [(x, y)]

    for moment, person in itertools.product(moments, people):
        if moment == person or moment not in numbers:
            continue
        ids = table.column(person).rank("dense").to_numpy()
        bends = _bends(numbers, numbers[moment], ids)
        for pair in pairs:
            if {moment, person}.isdisjoint(pair) and bends.keys() >= set(pair):
                position = np.column_stack([numbers[at] for at in pair])
                roughest = bends[pair[0]] + bends[pair[1]]
                columns = (moment, person, *pair)
                yield _Candidate(columns, numbers[moment], ids, position, roughest)


def _bends(
    numbers: Mapping[int, np.ndarray], moment: np.ndarray, ids: np.ndarray
) -> dict[int, float]:
    """The roughness of each column along tracks.

    A column with one number for all people at a moment is another clock. One with one
    number for each person may be a height: it is a coordinate only where no other column
    is left.
    """
    bends = {}
    rough = roughness(moment, ids, np.column_stack(list(numbers.values())))
    for at, bend in zip(numbers, rough):
        if _varies(moment, numbers[at]):
            bends[at] = bend if _varies(ids, numbers[at]) else bend + SET_BACK
    return bends


def _varies(keys: np.ndarray, values: np.ndarray) -> bool:
    """Whether there are several of the values for a key."""
    pairs = np.unique(keys + 1j * values)
    return len(pairs) > 1.2 * len(np.unique(keys))


def as_box(table: Table, places: Mapping[str, int]) -> dict[str, int]:
    """The columns x and y and the two behind them as those of a box in a picture, if these are as
    its other corner or its size; else nothing."""
    left = places.get("x", -1)
    top = places.get("y", -1)
    behind = (top + 1, top + 2)
    if top != left + 1 or top < 1 or behind[1] >= len(table.names):
        return {}
    if not set(behind).isdisjoint(places.values()):
        return {}
    columns = (left, top, *behind)
    values = np.column_stack([table.extra(at, texts=False) for at in columns])
    first, second = values[:, :2], values[:, 2:]
    if (second > first).all():
        roles = ("left", "top", "right", "bottom")
    elif (second > 0).all():
        roles = ("left", "top", "width", "height")
    else:
        return {}
    others = {role: at for role, at in places.items() if role not in "xy"}
    return others | dict(zip(roles, columns))


def _numbers(table: Table, at: int) -> Any:
    """[R] numbers of a column; None where most fields are others."""
    values = table.extra(at, texts=False)
    if np.isfinite(values).mean() > 0.5:
        return np.nan_to_num(values)
    return None


def _repeats(table: Table, at: int) -> bool:
    """Whether a column's values repeat, as ids do; fractions never do."""
    texts = table.column(at)
    values = table.extra(at, texts=False)
    has_fractions = np.isfinite(values) & (np.nan_to_num(values) % 1 != 0)
    return 2 * texts.n_unique() <= len(texts) and not has_fractions.any()


# The schema of a table: which column has which role and unit, as a user or the names
# say.
#
# The words of names stand in `vocabulary.tsv`. What names do not settle is proposed by
# values, as a command to paste; it is never read without that.

BOX = ("left", "top", "right", "bottom", "width", "height")
FLAGS = ("lost", "valid", "state", "confidence")  # rows that are no positions
ROLES = ("time", "frame", "id", "x", "y", *BOX, *FLAGS, "label", "vx", "vy")
DEGREES = "deg"  # unit of longitudes and latitudes
_UNITS = {
    # unit as names write it: as options do
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), "m"),
    **{unit: unit for unit in ("cm", "mm", "s", "ms", "us", "ns")},
    **dict.fromkeys(("px", "pix", "pixel", "pixels"), "px"),
    **dict.fromkeys(("sec", "secs", "seconds"), "s"),
    **dict.fromkeys(("deg", "degree", "degrees", "°"), DEGREES),
    "ft": "0.3048",
    "feet": "0.3048",
    "km": "1000",
    "µs": "us",
    "msec": "ms",
    "usec": "us",
}
_GLOBE = ("lon", "lng", "longitude", "lat", "latitude")  # columns in degrees
_UNIT = re.compile(r"^(.*?\w)\s*(?:[\[(](.+?)[\])]|[\s_/.-](\w+))$")


@dataclasses.dataclass(frozen=True)
class Schema:
    """Roles and other names, the extras, of the columns of a table."""

    places: Mapping[str, int]  # column of each role or extra
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Of time, x and y, by name."""
    flags: tuple[tuple[str, int], ...] = ()  # roles and columns of `FLAGS`
    labels: tuple[int, ...] = ()  # further columns of kinds, by their names
    sizes: tuple[int, ...] = ()  # columns of a width and a height beside x and y
    heights: tuple[int, ...] = ()  # columns of z beside x and y
    recordings: tuple[int, ...] = ()  # columns that tell recordings apart
    declared: frozenset[str] = frozenset()  # the roles that the user gave

    @property
    def clock(self) -> str:
        """`time` or `frame`."""
        return "time" if "time" in self.places else "frame"

    @property
    def is_box(self) -> bool:
        """Whether positions are boxes in a picture."""
        return not {"left", "height"}.isdisjoint(self.places)

    @property
    def in_picture(self) -> bool:
        """Whether positions are pixels."""
        return self.is_box or "px" in self.units.values()

    @property
    def in_degrees(self) -> bool:
        """Whether positions are a longitude and a latitude."""
        return self.units.get("x") == DEGREES

    @property
    def extras(self) -> dict[str, int]:
        """The columns that a user named otherwise than a role."""
        return {name: at for name, at in self.places.items() if name not in ROLES}


@functools.cache
def vocabulary() -> dict[str, frozenset[str]]:
    """The words of each role, and of `recording`, `people` and `others`."""
    path = files("neurosym_jax.data").joinpath("vocabulary.tsv")
    words = {}
    for line in path.read_text(encoding="utf-8").splitlines()[1:]:
        role, texts = line.split("\t")
        words[role] = frozenset(texts.split())
    return words


def plain_name(name: str) -> tuple[str, str]:
    """A column's name in lower-case letters and digits, and its unit, else nothing."""
    name = name.strip().lower()[:60]
    unit = ""
    match = _UNIT.match(name)
    if match:
        unit = _UNITS.get((match[2] or match[3]).strip(), "")
        name = match[1] if unit else name
    word = re.sub(r"[\W_]", "", name)
    return word, DEGREES if word in _GLOBE else unit


def role_of(name: str) -> str:
    """The role that a column's name says, else nothing."""
    name = name.removeprefix("field.")  # Of `rostopic echo -p`.
    word = short = plain_name(name)[0]
    parts = name.split(".")
    if len(parts) > 2:  # As `pose.position.x`.
        short = plain_name(".".join(parts[-2:]))[0]
    for role, words in vocabulary().items():
        if word in words or short in words:
            return role
    return ""


def parse_columns(columns: Iterable[str]) -> tuple[dict[str, str], bool | None]:
    """The columns that a user gave by role, and whether there is a header, if that was said.

    Raises:
        InputError: for what is not ROLE=COLUMN, and a role that stands twice.
    """
    stated: dict[str, str] = {}
    for pair in columns:
        key, _, name = pair.partition("=")
        if not key.isidentifier() or not name or key in stated:
            raise InputError(
                f"{pair}: columns are given as time=.. frame=.. id=.. x=.. y=.. (or another of "
                f"{' '.join(ROLES[5:])}, or EXTRA=..), each once"
            )
        stated[key] = name
    header = stated.pop("header", None)
    if header not in (None, "yes", "no"):
        raise InputError(f"header={header}: say header=no or header=yes")
    return stated, None if header is None else header == "yes"


def names_tracks(names: Sequence[str]) -> bool:
    """Whether a header names a clock, an id and positions."""
    roles = set(map(role_of, names))
    return "id" in roles and bool(roles & {"time", "frame"}) and _has_position(roles)


def _has_position(roles: Iterable[str]) -> bool:
    roles = set(roles)
    has_corner = {"left", "top"} <= roles
    has_width = not roles.isdisjoint({"right", "width"})
    has_height = not roles.isdisjoint({"bottom", "height"})
    return {"x", "y"} <= roles or (has_corner and has_width and has_height)


def names_in_comments(comments: Sequence[str], width: int) -> list[str]:
    """The names of `width` columns in the last comment that has them; none if none has."""
    for comment in reversed(comments):
        for mark in (None, ",", ";", "\t"):
            names = comment.split(mark)
            roles = {role_of(name) for name in names}
            if len(names) == width and {"id", "x", "y"} <= roles:
                return [name.strip() for name in names]
    return []


def schema_of(
    table: Table, stated: Mapping[str, str], in_picture: bool = False
) -> Schema:
    """The columns that the user has `stated`, by name or number from 1, and those whose names say.

    Positions are pixels where `in_picture` says so.

    Raises:
        Question: naming every role that is missing or stands twice.
        InputError: for a column that is not there.
    """
    declared = dict[str, int]()
    for role, name in stated.items():
        if name != "none" or "none" in table.names:
            declared[role] = _place(table, role, name)
    named = _named(table, stated, declared)
    sizes = (*named.get("width", [])[:1], *named.get("height", [])[:1])
    named = _without_other_positions(named, stated)

    places = dict(declared)
    clocks = {"time", "frame"}
    for role in ROLES:
        columns = named.get(role, [])
        if role == "id" and len(columns) > 1:  # The number of a row is nobody's.
            columns = [at for at in columns if _repeats(table, at)]
        if role in places or (role in clocks and clocks & stated.keys()):
            continue
        if len(columns) == 1 or (columns and role in ("vx", "vy", *FLAGS)):
            places[role] = columns[0]
    _refuse_missing(table, places, named, in_picture)
    points = [role for role in (*ROLES[:5], *BOX) if role in places]
    if len({places[role] for role in points}) < len(points):
        raise InputError(
            f"{table.path}: {', '.join(points)} must be {len(points)} columns"
        )

    flags = set[tuple[str, int]]()
    for role in FLAGS:
        columns = set(named.get(role, ()))
        if role in places:
            columns.add(places[role])
        flags |= {(role, at) for at in columns}
    labels = named.get("label", [])
    recordings = [
        at for at in named.get("recording", []) if at not in declared.values()
    ]
    is_named = not {"x", "y"} & stated.keys()
    return Schema(
        places,
        _units(table, places),
        flags=tuple(sorted(flags)),
        labels=() if "label" in stated else tuple(labels),
        sizes=sizes if is_named and len(sizes) == 2 else (),
        heights=tuple(named.get("z", ())) if is_named else (),
        recordings=tuple(recordings),
        declared=frozenset(stated),
    )


def _units(table: Table, places: Mapping[str, int]) -> dict[str, str]:
    """The units that names of columns say, by role."""
    units = {}
    for role in ("time", "x", "y", "left", "vx"):
        unit = ""
        if role in places:
            _, unit = plain_name(table.names[places[role]])
        if unit:
            units[role] = unit
    return units


def _named(
    table: Table, stated: Mapping[str, str], declared: Mapping[str, int]
) -> dict[str, list[int]]:
    """The columns whose names say a role that the user has not stated."""
    taken = {at for role, at in declared.items() if role in ROLES}
    named = dict[str, list[int]]()
    for at, name in enumerate(table.names):
        role = role_of(name)
        if role and role not in stated and at not in taken:
            named.setdefault(role, []).append(at)
    return named


def _without_other_positions(
    named: dict[str, list[int]], stated: Iterable[str]
) -> dict[str, list[int]]:
    """The columns without those of boxes, or without x and y, where the others are the positions."""
    states_points = not {"x", "y"}.isdisjoint(stated)
    states_boxes = not set(BOX).isdisjoint(stated)
    others = ()
    if states_points or (not states_boxes and {"x", "y"} <= named.keys()):
        others = BOX
    elif states_boxes or _has_position(named.keys() - {"x", "y"}):
        others = ("x", "y")
    return {role: columns for role, columns in named.items() if role not in others}


def _refuse_missing(
    table: Table,
    places: Mapping[str, int],
    named: Mapping[str, Sequence[int]],
    in_picture: bool,
) -> None:
    """Ask for the clock, the id and the position where they are missing, with what values propose."""
    required = []
    if not {"time", "frame"} & places.keys():
        required.append("time or frame")
    if "id" not in places:
        required.append("id")
    if not _has_position(places):
        required += [role for role in ("x", "y") if role not in places]
    if not required:
        return
    if len(table.names) < 3:
        raise InputError(
            f"{table.path}: only the columns {_shown(table)}: separate columns by commas, "
            "semicolons, tabs or blanks"
        )

    # Of columns with one role each is tried; their values are compared by who asks.
    unclear = [role for role in ("time", "frame", "id", "x", "y") if role not in places]
    choices = [named.get(role, [None]) for role in unclear]
    answers = {}
    for choice in itertools.islice(itertools.product(*choices), 16):
        guess = dict(places)
        for role, at in zip(unclear, choice):
            if at is not None and not (role == "frame" and "time" in guess):
                guess[role] = at
        guess |= propose(table, guess)
        boxed = as_box(table, guess)
        if not (boxed and in_picture):
            answers[_written(table, guess)] = ""
        if boxed:
            answers[_written(table, boxed)] = "where they are of a box in a picture"
    raise Question(
        f"{table.path}: which column is {', '.join(required)}? There are {_shown(table)}",
        answers,
    )


def _written(table: Table, places: Mapping[str, int]) -> tuple[str, ...]:
    """What a user writes of columns; without an id all rows are one person's."""
    roles = [role for role in dict.fromkeys((*ROLES, *places)) if role in places]
    written = [f"{role}={column_name(table, places[role])}" for role in roles]
    if "id" not in places:
        written.append("id=none")
    return tuple(written)


def _place(table: Table, key: str, name: str) -> int:
    """The column with this number from 1, or this name."""
    names = list(table.names)
    count = 0 if name.isdecimal() else names.count(name)
    if count == 1:
        return names.index(name)
    if count:
        raise InputError(
            f"{table.path}: {key}={name}: {count} columns are called so; say a number"
        )
    if name.isdecimal() and 1 <= int(name[:9]) <= len(names):
        return int(name) - 1
    raise InputError(
        f"{table.path}: no column {name[:40]!r}: which column is {key}? There are {_shown(table)}"
    )


def _shown(table: Table) -> str:
    return ", ".join(repr(name[:30]) for name in table.names[:12])


def column_name(table: Table, at: int) -> str:
    """The name of a column as `columns` takes it, or its number from 1."""
    name = table.names[at]
    is_plain = name.isprintable() and not name.isdecimal()
    is_only = list(table.names).count(name) == 1
    return name if name and is_plain and is_only else str(at + 1)


# From coordinates of a picture to metres, and back: homographies, scales and
# handedness.
#
# Positions have x to the right, y up, so that left is counter-clockwise. In pictures y
# points down.

FLAT = 0.05  # share of the spread of x and of z below which y may be a height
EARTH = 6_371_008.8  # its mean radius in metres
SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def read_homography(text: str | Path) -> np.ndarray:
    """[3, 3] matrix from (column, row, 1) of a picture to metres, of `FILE` or `FILE,row-column`.

    The file has nine numbers; with `row-column` they are for (row, column, 1), as
    EWAP's.

    Raises:
        InputError: naming the file that cannot be used.
    """
    name, _, order = str(text).partition(",")
    if order not in ("", "row-column", "column-row"):
        raise InputError(
            f"{text}: the order of a homography is row-column or column-row"
        )
    fields = read_text_file(Path(name)).replace(",", " ").replace(";", " ").split()
    try:
        matrix = np.array(fields, float).reshape(3, 3)
        if not np.isfinite(np.linalg.inv(matrix)).all():
            raise ValueError("not finite")
    except ValueError as error:  # LinAlgError is one.
        raise InputError(
            f"{name}: 3 x 3 numbers that have an inverse are wanted ({error})"
        ) from None
    return matrix @ SWAP if order == "row-column" else matrix


def project(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    """[..., 2] images of `points [..., 2]`; NaN on and behind the horizon.

    The side of the horizon is that of most points.
    """
    mapped = points @ matrix[:, :2].T + matrix[:, 2]
    depth = mapped[..., 2:]
    side = np.sign(np.median(depth) or 1.0)
    usable = depth * side > 1e-12 * np.abs(depth).max()
    images = np.full(points.shape, np.nan)
    return np.divide(mapped[..., :2], depth, out=images, where=usable)


def outside(matrix: np.ndarray, points: np.ndarray, width: int, height: int) -> float:
    """Share of `points [P, 2]`, in metres, that lie outside a picture of this size in pixels."""
    pixels = project(np.linalg.inv(matrix), points)
    last = [width - 0.5, height - 0.5]
    with np.errstate(invalid="ignore"):
        is_inside = ((pixels >= -0.5) & (pixels <= last)).all(axis=-1)
    return float(1 - is_inside.mean())


def positions_of(
    table: Table, schema: Schema, options: ReadOptions, unit: str | None
) -> tuple[Table, np.ndarray, np.ndarray]:
    """The rows with a position, [R, 2] metres, and [R, 2] in the file's unit.

    `unit` is what the file says of itself.

    Raises:
        InputError: where no row has one, or their unit is not known or said twice.
    """
    table, raw = _points_of(table, schema, options)
    stated = options.unit_of(table.path.stem)
    if stated and unit and abs(metres_in(stated) / metres_in(unit) - 1) > 1e-6:
        user = option("unit", stated)
        if "scale" not in options.allow:
            raise InputError(
                f"{table.path}: the file says that coordinates are {unit}, {user}: which is "
                f"right? ({option('allow', ('scale',))} takes the option)"
            )
        table = table.warned(f"allowed scale: the file says {unit}, {user}")
    if schema.in_degrees:
        return _local_metres(table, raw, options)
    has_scale = stated or unit or options.homography
    if schema.in_picture and not has_scale:
        raise Unsaid(
            f"{table.path}: positions are pixels of a picture: say what they are in metres, by "
            f"{option('homography', 'FILE')} or metres of a pixel, {option('unit', '0.032')}"
        )
    if options.homography:
        position = project(read_homography(options.homography), raw)
        table.refuse(
            np.isnan(position).any(axis=1),
            lambda at: f"{raw[at]} lies beyond the homography's horizon",
        )
        position = position * metres_in(stated or "m")
    else:
        position = raw * metres_in(stated or unit or "m")
    # Rows of pictures count downward; a homography turns them itself.
    is_turned = schema.in_picture and not options.homography
    if options.flip_y or is_turned:
        table = table.noted("y is turned round, to point up")
    if options.flip_y != is_turned:
        position = position * [1, -1]
    return table, position, raw


def _points_of(
    table: Table, schema: Schema, options: ReadOptions
) -> tuple[Table, np.ndarray]:
    """The rows with a position, and [R, 2] points, or middles of the lower edges of boxes."""
    _refuse_other_points(table, schema, options)
    roles = [role for role in ("x", "y", *BOX) if role in schema.places]
    values = table.numbers(*(schema.places[role] for role in roles), missing=True)
    values[values == options.missing] = np.nan
    is_seen: Any = ~np.isnan(values).any(axis=1)
    if not is_seen.any():
        raise InputError(f"{table.path}: no row has a position")
    table = table.take(is_seen, "without a position")
    column = dict(zip(roles, values[is_seen].T))
    if "x" in column:
        y = column["y"]
        if "height" in column:  # Of a box, x and y are the middle.
            y = y + column["height"] / 2
        return table, np.column_stack([column["x"], y])

    left, top = column["left"], column["top"]
    right = column["right"] if "right" in column else left + column["width"]
    bottom = column["bottom"] if "bottom" in column else top + column["height"]
    table.refuse(
        (right < left) | (bottom < top),
        lambda at: "the box ends before it begins (left top right bottom)",
    )
    return table, np.column_stack([(left + right) / 2, bottom])


def _refuse_other_points(table: Table, schema: Schema, options: ReadOptions) -> None:
    """Ask whether x and y are of a box in a picture, and whether y is a height."""
    if "x" not in schema.places:
        return
    x, y = (column_name(table, schema.places[role]) for role in "xy")
    is_scaled = (options.unit or "m") not in METRES or options.homography
    if schema.sizes and (is_scaled or schema.in_picture):
        width, height = (column_name(table, at) for at in schema.sizes)
        size = (f"width={width}", f"height={height}")
        raise Question(
            f"{table.path}: {x}, {y}, {width} and {height} are of a box",
            {
                (f"left={x}", f"top={y}", *size): "where x, y is its upper left corner",
                (f"x={x}", f"y={y}", *size): "where it is its middle",
            },
        )
    if len(schema.heights) == 1:
        columns = schema.places["x"], schema.places["y"], *schema.heights
        values = table.numbers(*columns, missing=True)
        spread = np.nanstd(values, axis=0)
        if spread[1] < FLAT * min(spread[0], spread[2]):
            z = column_name(table, schema.heights[0])
            raise Question(
                f"{table.path}: {y} hardly varies beside {x} and {z}, as a height does",
                {(f"x={x}", f"y={z}"): ""},
            )


def _local_metres(
    table: Table, degrees: np.ndarray, options: ReadOptions
) -> tuple[Table, np.ndarray, np.ndarray]:
    """Metres east and north of the middle, of [R, 2] longitudes and latitudes."""
    table.refuse(
        (np.abs(degrees) > [180, 90]).any(axis=1),
        lambda at: f"{degrees[at]} is no longitude and latitude",
    )
    if options.unit or options.homography:
        raise InputError(
            f"{table.path}: longitudes and latitudes have no {option('unit')} or homography"
        )
    middle = np.median(degrees, axis=0)
    scale = EARTH * np.array([np.cos(np.radians(middle[1])), 1.0])
    position = np.radians(degrees - middle) * scale
    east, north = middle
    table = table.noted(f"degrees, as metres east and north of {north:.6f}, {east:.6f}")
    return table, position, position


# What a table says of its own clock, scale and kinds, beside positions: the witnesses.
#
# Comments, names, velocity columns, what a database stores and files beside the table
# each give a rate or a unit. Two that contradict each other are refused, and both are
# named.

_RATE = re.compile(
    r"\b(frame[\s_-]*rate|fps|frames?[\s_-]*per[\s_-]*second)\b\W*(\d+(?:\.\d+)?)|"
    r"(\d+(?:\.\d+)?)\s*(?:fps|frames per second)\b",
    re.IGNORECASE,
)
_RATE_UNIT = re.compile(
    r"\b(?:unit|units|coordinates|positions|x|y)\b[^\n]{0,20}?\b(metres?|meters?|m|cm|mm)\b",
    re.IGNORECASE,
)
RATE_NAMES = ("framerate", "fps", "framespersecond")  # plain names of a rate
ENOUGH = 100  # rows from which velocities are a witness


def facts_of(table: Table, schema: Schema) -> dict[str, str]:
    """What is said of `fps` and `unit`, and by whom: `fps_by`, `unit_by`.

    Raises:
        InputError: where x and y have two units, or two places two rates.
    """
    facts = dict[str, str]()

    def add(key: str, value: str, witness: str) -> None:
        number = metres_in if key == "unit" else float
        if key in facts and number(facts[key]) != number(value):
            raise InputError(
                f"{table.path}: {facts[key + '_by']} says {key} {facts[key]}, {witness} {value}: "
                "which is right?"
            )
        facts.setdefault(key, value)
        facts.setdefault(f"{key}_by", witness)

    for role in ("x", "y", "left"):
        unit = schema.units.get(role)
        if unit and unit not in ("px", DEGREES):
            add("unit", unit, f"the name {table.names[schema.places[role]]!r}")
    for key, value in table.facts.items():
        add(key, value, "the file")
    for comment in table.comments:
        comment = re.sub(r"\[[^]]*\d[^]]*\]", "", comment)  # [1/s] is no rate
        witness = f"the comment {comment[:40]!r}"
        rate = _RATE.search(comment)
        if rate:
            add("fps", rate[2] or rate[3], witness)
        unit = _RATE_UNIT.search(comment)
        is_names = len(comment.split()) == len(table.names)
        if unit and not is_names and "unit" not in facts:
            add("unit", _plain_unit(unit[1]), witness)
    for path in _beside(table.path):
        for key, value in _facts_in(path).items():
            add(key, value, path.name)
    return facts


def _plain_unit(text: str) -> str:
    """A unit of positions as options write it, else nothing."""
    _, unit = plain_name(f"x [{text}]")
    return unit


def _beside(path: Path) -> list[Path]:
    """Files of metadata beside a table: 00_tracks.csv has 00_tracksMeta.csv, a.csv a_meta.json."""
    if not path.suffix or not path.parent.is_dir():
        return []
    stem = path.stem.rpartition("_")[0] or path.stem
    others = []
    for other in sorted(path.parent.glob(f"{glob.escape(stem)}*[mM]eta*")):
        if other != path and other.suffix.lower() in (".csv", ".json"):
            others.append(other)
    return others


def _facts_in(path: Path) -> dict[str, str]:
    """A rate and a unit in a file of metadata; nothing where it cannot be read."""
    fields = {}
    if path.suffix.lower() == ".json":
        with contextlib.suppress(InputError):
            fields = read_json(path, limit=SETTINGS)
        fields = fields if isinstance(fields, dict) else {}
    else:
        table = _table_in(path)
        if table and len(table.row) == 1:
            fields = {name: table.column(at)[0] for at, name in enumerate(table.names)}
    facts = {}
    for name, value in fields.items():
        word, _ = plain_name(name)
        if word in RATE_NAMES:
            with contextlib.suppress(TypeError, ValueError):
                facts["fps"] = str(float(value))
        if word in ("unit", "units") and _plain_unit(value):
            facts["unit"] = _plain_unit(value)
    return facts


def _table_in(path: Path) -> Table | None:
    with contextlib.suppress(InputError):
        return read_table(path)
    return None


def kinds_beside(table: Table, schema: Schema) -> dict[str, pl.Series]:
    """[R] lower-case kinds of the rows' ids by the name of what says them: a file beside the table,
    if one does."""
    for path in _beside(table.path):
        other = _table_in(path) if path.suffix.lower() == ".csv" else None
        if other is None:
            continue
        roles = [role_of(name) for name in other.names]
        if "id" in roles and "label" in roles and not {"x", "y"} & set(roles):
            label = roles.index("label")
            kind = dict(zip(other.column(roles.index("id")), other.words(label)))
            ids = table.column(schema.places["id"])
            kinds = ids.replace_strict(kind, default="", return_dtype=pl.String)
            return {f"{other.names[label]} in {path.name}": kinds}
    return {}


# The clock of a table: seconds of its times or frames, as far as its witnesses agree.

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
AGREE = 0.15  # share by which witnesses of one rate may differ
CLOSE = 0.02  # share by which velocities may miss a usual rate
USUAL_RATES = (2.5, 3.75, 7.5, 12.5, 14.985, 23.976, 29.97, 59.94)
"""Frames a second of recordings that are no whole numbers."""


@dataclasses.dataclass(frozen=True)
class Witness:
    """Who says a rate, and how many frames a second."""

    source: str
    rate: float
    is_option: bool = False  # the user, whose words need no note


def stamps_of(
    table: Table,
    schema: Schema,
    options: ReadOptions,
    period: float,
    ids: np.ndarray,
    part: np.ndarray,
    position: np.ndarray,
    facts: Mapping[str, str],
) -> tuple[Table, np.ndarray]:
    """The table with notes on its clock, and [R] seconds, as the witnesses of its rate agree.

    Args:
        table: the rows.
        schema: its columns.
        options: what the user says.
        period: seconds of the most common step of frames that nobody knows more about.
        ids: [R] people.
        part: [R] recording of each row.
        position: [R, 2] in the file's unit.
        facts: see `facts_of`.

    Raises:
        InputError: for witnesses that contradict each other, or a clock that none
            decides.
    """
    unit = facts.get("unit")
    if unit and options.unit_of(table.path.stem) is None:
        table = table.noted(f"coordinates in {unit} ({facts['unit_by']})")
    if schema.clock == "time":
        table, stamp = _seconds(table, schema, options)
        if "time" not in schema.declared:
            _refuse_other_frames(table, schema.places["time"], stamp, part)
        return table, stamp
    if options.time_unit:
        raise InputError(
            f"{table.path}: {option('time_unit')} is of no use: it counts frames"
        )
    frame = table.whole_numbers(schema.places["frame"])
    witnesses = _stated_rates(table, options, period, facts)
    if not witnesses:
        witnesses = _rate_of_velocities(table, schema, ids, frame, position)
    if not witnesses:
        return _assumed(table, schema, frame, ids, period)
    table = _agreed(table, witnesses, options)
    first = witnesses[0]
    if not first.is_option:
        table = table.noted(f"{first.rate:g} frames a second ({first.source})")
    # In this order 10 frames at 25 a second are 0.4 s exactly.
    return table, frame / (first.rate * period) * period


def _stated_rates(
    table: Table, options: ReadOptions, period: float, facts: Mapping[str, str]
) -> list[Witness]:
    """The rates that the user and the file say.

    Raises:
        InputError: where the file says a rate of nothing, and the user none.
    """
    witnesses = []
    rate = options.fps_of(table.path.stem)
    if rate:
        witnesses.append(Witness(option("fps"), rate, is_option=True))
    if options.eth_stride and table.path.stem.startswith("biwi_eth"):
        rate = options.eth_stride / period
        witnesses.append(Witness(option("eth_stride"), rate, is_option=True))
    if "fps" in facts:
        rate = float(facts["fps"])
        if 0 < rate < math.inf:
            witnesses.append(Witness(facts["fps_by"], rate))
        elif not witnesses:
            raise InputError(
                f"{table.path}: {facts['fps_by']} says {facts['fps']} frames a second: "
                f"say {option('fps', 25)}, or what it is"
            )
    return witnesses


def _agreed(table: Table, witnesses: Sequence[Witness], options: ReadOptions) -> Table:
    """The table, with a warning if its user allows that the witnesses of its rate differ."""
    first, *others = witnesses
    for other in others:
        if abs(np.log(other.rate / first.rate)) <= np.log1p(AGREE):
            continue
        line = f"{first.source} says {first.rate:g} frames a second, {other.source} {other.rate:g}"
        if "clock" not in options.allow:
            raise InputError(
                f"{table.path}: {line}: which is right? ({option('fps')}, or "
                f"{option('allow', ('clock',))} takes the first)"
            )
        table = table.warned(f"allowed clock: {line}")
    return table


def _rate_of_velocities(
    table: Table,
    schema: Schema,
    ids: np.ndarray,
    frame: np.ndarray,
    position: np.ndarray,
) -> list[Witness]:
    """The rate by which the columns vx, vy fit what people move in four frames, if they do.

    Over four rows, so that rounding and noise matter little. `ids`, `frame` are [R],
    `position` is [R, 2].
    """
    if not {"vx", "vy"} <= schema.places.keys():
        return []
    columns = schema.places["vx"], schema.places["vy"]
    order = np.lexsort((frame, ids))
    ids, frame, position = ids[order], frame[order], position[order]
    velocity = np.nan_to_num(table.numbers(*columns, missing=True)[order])
    same = ids[4:] == ids[:-4]
    starts = np.flatnonzero(same & (frame[4:] > frame[:-4]))
    if len(starts) < ENOUGH:
        return []
    frames = frame[starts + 4] - frame[starts]
    moved = (position[starts + 4] - position[starts]) / frames[:, None]
    weights = np.array([0.125, 0.25, 0.25, 0.25, 0.125])
    rows = starts + np.arange(5)[:, None]
    mean = np.einsum("l,lnd->nd", weights, velocity[rows])
    across = (mean * moved).sum(axis=1)
    length = (moved**2).sum(axis=1)
    speed = (mean**2).sum(axis=1)
    moves = (length > 0.01 * np.median(length)) & (speed > 0) & (length > 0)
    if not moves.any():
        return []
    across, length, speed = across[moves], length[moves], speed[moves]
    # Medians, for velocities are wrong where tracks begin or are exchanged.
    cosine = np.median(across / np.sqrt(length * speed))
    rate = float(np.median(across / length))
    if cosine < 0.9 or not 0.9 < rate < 130:
        return []
    usual = np.array([round(rate), *USUAL_RATES])
    nearest = float(usual[abs(usual - rate).argmin()])
    if abs(rate / nearest - 1) < CLOSE:
        rate = nearest
    names = ", ".join(table.names[at] for at in columns)
    hint = f"columns {names} alone, which may err by a twentieth: {option('fps')} corrects it"
    return [Witness(hint, rate)]


def _assumed(
    table: Table, schema: Schema, frame: np.ndarray, ids: np.ndarray, period: float
) -> tuple[Table, np.ndarray]:
    """[R] seconds of frames whose most common step is taken for `period` seconds."""
    if schema.in_picture and np.any(np.diff(np.unique(frame)) == 1):
        raise Unsaid(
            f"{table.path}: it has every frame of a video: say how many a second "
            f"({option('fps', 30)})"
        )
    step = usual_step(table, frame, ids)
    frames = "a frame is" if step == 1 else f"{step:g} frames are"
    table = table.noted(
        f"{frames} taken for {period:g} s, which nothing says: {option('fps')}"
    )
    return table, frame / step * period


def usual_step(
    table: Table, frame: np.ndarray, ids: np.ndarray, any_step: bool = False
) -> float:
    """The most common step of people's frames [R].

    Raises:
        InputError: where that step is unusual, unless `any_step` will do.
    """
    order = np.lexsort((frame, ids))
    steps = np.diff(frame[order])
    same = np.diff(ids[order]) == 0
    steps = steps[same & (steps > 0)]
    if not len(steps):
        steps = np.diff(np.unique(frame))
    stride = common(steps) if len(steps) else 1.0
    if not any_step and stride not in STEPS:
        raise Unsaid(
            f"{table.path}: its frames are {stride:g} apart, at 25 a second {stride / 25:.2f} s: "
            f"say how many make a second ({option('fps', 25)})"
        )
    return stride


def _seconds(
    table: Table, schema: Schema, options: ReadOptions
) -> tuple[Table, np.ndarray]:
    """[R] seconds in the column of times."""
    path = table.path
    place = schema.places["time"]
    name = table.names[place]
    named = schema.units.get("time")
    unit = options.time_unit
    if options.fps_of(path.stem) is not None:
        raise InputError(
            f"{path}: {option('fps')} counts frames, and {name!r} is a time"
        )
    if named in _SECONDS:
        if unit and unit != named:
            stated = option("time_unit", unit)
            raise InputError(f"{path}: the name {name!r} says {named}, {stated}")
        if unit is None and named != "s":
            table = table.noted(f"times in {named} (the name {name!r})")
        unit = named
    texts = table.column(place)
    if not options.time_unit and re.search(r"\d[:-]\d", texts[0]):
        return table, _moments(table, texts)
    stamp = table.numbers(place)[:, 0] * _SECONDS[unit or "s"]
    counts = np.unique(stamp)
    if not unit and len(counts) > 10 and (counts == np.rint(counts)).all():
        frames = option("columns", (f"frame={column_name(table, place)}",))
        raise Unsaid(
            f"{path}: all of {name!r} are whole numbers: do they count frames "
            f"({frames} {option('fps', 25)}), or is that their unit "
            f"({option('time_unit', 's')} or ms)?"
        )
    return table, stamp


_CLOCK = r"^(?:(\d+) days? |(.*\d) )?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)$"
DATE = "as 2024-05-01 12:30:00.4, or 12:30:00.4"
DAYS = ("%Y/%m/%d", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y")
DAY, NIGHT = 86_400.0, 72_000.0  # seconds


def _moments(table: Table, texts: pl.Series) -> np.ndarray:
    """[R] seconds of dates and clocks, or of clocks alone, which may pass midnight."""

    def wrong(at: int) -> str:
        return f"{texts[at][:40]!r} is not a date and time, {DATE}"

    if re.match(r"\d{4}-\d\d-", texts[0]):
        moments = texts.str.to_datetime(time_unit="us", time_zone="UTC", strict=False)
        table.refuse(moments.is_null().to_numpy(), wrong)
        return moments.dt.timestamp("us").to_numpy() / 1e6
    parts = texts.str.extract_groups(_CLOCK).struct.unnest()
    count, date, hours, minutes, seconds = parts.get_columns()
    table.refuse(hours.is_null().to_numpy(), wrong)
    factors = {
        3600.0: hours,
        60.0: minutes,
        1.0: seconds.str.replace(",", "."),
        DAY: count,
    }
    stamp = np.zeros(len(texts))
    for factor, column in factors.items():
        stamp += factor * column.cast(pl.Float64).fill_null(0.0).to_numpy()
    if date.null_count() == 0:
        return stamp + DAY * _days(table, date)
    if stamp.max() >= DAY:
        return stamp
    # Of clocks alone, a night without rows in the middle of a day is midnight.
    moments = np.unique(stamp)
    gaps = np.diff(moments)
    if len(gaps) and gaps.max() > NIGHT:
        stamp = stamp + DAY * (stamp <= moments[gaps.argmax()])
    return stamp


def _days(table: Table, texts: pl.Series) -> np.ndarray:
    """[R] days since 1970 of dates, whose day and month one of them must tell apart."""
    readings = []
    for form in DAYS:
        days = texts.str.to_date(form, strict=False)
        if not days.null_count():
            readings.append(days.cast(pl.Int32).to_numpy())
    if not readings:
        raise InputError(
            f"{table.path}: {texts[0][:40]!r} is no date: write 2024-05-01"
        )
    if any(np.ptp(days) != np.ptp(readings[0]) for days in readings):
        raise InputError(
            f"{table.path}: {texts[0][:40]!r}: which is the day, which the month? Write 2024-05-01"
        )
    return readings[0].astype(float)


def _refuse_other_frames(
    table: Table, clock: int, stamp: np.ndarray, part: np.ndarray
) -> None:
    """Refuse a column of frames that counts anything but the times [R] of each recording [R]."""
    places = [at for at, name in enumerate(table.names) if role_of(name) == "frame"]
    if len(places) != 1:
        return
    frame = table.numbers(*places, missing=True).ravel()
    for number in np.unique(part):
        at = (part == number) & np.isfinite(frame)
        counts, moments = frame[at], stamp[at]
        first, index = np.unique(counts, return_index=True)
        if len(first) < 3:
            continue
        rate, start = np.polyfit(first - first[0], moments[index], 1)
        line = start + rate * (counts - first[0])
        error = np.max(np.abs(moments - line))
        if rate <= 0 or error > 0.1 + 2 * rate + 1e-3 * np.ptp(moments):
            frames, times = table.names[places[0]], table.names[clock]
            raise Question(
                f"{table.path}: columns {frames!r} and {times!r} disagree",
                {
                    (f"frame={frames}",): "where that is right",
                    (f"time={times}",): "where that is",
                },
            )
