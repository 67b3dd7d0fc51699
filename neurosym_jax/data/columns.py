"""What the columns of a table mean: names and roles, proposals for those without a name,
what stands beside the table, positions in metres, and times.
"""

import contextlib
import dataclasses
import functools
import glob
import itertools
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.data.evidence import roughness
from neurosym_jax.data.tables import (
    STEPS,
    ReadOptions,
    Table,
    absent,
    metres_in,
    read_table,
    read_text_file,
)
from neurosym_jax.data.tracks import common
from neurosym_jax.errors import InputError, option

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
    "usual_frames",
    "velocity_ratio",
    "vocabulary",
]


# Which columns may be the clock, the id and positions, by their values alone.

ROUGHEST = 0.5
"""Sum of the roughness of x and y above which nothing is proposed: of 7 tables of walkers it is at
most 0.06, of boxes of one moment in seven cameras 1.3."""
SET_BACK = 10.0
"""Roughness that is added to what may be a height; that of a track is less."""


def propose(table: Table, places: Mapping[str, int]) -> dict[str, int]:
    """Columns for the roles that are missing, by values: the reading whose tracks are smoothest.

    The id repeats, the clock is a number; x and y follow each other, perhaps with one
    between.
    """
    part, columns = (
        table.take(np.arange(len(table.row)) < 20_000),
        range(min(len(table.names), 12)),
    )
    is_complete = ~np.any(
        [absent(part.column(at)).to_numpy() for at in columns], axis=0
    )
    if is_complete.mean() > 0.25:  # Of people who are not seen there is no position.
        part = part.take(is_complete)
    free = [at for at in columns if at not in places.values()]
    clock = places.get("time", places.get("frame"))
    x, y = places.get("x", places.get("left")), places.get("y", places.get("top"))
    numbers = {
        at: values
        for at in dict.fromkeys([*free, clock, x, y])
        if at is not None and (values := _numbers(part, at)) is not None
    }
    moments: list[int] = (
        [clock] if clock is not None else [at for at in free if at in numbers]
    )
    people = (
        [places["id"]] if "id" in places else [at for at in free if _repeats(part, at)]
    )
    pairs = [
        (a, b) for a, b in itertools.combinations(sorted(numbers), 2) if b - a <= 2
    ]
    pairs = [
        (a, b)
        for a, b in pairs
        if a in (x, a * (x is None)) and b in (y, b * (y is None))
    ]
    pairs: Any = pairs if x is None or y is None else [(x, y)]
    lowest, best = np.inf, dict[str, Any]()
    for moment, person in itertools.product(moments, people):
        if moment == person or moment not in numbers:
            continue
        ids = part.column(person).rank("dense").to_numpy()
        bends = roughness(numbers[moment], ids, np.column_stack(list(numbers.values())))
        # One number at a moment, whoever is there, is another clock; one of a person
        # may be a height, and is taken for a coordinate only where nothing else is
        # left.
        bend = dict[int, float]()
        for at, value in zip(numbers, bends):
            at_once, in_all = (
                len(np.unique(key + 1j * numbers[at])) > 1.2 * len(np.unique(key))
                for key in (numbers[moment], ids)
            )
            if at_once:
                bend[at] = value + SET_BACK * (not in_all)
        for pair in pairs:
            if {moment, person} & set(pair) or not all(at in bend for at in pair):
                continue
            if (
                score := bend[pair[0]] + bend[pair[1]]
            ) < 0.7 * lowest:  # Of readings alike the first.
                lowest, is_whole = score, (numbers[moment] % 1 == 0).all()
                best = {"frame" if is_whole else "time": moment, "id": person}
                best |= {"x": pair[0], "y": pair[1]}
    if lowest % SET_BACK > ROUGHEST:
        return {}
    occupied = {*places, *(("time", "frame") if clock is not None else ())}
    occupied |= {"x", "y"} if "left" in places else set()
    return {role: at for role, at in best.items() if role not in occupied}


