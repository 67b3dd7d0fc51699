"""What the columns of a table mean: names and roles, proposals for those without a name,
what stands beside the table, positions in metres, and times.
"""

import contextlib
import dataclasses
import glob
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.evidence import ENOUGH, doubts_of, roughness
from neurosym_jax.data.tables import (
    BOX,
    CLOCKS,
    DEGREES,
    FLAGS,
    METRES,
    POINT,
    ROLES,
    STEPS,
    Question,
    ReadOptions,
    Table,
    Unsaid,
    absent,
    has_position,
    metres_in,
    plain_name,
    read_table,
    read_text_file,
    role_of,
)
from neurosym_jax.data.tracks import Tracks, common, fields_at, make_tracks
from neurosym_jax.errors import InputError, option

__all__ = [
    "SWAP",
    "Rows",
    "Schema",
    "column_name",
    "facts_in",
    "facts_of",
    "kinds_beside",
    "outside",
    "parse_columns",
    "positions_of",
    "project",
    "propose",
    "read_homography",
    "rows_of",
    "schema_of",
    "stamps_of",
    "usual_step",
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
    readings = sorted(_possible(part, places))[:JUDGED]
    if not readings:
        return {}
    doubts = [doubts_of(_tracks(part, columns)) for _, columns in readings]
    fewest = min(doubts)
    least_doubted = [
        reading for reading, count in zip(readings, doubts) if count == fewest
    ]
    limit = least_doubted[0][0] / SMOOTHER
    best = min(columns for rough, columns in least_doubted if rough <= limit)

    is_frame = (part.extra(best[0], texts=False) % 1 == 0).all()
    roles = dict(zip(("frame" if is_frame else "time", "id", "x", "y"), best))
    taken = set(best) & set(places.values())
    return {role: at for role, at in roles.items() if at not in taken}


def _tracks(table: Table, columns: tuple[int, ...]) -> Tracks:
    """The tracks of a reading, at steps of a second or so and about their middle."""
    moment, ids, position = _read(table, columns)
    moments = np.unique(moment)
    stamp = (moment - moments[0]) / np.median(np.diff(moments))
    return make_tracks("proposal", stamp, ids, position - position.mean(axis=0))


def _complete(table: Table) -> Table:
    """The rows without an empty field if there are some: others have no position."""
    columns = range(min(len(table.names), MOST))
    is_empty = [absent(table.column(at)).to_numpy() for at in columns]
    is_complete = ~np.any(is_empty, axis=0)
    return table.take(is_complete) if is_complete.mean() > 0.25 else table


def _read(
    table: Table, columns: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[R] numbers of the clock, [R] numbers of people and [R, C] others of some columns."""
    moment, person, *others = columns
    values = [table.extra(at, texts=False) for at in (moment, *others)]
    moments, *values = np.nan_to_num(values)
    ids = table.column(person).rank("dense").to_numpy()
    return moments, ids, np.column_stack(values)


def _possible(
    table: Table, places: Mapping[str, int]
) -> Iterator[tuple[float, tuple[int, ...]]]:
    """The roughness and the columns (clock, id, x, y) of readings in which nobody is at two places
    at one moment."""
    columns = range(min(len(table.names), MOST))
    free = [at for at in columns if at not in places.values()]
    numbers = [at for at in free if _are_numbers(table, at)]

    def choices(others: list[int], *roles: str) -> list[int]:
        return [places[role] for role in roles if role in places] or others

    xs, ys = choices(numbers, "x", "left"), choices(numbers, "y", "top")
    pairs = []
    for x, y in itertools.product(xs, ys):
        if 0 < y - x <= 2 or not {x, y} & set(free):
            pairs.append((x, y))
    if not pairs:
        return
    people = choices([at for at in free if _repeats(table, at)], "id")
    for moment, person in itertools.product(choices(numbers, "time", "frame"), people):
        bends = _bends(table, (moment, person, *{*numbers, *xs, *ys}))
        for pair in pairs:
            if bends.keys() >= set(pair) and {moment, person}.isdisjoint(pair):
                rough = bends[pair[0]] + bends[pair[1]]
                if moment != person and rough % SET_BACK <= ROUGHEST:
                    yield rough, (moment, person, *pair)


def _bends(table: Table, columns: tuple[int, ...]) -> dict[int, float]:
    """The roughness along tracks of the columns behind the clock and the id.

    A column with one number for all people at a moment is another clock. One with one
    number for each person may be a height: it is a coordinate only where no other column
    is left.
    """
    moment, ids, values = _read(table, columns)
    bends = {}
    rough = roughness(moment, ids, values)
    for at, bend, numbers in zip(columns[2:], rough.tolist(), values.T):
        if bend < np.inf and _varies(moment, numbers):
            bends[at] = bend if _varies(ids, numbers) else bend + SET_BACK
    return bends


def _varies(keys: np.ndarray, values: np.ndarray) -> bool:
    """Whether there are several of the values for a key."""
    pairs = np.unique(keys + 1j * values)
    return len(pairs) > 1.2 * len(np.unique(keys))


def _are_numbers(table: Table, at: int) -> bool:
    """Whether most fields of a column are numbers."""
    return np.isfinite(table.extra(at, texts=False)).mean() > 0.5


def _repeats(table: Table, at: int) -> bool:
    """Whether a column's values repeat, as ids do."""
    texts = table.column(at)
    return 2 * texts.n_unique() <= len(texts)


def as_box(table: Table, places: Mapping[str, int]) -> dict[str, int]:
    """The columns x and y and the two behind them as those of a box in a picture, if these are as
    its other corner or its size; else nothing."""
    left = places.get("x", -1)
    columns = range(left, left + 4)
    is_free = left >= 0 and set(columns[2:]).isdisjoint(places.values())
    if places.get("y") != left + 1 or columns[-1] >= len(table.names) or not is_free:
        return {}
    first_x, first_y, *others = (table.extra(at, texts=False) for at in columns)
    second = np.array(others)
    if (second > [first_x, first_y]).all():
        roles = ("left", "top", "right", "bottom")
    elif (second > 0).all():
        roles = ("left", "top", "width", "height")
    else:
        return {}
    other_roles = {role: at for role, at in places.items() if role not in POINT}
    return other_roles | dict(zip(roles, columns))


# The schema of a table: which column has which role and unit, as a user or the names
# say.
#
# What names do not settle is proposed by values, as a command to paste; it is never read
# without that.

Facts = Mapping[str, tuple[str, str]]  # what is said of `fps` and `unit`, and by whom


@dataclasses.dataclass(frozen=True)
class Schema:
    """Roles and other names, the extras, of the columns of a table."""

    places: Mapping[str, int]  # column of each role or extra
    columns: Mapping[str, Sequence[int]]  # all that have a role by their names
    units: Mapping[str, str]  # of time, x, y and left, by name
    declared: frozenset[str]  # the roles that the user gave

    @property
    def clock(self) -> str:
        """`time` or `frame`."""
        return "time" if "time" in self.places else "frame"

    @property
    def in_picture(self) -> bool:
        """Whether positions are pixels, or boxes of them."""
        is_box = not {"left", "height"}.isdisjoint(self.places)
        return is_box or "px" in self.units.values()

    @property
    def flags(self) -> list[tuple[str, int]]:
        """Roles and columns of `FLAGS`."""
        return [(role, at) for role in FLAGS for at in self.columns.get(role, ())]

    @property
    def extras(self) -> dict[str, int]:
        """The columns that a user named otherwise than a role."""
        return {name: at for name, at in self.places.items() if name not in ROLES}

    @property
    def used(self) -> set[int]:
        """The columns that are read."""
        used = set(self.places.values())
        for role in (*FLAGS, "label", "recording"):
            used.update(self.columns.get(role, ()))
        return used


def parse_columns(columns: Iterable[str]) -> dict[str, str]:
    """The columns that a user gave by role; `header` and `table` may be among them.

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
    header = stated.get("header", "no")
    if header not in ("yes", "no"):
        raise InputError(f"header={header}: say header=no or header=yes")
    return stated


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
        is_none = name == "none" and name not in table.names
        if not is_none and role not in ("header", "table"):
            declared[role] = _place(table, role, name)
    columns = _columns(table, stated, declared)

    places = dict(declared)
    others = _other_roles(columns, stated)
    for role in (*CLOCKS, "id", *POINT, *BOX):
        if role not in others and len(columns.get(role, ())) == 1:
            places[role] = columns[role][0]
    for role in ("vx", "vy"):
        if role in columns:
            places[role] = columns[role][0]
    _refuse_missing(table, places, columns, in_picture)
    points = [role for role in (*CLOCKS, "id", *POINT, *BOX) if role in places]
    if len({places[role] for role in points}) < len(points):
        raise InputError(f"{', '.join(points)} must be {len(points)} columns")
    units = {}
    for role in ("time", *POINT, "left"):
        if role in places:
            units[role] = plain_name(table.names[places[role]])[1]
    return Schema(places, columns, units, frozenset(stated))


def _columns(
    table: Table, stated: Mapping[str, str], declared: Mapping[str, int]
) -> dict[str, list[int]]:
    """The columns of each role: the declared one, or all whose names say it."""
    columns = {role: [at] for role, at in declared.items()}
    taken = {at for role, at in declared.items() if role in ROLES}
    for at, name in enumerate(table.names):
        role = role_of(name)
        is_extra = role == "recording" and at in declared.values()
        if role and role not in stated and at not in taken and not is_extra:
            columns.setdefault(role, []).append(at)
    ids = columns.get("id", [])
    if len(ids) > 1:  # The number of a row is nobody's.
        columns["id"] = [at for at in ids if _repeats(table, at)]
    return columns


def _other_roles(columns: Iterable[str], stated: Iterable[str]) -> set[str]:
    """Roles of columns that are not read: those of a second clock, and of positions of the other
    kind, boxes or points."""
    named, stated = set(columns), set(stated)
    others = set[str]()
    if stated.intersection(CLOCKS):
        others.update(set(CLOCKS) - stated)
    states_box = not stated.isdisjoint(BOX)
    if stated.intersection(POINT) or (not states_box and named.issuperset(POINT)):
        others.update(set(BOX) - stated)
    elif states_box or has_position(named - set(POINT)):
        others.update(POINT)
    return others


def _refuse_missing(
    table: Table,
    places: Mapping[str, int],
    columns: Mapping[str, Sequence[int]],
    in_picture: bool,
) -> None:
    """Ask for the clock, the id and the position where they are missing, with what values propose."""
    required = []
    if places.keys().isdisjoint(CLOCKS):
        required.append("time or frame")
    required += {"id"} - places.keys()
    if not has_position(places):
        required += [role for role in POINT if role not in places]
    if not required:
        return
    if len(table.names) < 3:
        raise InputError(
            f"only the columns {_shown(table)}: separate columns by commas, "
            "semicolons, tabs or blanks"
        )

    # Of columns with one role each is tried, of x and y those that stand alike; their
    # values are compared by who asks.
    unclear = [role for role in (*CLOCKS, "id", *POINT) if role not in places]
    choices = [columns.get(role) or [None] for role in unclear]
    xs, ys = (columns.get(role, []) for role in POINT)
    answers = {}
    for choice in itertools.islice(itertools.product(*choices), 16):
        guess = dict(places)
        for role, at in zip(unclear, choice):
            if at is not None and not (role == "frame" and "time" in guess):
                guess[role] = at
        if len(xs) == len(ys) > 1 and xs.index(guess["x"]) != ys.index(guess["y"]):
            continue
        guess |= propose(table, guess)
        boxed = as_box(table, guess)
        if not (boxed and in_picture):
            answers[_written(table, guess)] = ""
        if boxed:
            answers[_written(table, boxed)] = "where they are of a box in a picture"
    raise Question(
        f"which column is {', '.join(required)}? There are {_shown(table)}",
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
    if name.isdecimal() and 1 <= int(name[:9]) <= len(names):
        return int(name) - 1
    count = names.count(name)
    if count > 1:
        raise InputError(f"{key}={name}: {count} columns are called so; say a number")
    if not count or name.isdecimal():
        raise InputError(
            f"no column {name[:40]!r}: which column is {key}? There are {_shown(table)}"
        )
    return names.index(name)


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
    fields = re.split(r"[\s,;]+", read_text_file(Path(name)).strip())
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
    table: Table, schema: Schema, options: ReadOptions, facts: Facts
) -> tuple[Table, np.ndarray, np.ndarray]:
    """The rows with a position, [R, 2] metres, and [R, 2] in the file's unit.

    `facts` are what the file says of itself.

    Raises:
        InputError: where no row has one, or their unit is not known or said twice.
    """
    table, raw = _points_of(table, schema, options)
    stated = options.unit_of(table.path.stem)
    unit, witness = facts.get("unit", ("", ""))
    if unit and not stated:
        table = table.noted(f"coordinates in {unit} ({witness})")
    elif unit and not math.isclose(metres_in(stated), metres_in(unit)):
        line = f"the file says that coordinates are {unit}, {option('unit', stated)}"
        table = table.warned(options.allowed("scale", line))
    if schema.units.get("x") == DEGREES:
        return _local_metres(table, raw, options)
    if schema.in_picture and not (stated or unit or options.homography):
        raise Unsaid(
            f"positions are pixels of a picture: say what they are in metres, by "
            f"{option('homography', 'FILE')} or metres of a pixel, {option('unit', '0.032')}"
        )
    position = raw
    if options.homography:
        position = project(read_homography(options.homography), raw)
        table.refuse(
            np.isnan(position).any(axis=1),
            lambda at: f"{raw[at]} lies beyond the homography's horizon",
        )
        unit = ""
    position = position * metres_in(stated or unit or "m")
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
    roles = [role for role in (*POINT, *BOX) if role in schema.places]
    values = table.numbers(*(schema.places[role] for role in roles), missing=True)
    values[values == options.missing] = np.nan
    is_seen: Any = ~np.isnan(values).any(axis=1)
    if not is_seen.any():
        raise InputError("no row has a position")
    table = table.take(is_seen, "without a position")
    column = dict(zip(roles, values[is_seen].T))
    if "x" in column:
        if "height" in column:  # Of a box, x and y are the middle.
            column["y"] += column["height"] / 2
        return table, np.column_stack([column["x"], column["y"]])

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
    if "x" not in schema.places or not schema.declared.isdisjoint(POINT):
        return
    points = [schema.places[role] for role in POINT]
    x, y = (column_name(table, at) for at in points)
    sizes = [role for role in ("width", "height") if role in schema.columns]
    is_scaled = (options.unit or "m") not in METRES or options.homography
    if len(sizes) == 2 and (is_scaled or schema.in_picture):
        names = [column_name(table, schema.columns[role][0]) for role in sizes]
        size = [f"{role}={name}" for role, name in zip(sizes, names)]
        raise Question(
            f"{x}, {y}, {' and '.join(names)} are of a box",
            {
                (f"left={x}", f"top={y}", *size): "where x, y is its upper left corner",
                (f"x={x}", f"y={y}", *size): "where it is its middle",
            },
        )
    for at in schema.columns.get("z", ()):
        spread = np.nanstd(table.numbers(*points, at, missing=True), axis=0)
        if spread[1] < FLAT * min(spread[0], spread[2]):
            z = column_name(table, at)
            raise Question(
                f"{y} hardly varies beside {x} and {z}, as a height does",
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
            f"longitudes and latitudes have no {option('unit')} or homography"
        )
    east, north = np.median(degrees, axis=0)
    scale = EARTH * np.array([np.cos(np.radians(north)), 1.0])
    position = np.radians(degrees - [east, north]) * scale
    table = table.noted(f"degrees, as metres east and north of {north:.6f}, {east:.6f}")
    return table, position, position


# What a table says of its own clock, scale and kinds, beside positions: the witnesses.
#
# Comments, names, velocity columns, what a database stores and files beside the table
# each give a rate or a unit. Two that contradict each other are refused, and both are
# named.

_RATE = re.compile(
    r"\b(?:frame[\s_-]*rate|fps|frames?[\s_-]*per[\s_-]*second)\b\W*(\d+(?:\.\d+)?)|"
    r"(\d+(?:\.\d+)?)\s*(?:fps|frames per second)\b",
    re.IGNORECASE,
)
_RATE_NAMES = ("framerate", "fps", "framespersecond")  # plain names of a rate


def facts_of(table: Table, schema: Schema) -> Facts:
    """What is said of the rate and the unit.

    Raises:
        InputError: where x and y have two units, or two places two rates.
    """
    facts = dict[str, tuple[str, str]]()
    for key, value, witness in _said(table, schema):
        first_value, first = facts.setdefault(key, (value, witness))
        number = metres_in if key == "unit" else float
        if number(first_value) != number(value):
            raise InputError(
                f"{first} says {key} {first_value}, {witness} {value}: which is right?"
            )
    return facts


def _said(table: Table, schema: Schema) -> Iterator[tuple[str, str, str]]:
    """Each fact that is said: `fps` or `unit`, its value, and where it stands."""
    for role in (*POINT, "left"):
        unit = schema.units.get(role)
        if unit and unit not in ("px", DEGREES):
            yield "unit", unit, f"the name {table.names[schema.places[role]]!r}"
    sources = {"the file": table.facts}
    for comment in table.comments:
        rate = _RATE.search(re.sub(r"\[[^]]*\d[^]]*\]", "", comment))  # not of [1/s]
        if rate:
            sources[f"the comment {comment[:40]!r}"] = {"fps": rate[1] or rate[2]}
    for other in _tables_beside(table.path):
        if len(other.row) == 1:
            facts = facts_in(zip(other.names, other.fields[0]))
            sources[other.path.name] = facts
    for witness, facts in sources.items():
        for key, value in facts.items():
            yield key, value, witness


def facts_in(pairs: Iterable[tuple[Any, Any]]) -> dict[str, str]:
    """The `fps` and `unit` among names and values."""
    facts = {}
    for name, value in pairs:
        word, _ = plain_name(str(name))
        if word in _RATE_NAMES:
            with contextlib.suppress(TypeError, ValueError):
                facts["fps"] = str(float(value))
        _, unit = plain_name(f"x [{value}]")
        if word in ("unit", "units") and unit:
            facts["unit"] = unit
    return facts


def _tables_beside(path: Path) -> Iterator[Table]:
    """Tables of metadata beside a table: 00_tracks.csv has 00_tracksMeta.csv."""
    stem = path.stem.rpartition("_")[0] or path.stem
    for other in sorted(path.parent.glob(f"{glob.escape(stem)}*[mM]eta*.csv")):
        if path.suffix:
            with contextlib.suppress(InputError):
                yield read_table(other)


def kinds_beside(table: Table, schema: Schema) -> dict[str, pl.Series]:
    """[R] lower-case kinds of the rows' ids by the name of what says them: a file beside the table,
    if one does."""
    for other in _tables_beside(table.path):
        roles = list(map(role_of, other.names))
        if {"id", "label"} <= set(roles) and not {"x", "y"} & set(roles):
            label = roles.index("label")
            kind = dict(zip(other.column(roles.index("id")), other.words(label)))
            ids = table.column(schema.places["id"])
            kinds = ids.replace_strict(kind, default="", return_dtype=pl.String)
            return {f"{other.names[label]} in {other.path.name}": kinds}
    return {}


# The clock of a table: seconds of its times or frames, as far as its witnesses agree.

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
AGREE = 0.15  # share by which witnesses of one rate may differ
MEAN_OF_FIVE = (0.125, 0.25, 0.25, 0.25, 0.125)  # over four steps
CLOSE = 0.02  # share by which velocities may miss a usual rate
USUAL_RATES = (2.5, 3.75, 7.5, 12.5, 14.985, 23.976, 29.97, 59.94)
"""Frames a second of recordings that are no whole numbers."""


@dataclasses.dataclass(frozen=True)
class Rows:
    """The R rows of a table that have a position, sorted by person and clock."""

    table: Table
    ids: np.ndarray  # [R] int64
    people: tuple[str, ...]  # texts of the ids, if these are no numbers
    clock: np.ndarray  # [R] seconds, or numbers of frames
    position: np.ndarray  # [R, 2] metres
    raw: np.ndarray  # [R, 2] in the file's unit

    @property
    def same(self) -> np.ndarray:
        """[R - 1] bool: the next row is of the same person."""
        return np.diff(self.ids) == 0

    def take(self, rows: np.ndarray, others: str = "") -> "Rows":
        """The rows of a mask [R] or of indices [n], as `Table.take`."""
        arrays = fields_at(self, ("ids", "clock", "position", "raw"), rows)
        table = self.table.take(rows, others)
        return dataclasses.replace(self, table=table, **arrays)


def rows_of(
    table: Table,
    schema: Schema,
    options: ReadOptions,
    position: np.ndarray,
    raw: np.ndarray,
) -> Rows:
    """The rows of a table at `position` [R, 2] metres, `raw` [R, 2] in the file's unit.

    Raises:
        InputError: for an id, a frame or a time that is none.
    """
    ids, people = table.ids(schema.places["id"])
    if schema.clock == "time":
        table, clock = _seconds(table, schema, options)
    elif options.time_unit:
        raise InputError(f"{option('time_unit')} is of no use: it counts frames")
    else:
        clock = table.whole_numbers(schema.places["frame"])
    rows = Rows(table, ids, people, clock, position, raw)
    return rows.take(np.lexsort((clock, ids)))


def stamps_of(
    rows: Rows,
    schema: Schema,
    options: ReadOptions,
    period: float,
    part: np.ndarray,
    facts: Facts,
) -> tuple[Table, np.ndarray]:
    """The table with notes on its clock, and [R] seconds, as the witnesses of its rate agree.

    Args:
        rows: the rows.
        schema: their columns.
        options: what the user says.
        period: seconds of the most common step of frames that nobody knows more about.
        part: [R] recording of each row.
        facts: see `facts_of`.

    Raises:
        InputError: for witnesses that contradict each other, or a clock that none
            decides.
    """
    table = rows.table
    if schema.clock == "time":
        if "time" not in schema.declared:
            _refuse_other_frames(rows, schema, part)
        return table, rows.clock
    rates = _rates(table, options, period, facts)
    rates = rates or _rate_of_velocities(rows, schema)
    if not rates:
        return _assumed(rows, schema, period)
    (source, rate), *others = rates.items()
    for other, value in others:
        if abs(np.log(value / rate)) > np.log1p(AGREE):
            line = f"{source} says {rate:g} frames a second, {other} {value:g}"
            table = table.warned(options.allowed("clock", line))
    if source not in (option("fps"), option("eth_stride")):
        table = table.noted(f"{rate:g} frames a second ({source})")
    # In this order 10 frames at 25 a second are 0.4 s exactly.
    return table, rows.clock / (rate * period) * period


def _rates(
    table: Table, options: ReadOptions, period: float, facts: Facts
) -> dict[str, float]:
    """The rates that the user says, by option, and that the file says, by what says it.

    Raises:
        InputError: where the file says one that is none, and the user says none.
    """
    stem = table.path.stem
    rates = {option("fps"): options.fps_of(stem)}
    if options.eth_stride and stem.startswith("biwi_eth"):
        rates[option("eth_stride")] = options.eth_stride / period
    text, witness = facts.get("fps", ("", ""))
    if text:
        rates[witness] = float(text)
    usable = {source: rate for source, rate in rates.items() if 0 < rate < math.inf}
    if text and not usable:
        raise InputError(
            f"{witness} says {text} frames a second: say {option('fps', 25)}, or what it is"
        )
    return usable


def _rate_of_velocities(rows: Rows, schema: Schema) -> dict[str, float]:
    """The rate by which the columns vx, vy fit what people move in four frames, if they do.

    Over four rows, so that rounding and noise matter little.
    """
    if not {"vx", "vy"} <= schema.places.keys():
        return {}
    columns = schema.places["vx"], schema.places["vy"]
    velocity = np.nan_to_num(rows.table.numbers(*columns, missing=True))
    if len(velocity) < ENOUGH:
        return {}
    frames = rows.clock[4:] - rows.clock[:-4]
    same = (rows.ids[4:] == rows.ids[:-4]) & (frames > 0)
    moved = (rows.raw[4:] - rows.raw[:-4])[same] / frames[same, None]
    mean = [np.convolve(along, MEAN_OF_FIVE, "valid") for along in velocity.T]
    velocity = np.column_stack(mean)[same]
    across = (velocity * moved).sum(axis=1)
    length = (moved**2).sum(axis=1)
    speed = (velocity**2).sum(axis=1)
    moves = (speed > 0) & (length > 0)
    if same.sum() < ENOUGH or not moves.any():
        return {}
    across, length, speed = across[moves], length[moves], speed[moves]
    # Medians, for velocities are wrong where tracks begin or are exchanged.
    cosine = np.median(across / np.sqrt(length * speed))
    rate = float(np.median(across / length))
    if cosine < 0.9:
        return {}
    usual = np.array([round(rate), *USUAL_RATES])
    nearest = float(usual[abs(usual - rate).argmin()])
    if abs(rate / nearest - 1) < CLOSE:
        rate = nearest
    names = ", ".join(rows.table.names[at] for at in columns)
    hint = f"columns {names} alone, which may err by a twentieth: {option('fps')} corrects it"
    return {hint: rate}


def _assumed(rows: Rows, schema: Schema, period: float) -> tuple[Table, np.ndarray]:
    """[R] seconds of frames whose most common step is taken for `period` seconds.

    Raises:
        InputError: where that step is unusual, or every frame of a video is there.
    """
    frame = rows.clock
    if schema.in_picture and np.any(np.diff(np.unique(frame)) == 1):
        raise Unsaid(
            f"it has every frame of a video: say how many a second "
            f"({option('fps', 30)})"
        )
    step = usual_step(frame, rows.ids)
    if step not in STEPS:
        raise Unsaid(
            f"its frames are {step:g} apart, at 25 a second {step / 25:.2f} s: "
            f"say how many make a second ({option('fps', 25)})"
        )
    frames = "a frame is" if step == 1 else f"{step:g} frames are"
    table = rows.table.noted(
        f"{frames} taken for {period:g} s, which nothing says: {option('fps')}"
    )
    return table, frame / step * period


def usual_step(frame: np.ndarray, ids: np.ndarray) -> float:
    """The most common step of people's frames [R], else of all; 1 where there is one frame.

    Rows are sorted by id and frame.
    """
    steps = np.diff(frame)[np.diff(ids) == 0]
    steps = steps[steps > 0]
    if not len(steps):
        steps = np.diff(np.unique(frame))
    return common(steps) if len(steps) else 1.0


def _seconds(
    table: Table, schema: Schema, options: ReadOptions
) -> tuple[Table, np.ndarray]:
    """[R] seconds in the column of times."""
    path = table.path
    place = schema.places["time"]
    name = table.names[place]
    named = schema.units["time"]
    unit = options.time_unit
    if options.fps_of(path.stem):
        raise InputError(f"{option('fps')} counts frames, and {name!r} is a time")
    if named in _SECONDS:
        if unit and unit != named:
            stated = option("time_unit", unit)
            raise InputError(f"the name {name!r} says {named}, {stated}")
        if not unit and named != "s":
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
            f"all of {name!r} are whole numbers: do they count frames "
            f"({frames} {option('fps', 25)}), or is that their unit "
            f"({option('time_unit', 's')} or ms)?"
        )
    return table, stamp


_CLOCK = (
    r"^(?:(\d+) days? |(.*\d) )?(\d{1,2}):(\d\d):(\d\d(?:[.,]\d+)?)(?: ?([AaPp])[Mm])?$"
)
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
    parts = texts.str.replace(",", ".").str.extract_groups(_CLOCK).struct.unnest()
    table.refuse(parts.to_series(2).is_null().to_numpy(), wrong)
    days, date, *clock, half = parts.get_columns()
    counts = [
        part.cast(pl.Float64).fill_null(0.0).to_numpy() for part in (days, *clock)
    ]
    if half.null_count() < len(half):  # Twelve hours before noon and twelve after.
        table.refuse(half.is_null().to_numpy(), wrong)
        is_afternoon = half.str.to_lowercase().to_numpy() == "p"
        counts[1] = counts[1] % 12 + 12 * is_afternoon
    stamp = np.array([DAY, 3600.0, 60.0, 1.0]) @ counts
    if date.null_count() == 0:
        return stamp + DAY * _days(table, date)
    # Of clocks alone, a night without rows in the middle of a day is midnight.
    moments = np.unique(stamp)
    gaps = np.diff(moments, append=moments[-1])
    if gaps.max() > NIGHT and stamp.max() < DAY:
        stamp = stamp + DAY * (stamp <= moments[gaps.argmax()])
    return stamp


def _days(table: Table, texts: pl.Series) -> np.ndarray:
    """[R] days since 1970 of dates, whose day and month one of them must tell apart."""
    readings = []
    for form in DAYS:
        days = texts.str.to_date(form, strict=False)
        if not days.null_count():
            readings.append(days.cast(pl.Int32).to_numpy())
    spans = {np.ptp(days) for days in readings}
    if len(spans) != 1:
        raise InputError(
            f"{texts[0][:40]!r}: which is the day, which the month? Write 2024-05-01"
        )
    return readings[0].astype(float)


def _refuse_other_frames(rows: Rows, schema: Schema, part: np.ndarray) -> None:
    """Refuse a column of frames that counts anything but the times of each recording, `part` [R]."""
    table = rows.table
    places = [at for at, name in enumerate(table.names) if role_of(name) == "frame"]
    if len(places) != 1:
        return
    frame = table.extra(*places, texts=False)
    for number in np.unique(part):
        at = (part == number) & np.isfinite(frame)
        counts, moments = frame[at], rows.clock[at]
        if len(np.unique(counts)) < 3:
            continue
        rate, start = np.polyfit(counts - counts[0], moments, 1)
        error = np.abs(start + rate * (counts - counts[0]) - moments).max()
        if rate <= 0 or error > 0.1 + 2 * rate + 1e-3 * np.ptp(moments):
            frames = table.names[places[0]]
            times = table.names[schema.places["time"]]
            raise Question(
                f"columns {frames!r} and {times!r} disagree",
                {
                    (f"frame={frames}",): "where that is right",
                    (f"time={times}",): "where that is",
                },
            )