def _numbers(table: Table, at: int) -> Any:
    """[R] numbers of a column; None where most fields are others."""
    values = table.extra(at, texts=False)
    return np.nan_to_num(values) if np.isfinite(values).mean() > 0.5 else None


def _repeats(table: Table, at: int) -> bool:
    """Whether a column's values repeat, as ids do; fractions never do."""
    texts = table.column(at)
    values = table.extra(at, texts=False)
    is_whole = not np.isfinite(values).any() or (np.nan_to_num(values) % 1 == 0).all()
    return bool(is_whole and 2 * texts.n_unique() <= len(texts))


# The schema of a table: which column has which role and unit, as a user or the names
# say.
#
# The words of names stand in `vocabulary.tsv`. What names do not settle is proposed by
# values, as a command to paste; it is never read without that.

BOX = ("left", "top", "right", "bottom", "width", "height")
FLAGS = ("lost", "valid", "confidence")  # rows that are no positions
ROLES = ("time", "frame", "id", "x", "y", *BOX, *FLAGS, "label", "vx", "vy")
_UNITS = {
    # unit as names write it: as options do
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), "m"),
    **{unit: unit for unit in ("cm", "mm", "s", "ms", "us", "ns")},
    **dict.fromkeys(("px", "pix", "pixel", "pixels"), "px"),
    **dict.fromkeys(("sec", "secs", "seconds"), "s"),
    "ft": "0.3048",
    "feet": "0.3048",
    "km": "1000",
    "µs": "us",
    "msec": "ms",
    "usec": "us",
}
_UNIT = re.compile(r"^(.*?\w)\s*(?:[\[(](.+?)[\])]|[\s_/.-](\w+))$")


@dataclasses.dataclass(frozen=True)
class Schema:
    """Roles and other names, the extras, of the columns of a table."""

    places: Mapping[str, int]  # column of each role or extra
    units: Mapping[str, str] = dataclasses.field(
        default_factory=dict
    )  # of time, x, y by name
    labels: tuple[int, ...] = ()  # further columns of kinds, by their names
    recordings: tuple[int, ...] = ()  # columns that tell recordings apart
    declared: frozenset[str] = frozenset()  # the roles that the user gave

    @property
    def clock(self) -> str:
        """`time` or `frame`."""
        return "time" if "time" in self.places else "frame"

    @property
    def is_box(self) -> bool:
        """Whether positions are boxes in a picture."""
        return "x" not in self.places

    @property
    def in_picture(self) -> bool:
        """Whether positions are pixels."""
        return self.is_box or "px" in self.units.values()

    @property
    def extras(self) -> dict[str, int]:
        """The columns that a user named otherwise than a role."""
        return {name: at for name, at in self.places.items() if name not in ROLES}


@functools.cache
def vocabulary() -> dict[str, frozenset[str]]:
    """The words of each role, and of `recording`, `people` and `others`."""
    text = (
        files("neurosym_jax.data")
        .joinpath("vocabulary.tsv")
        .read_text(encoding="utf-8")
    )
    rows = (line.split("\t") for line in text.splitlines()[1:])
    return {role: frozenset(words.split()) for role, words in rows}


def plain_name(name: str) -> tuple[str, str]:
    """A column's name in lower-case letters and digits, and its unit, else nothing."""
    name = name.strip().lower()[:60]
    match, unit = _UNIT.match(name), ""
    if match and (unit := _UNITS.get((match[2] or match[3]).strip(), "")):
        name = match[1]
    return re.sub(r"[\W_]", "", name), unit


def role_of(name: str) -> str:
    """The role that a column's name says, else nothing."""
    word = plain_name(name)[0]
    return next((role for role, words in vocabulary().items() if word in words), "")


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
    box = (
        {"left", "top"} <= roles
        and roles & {"right", "width"}
        and roles & {"bottom", "height"}
    )
    return {"x", "y"} <= roles or bool(box)


def names_in_comments(comments: Sequence[str], width: int) -> list[str]:
    """The names of `width` columns in the last comment that has them; none if none has."""
    for comment in reversed(comments):
        for names in (comment.split(mark) for mark in (None, ",", ";", "\t")):
            roles = {role_of(name) for name in names}
            if len(names) == width and {"id", "x", "y"} <= roles:
                return [name.strip() for name in names]
    return []


def schema_of(table: Table, stated: Mapping[str, str]) -> Schema:
    """The columns that the user has `given`, by name or number from 1, and those whose names say.

    Raises:
        InputError: naming every role that is missing or stands twice, with a command to
            paste.
    """
    places = {key: _place(table, key, name) for key, name in stated.items()}
    taken = {at for role, at in places.items() if role in ROLES}
    named = dict[str, list[int]]()
    for at, name in enumerate(table.names):
        if at not in taken and (role := role_of(name)):
            named.setdefault(role, []).append(at)
    clocks = {"time", "frame"} & stated.keys()
    if {"x", "y"} & stated.keys() or (
        not set(BOX) & stated.keys() and {"x", "y"} <= named.keys()
    ):
        named = {role: at for role, at in named.items() if role not in BOX}
    elif set(BOX) & stated.keys() or _has_position(named.keys() - {"x", "y"}):
        named = {role: at for role, at in named.items() if role not in ("x", "y")}
    for role in ROLES:
        columns = named.get(role, []) if role not in places else []
        if role in ("time", "frame") and clocks:
            continue
        if len(columns) == 1 or (columns and role in ("vx", "vy", *FLAGS)):
            places[role] = columns[0]
    required = [] if {"time", "frame"} & places.keys() else ["time"]
    required += [role for role in ("id",) if role not in places]
    if not _has_position(places):
        required += [role for role in ("x", "y") if role not in places]
    if required:
        raise _refusal(table, places, required, named)
    points = {role: at for role, at in places.items() if role in (*ROLES[:5], *BOX)}
    if len(set(points.values())) < len(points):
        raise InputError(
            f"{table.path}: {', '.join(points)} must be {len(points)} columns"
        )
    labels = () if "label" in stated else tuple(named.get("label", ()))
    units = {
        role: unit
        for role in ("time", "x", "y", "left", "vx")
        if role in places and (unit := plain_name(table.names[places[role]])[1])
    }
    recordings = tuple(
        at for at in named.get("recording", ()) if at not in places.values()
    )
    return Schema(places, units, labels, recordings, frozenset(stated))


def _place(table: Table, key: str, name: str) -> int:
    """The column with this number from 1, or this name."""
    if name.isdecimal():
        if 1 <= int(name[:9]) <= len(table.names):
            return int(name) - 1
    elif (count := list(table.names).count(name)) == 1:
        return list(table.names).index(name)
    elif count:
        raise InputError(
            f"{table.path}: {key}={name}: {count} columns are called so; say a number"
        )
    raise InputError(
        f"{table.path}: no column {name[:40]!r}: which column is {key}? There are {_shown(table)}"
    )


def _shown(table: Table) -> str:
    return ", ".join(repr(name[:30]) for name in table.names[:12])


def _refusal(
    table: Table,
    places: Mapping[str, int],
    required: Sequence[str],
    named: Mapping[str, Sequence[int]],
) -> InputError:
    """What names leave open, the whole command that values propose, and rows as read so."""
    if len(table.names) < 3:
        what = f"only the columns {_shown(table)}: separate columns"
        return InputError(f"{table.path}: {what} by commas, semicolons, tabs or blanks")
    guess = dict(places) | {role: named[role][0] for role in required if role in named}
    guess |= propose(table, guess)
    columns = [
        f"{role}={column_name(table, at)}"
        for role in dict.fromkeys(("time", "frame", *ROLES, *guess))
        if (at := guess.get(role)) is not None
    ]
    words = {"time": "time or frame"}
    lacking = [role for role in required if role not in guess]
    lacking = [role for role in lacking if role != "time" or "frame" not in guess]
    columns += [f"{role}={'none' if role == 'id' else 'NAME'}" for role in lacking]
    error = InputError(
        f"{table.path}: which column is {', '.join(words.get(role, role) for role in required)}? "
        f"There are {_shown(table)}: say {option('columns', tuple(columns))}"
    )
    if not lacking:
        rows = zip(*(table.column(at).head(5) for at in guess.values()))
        previews = (
            " ".join(f"{role} {text}" for role, text in zip(guess, row)) for row in rows
        )
        error.add_note("the first rows, read so:\n  " + "\n  ".join(previews))
    return error


def column_name(table: Table, at: int) -> str:
    """The name of a column as `columns` takes it, or its number from 1."""
    name = table.names[at]
    plain = (
        name.isprintable()
        and not name.isdecimal()
        and list(table.names).count(name) == 1
    )
    return name if plain and name else str(at + 1)


# From coordinates of a picture to metres, and back: homographies, scales and
# handedness.
#
# Positions have x to the right, y up, so that left is counter-clockwise. In pictures y
# points down.

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
    usable = depth * np.sign(np.median(depth) or 1.0) > 1e-12 * np.abs(depth).max()
    return np.divide(
        mapped[..., :2], depth, out=np.full(points.shape, np.nan), where=usable
    )


def outside(matrix: np.ndarray, points: np.ndarray, width: int, height: int) -> float:
    """Share of `points [P, 2]`, in metres, that lie outside a picture of this size in pixels."""
    pixels = project(np.linalg.inv(matrix), points)
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= -0.5) & (pixels <= [width - 0.5, height - 0.5])).all(
            axis=-1
        )
    return float(1 - inside.mean())


def positions_of(
    table: Table, schema: Schema, options: ReadOptions, unit: str | None
) -> tuple[Table, np.ndarray, np.ndarray, list[str]]:
    """The rows with a position, [R, 2] metres, [R, 2] in the file's unit, and what to warn of.

    `unit` is what the file says of itself.

    Raises:
        InputError: where no row has one, or their unit is not known or said twice.
    """
    places, lines = schema.places, list[str]()
    roles = [role for role in (BOX if schema.is_box else ("x", "y")) if role in places]
    values = table.numbers(*(places[role] for role in roles), missing=True)
    has_position: Any = ~np.isnan(values).any(axis=1)
    if has_position.sum() < len(values):
        if not has_position.any():
            raise InputError(f"{table.path}: no row has a position")
        lines.append(
            f"{np.sum(~has_position)} rows have no position, and are taken as not seen"
        )
        table, values = table.take(has_position), values[has_position]
    column = dict(zip(roles, values.T))
    if schema.is_box:
        right = (
            column["right"] if "right" in column else column["left"] + column["width"]
        )
        bottom = (
            column["bottom"] if "bottom" in column else column["top"] + column["height"]
        )
        wrong = (right < column["left"]) | (bottom < column["top"])
        table.refuse(
            wrong, lambda at: "the box ends before it begins (left top right bottom)"
        )
        raw = np.column_stack([(column["left"] + right) / 2, bottom])
    else:
        raw = values
    stated = options.unit_of(table.path.stem)
    if unit and stated and abs(metres_in(stated) / metres_in(unit) - 1) > 1e-6:
        if "scale" not in options.allow:
            raise InputError(
                f"{table.path}: the file says that coordinates are {unit}, "
                f"{option('unit', stated)}: which is right? ({option('allow', ('scale',))} takes "
                "the option)"
            )
        lines.append(f"allowed scale: the file says {unit}, {option('unit', stated)}")
    if schema.in_picture and not (stated or unit or options.homography):
        raise InputError(
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
        if schema.in_picture:
            position = position * [1, -1]  # Rows of pictures count downward.
    if options.flip_y or (schema.in_picture and not options.homography):
        table = dataclasses.replace(
            table, notes=(*table.notes, "y is turned round, to point up")
        )
    return table, position * [1, -1 if options.flip_y else 1], raw, lines


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
        if unit and unit != "px":
            add("unit", unit, f"the name {table.names[schema.places[role]]!r}")
    for key, value in table.facts.items():
        add(key, value, "the file")
    for comment in table.comments:
        comment = re.sub(r"\[[^]]*\d[^]]*\]", "", comment)  # [1/s] is no rate
        if match := _RATE.search(comment):
            add("fps", match[2] or match[3], f"the comment {comment[:40]!r}")
        names = comment.split()
        if (
            "unit" not in facts
            and len(names) != len(table.names)
            and (match := _RATE_UNIT.search(comment))
        ):
            add(
                "unit",
                plain_name(f"x [{match[1]}]")[1],
                f"the comment {comment[:40]!r}",
            )
    for path in _beside(table.path):
        for key, value in _facts_in(path).items():
            add(key, value, path.name)
    return facts


def _beside(path: Path) -> list[Path]:
    """Files of metadata beside a table: 00_tracks.csv has 00_tracksMeta.csv, a.csv a_meta.json."""
    if not path.suffix or not path.parent.is_dir():
        return []
    stem = path.stem.rpartition("_")[0] or path.stem
    return [
        other
        for other in sorted(path.parent.glob(f"{glob.escape(stem)}*[mM]eta*"))
        if other != path and other.suffix.lower() in (".csv", ".json")
    ]


def _facts_in(path: Path) -> dict[str, str]:
    """A rate and a unit in a file of metadata; nothing where it cannot be read."""
    fields = {}
    if path.suffix.lower() == ".json":
        with contextlib.suppress(OSError, ValueError):
            fields = json.loads(path.read_text(encoding="utf-8"))
        fields = fields if isinstance(fields, dict) else {}
    elif (table := _table_in(path)) and len(table.row) == 1:
        fields = {name: table.column(at)[0] for at, name in enumerate(table.names)}
    facts = {}
    for name, value in fields.items():
        if plain_name(name)[0] in RATE_NAMES:
            with contextlib.suppress(TypeError, ValueError):
                facts["fps"] = str(float(value))
        elif plain_name(name)[0] in ("unit", "units") and plain_name(f"x [{value}]")[1]:
            facts["unit"] = plain_name(f"x [{value}]")[1]
    return facts


def _table_in(path: Path) -> Table | None:
    with contextlib.suppress(InputError):
        return read_table(path)
    return None


def kinds_beside(table: Table, schema: Schema) -> tuple[str, pl.Series] | None:
    """Name and [R] lower-case kinds of the rows' ids, as a file beside the table says."""
    for path in _beside(table.path):
        other = _table_in(path) if path.suffix.lower() == ".csv" else None
        if other is None:
            continue
        roles = [role_of(name) for name in other.names]
        if "id" in roles and "label" in roles and not {"x", "y"} & set(roles):
            ids, kinds = (other.column(roles.index(role)) for role in ("id", "label"))
            kind = dict(zip(ids, kinds.str.to_lowercase()))
            rows = table.column(schema.places["id"]).replace_strict(
                kind, default="", return_dtype=pl.String
            )
            return f"{other.names[roles.index('label')]} in {path.name}", rows
    return None


def velocity_ratio(
    table: Table,
    schema: Schema,
    ids: np.ndarray,
    stamp: np.ndarray,
    position: np.ndarray,
) -> float | None:
    """Units of `stamp` in a second by the columns vx, vy: velocity over displacement per stamp.

    Over four rows, so that rounding and noise matter little; None without columns that
    point where people go. `ids`, `stamp` are [R], `position` is [R, 2].
    """
    if not {"vx", "vy"} <= schema.places.keys():
        return None
    velocity = table.numbers(schema.places["vx"], schema.places["vy"], missing=True)
    order = np.lexsort((stamp, ids))
    ids, stamp = ids[order], stamp[order]
    position, velocity = position[order], np.nan_to_num(velocity[order])
    same = np.flatnonzero((ids[4:] == ids[:-4]) & (stamp[4:] > stamp[:-4]))
    if len(same) < ENOUGH:
        return None
    moved = (position[same + 4] - position[same]) / (stamp[same + 4] - stamp[same])[
        :, None
    ]
    weights = np.array([0.125, 0.25, 0.25, 0.25, 0.125])
    mean = np.einsum("l,lnd->nd", weights, velocity[same + np.arange(5)[:, None]])
    pairs = (mean, moved), (moved, moved), (mean, mean)
    across, length, speed = ((first * other).sum(axis=1) for first, other in pairs)
    moving = (length > 0.01 * np.median(length)) & (speed > 0) & (length > 0)
    if not moving.any():
        return None
    across, length, speed = across[moving], length[moving], speed[moving]
    # Medians, for velocities are wrong where tracks begin or are exchanged.
    cosine = np.median(across / np.sqrt(length * speed))
    return float(np.median(across / length)) if cosine > 0.9 else None


# The clock of a table: seconds of its times or frames, as far as its witnesses agree.

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
DATE = "as 2024-05-01 12:30:00.4 (or use seconds)"
AGREE = 0.15  # share by which witnesses of one rate may differ: velocities are smoothed
USUAL_RATES = (
    29.97,
    23.976,
    59.94,
    12.5,
)  # frames a second of videos that are no whole numbers


def stamps_of(
    table: Table,
    schema: Schema,
    options: ReadOptions,
    period: float,
    ids: np.ndarray,
    part: np.ndarray,
    position: np.ndarray,
    facts: Mapping[str, str],
) -> tuple[np.ndarray, list[str], list[str]]:
    """[R] seconds, and what to warn of and to note: of the clock that its witnesses agree on.

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
    place = schema.places[schema.clock]
    warnings, notes = list[str](), list[str]()
    unit = facts.get("unit")
    if unit and options.unit_of(table.path.stem) is None:
        notes.append(f"coordinates in {unit} ({facts['unit_by']})")
    metres = metres_in(options.unit_of(table.path.stem) or unit or "m")
    if schema.clock == "time":
        stamp = _seconds(table, place, options, schema.units.get("time"), notes)
        if "time" not in schema.declared:
            _refuse_other_frames(table, place, stamp, part)
        rate, fps = 1.0, {"the clock": 1.0}
    elif options.time_unit:
        raise InputError(
            f"{table.path}: {option('time_unit')} is of no use: it counts frames"
        )
    else:
        stamp = table.whole_numbers(place)
        stated_rate = options.fps_of(table.path.stem)
        fps = {option("fps"): stated_rate} if stated_rate else {}
        if options.eth_stride and table.path.stem.startswith("biwi_eth"):
            fps = {option("eth_stride"): options.eth_stride / period}
        stated = set(fps)
        if "fps" in facts:
            fps[facts["fps_by"]] = float(facts["fps"])
    ratio = velocity_ratio(table, schema, ids, stamp, position)
    if ratio is not None:
        columns = (
            f"{table.names[schema.places['vx']]}, {table.names[schema.places['vy']]}"
        )
        # Velocities are in the unit of the coordinates, or in metres.
        scale = 1 / metres if not options.homography else 1.0
        rates = (ratio, ratio * scale)
        reference = next(iter(fps.values()), None)
        if reference is None:
            ratio = next((rate for rate in rates if 0.9 < rate < 130), ratio)
        else:
            ratio = min(rates, key=lambda rate: abs(np.log(rate / reference)))
        usual = np.array([round(ratio), *USUAL_RATES])
        nearest = float(usual[abs(usual - ratio).argmin()])
        ratio = nearest if abs(ratio / (nearest or 1) - 1) < 0.02 else ratio
        fps[f"columns {columns}"] = float(ratio)
    if fps:
        witness, rate = next(iter(fps.items()))
        for other, value in fps.items():
            if abs(np.log(value / rate)) <= np.log1p(AGREE):
                continue
            line = (
                f"{witness} says {rate:g} frames a second, {other} {value:g}"
                if schema.clock == "frame"
                else f"{other} say that people move {value:.3g} times as fast as the clock and "
                "positions do"
            )
            if "clock" not in options.allow:
                raise InputError(
                    f"{table.path}: {line}: which is right? ({option('fps')}, "
                    f"{option('time_unit')}, {option('unit')}, or {option('allow', ('clock',))} "
                    "takes the first)"
                )
            warnings.append(f"allowed clock: {line}")
        if schema.clock == "frame":
            if len(fps) == 1 and ratio is not None:
                witness += (
                    f" alone, which may err by a twentieth: {option('fps')} corrects it"
                )
            if witness not in stated:
                notes.append(f"{rate:g} frames a second ({witness})")
            # In this order 10 frames at 25 a second are 0.4 s exactly.
            stamp = stamp / (rate * period) * period
        if ratio is not None and not any(
            line.startswith("allowed") for line in warnings
        ):
            notes.append(f"{columns} agree with the clock")
    elif schema.clock == "frame":
        if schema.in_picture and np.any(np.diff(np.unique(stamp)) == 1):
            raise InputError(
                f"{table.path}: it has every frame of a video: say how many a second "
                f"({option('fps', 30)})"
            )
        stamp = usual_frames(table, stamp, ids) * period
    return stamp, warnings, notes


def usual_frames(
    table: Table, frame: np.ndarray, ids: np.ndarray, any_step: bool = False
) -> np.ndarray:
    """[R] frames in their most common step of people.

    Raises:
        InputError: where that step is unusual, unless `any_step` will do.
    """
    order = np.lexsort((frame, ids))
    steps = np.diff(frame[order])[
        (np.diff(ids[order]) == 0) & (np.diff(frame[order]) > 0)
    ]
    steps = steps if len(steps) else np.diff(np.unique(frame))
    stride = common(steps) if len(steps) else 1.0
    if not any_step and stride not in STEPS:
        raise InputError(
            f"{table.path}: its frames are {stride:g} apart, at 25 a second {stride / 25:.2f} s: "
            f"say how many make a second ({option('fps', 25)})"
        )
    return frame / stride


def _seconds(
    table: Table, place: int, options: ReadOptions, named: str | None, notes: list[str]
) -> np.ndarray:
    """[R] seconds in a column of times."""
    path, name, unit = table.path, table.names[place], options.time_unit
    if options.fps_of(path.stem) is not None:
        raise InputError(
            f"{path}: {option('fps')} counts frames, and {name!r} is a time"
        )
    if named in _SECONDS:
        if unit and unit != named:
            stated = option("time_unit", unit)
            raise InputError(f"{path}: the name {name!r} says {named}, {stated}")
        if unit is None and named != "s":
            notes.append(f"times in {named} (the name {name!r})")
        unit = named
    texts = table.column(place)
    if re.match(r"\d{4}-\d\d-", texts[0]) and not options.time_unit:
        moments = texts.str.to_datetime(time_unit="us", time_zone="UTC", strict=False)
        wrong = moments.is_null().to_numpy()
        table.refuse(
            wrong, lambda at: f"{texts[at][:40]!r} is not a date and time, {DATE}"
        )
        return moments.dt.timestamp("us").to_numpy() / 1e6
    stamp = table.numbers(place)[:, 0] * _SECONDS[unit or "s"]
    counts = np.unique(stamp)
    if not unit and len(counts) > 10 and (counts == np.rint(counts)).all():
        raise InputError(
            f"{path}: all of {name!r} are whole numbers: do they count frames "
            f"({option('columns', (f'frame={name}',))} {option('fps', 25)}), or is that their unit "
            f"({option('time_unit', 's')} or ms)?"
        )
    return stamp


def _refuse_other_frames(
    table: Table, clock: int, stamp: np.ndarray, part: np.ndarray
) -> None:
    """Refuse a column of frames that counts anything but the times [R] of each recording [R]."""
    places = [at for at, name in enumerate(table.names) if role_of(name) == "frame"]
    frame = (
        table.numbers(*places, missing=True).ravel()
        if len(places) == 1
        else np.zeros(0)
    )
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
                f"{option('columns', (f'frame={frames}',))} or time={times}"
            )
