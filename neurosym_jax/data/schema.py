"""The schema of a table: which column has which role and unit, as a user or the names say.

The words of names stand in `vocabulary.tsv`. What names do not settle is proposed by
values, as a command to paste; it is never read without that.
"""

import dataclasses
import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib.resources import files

from neurosym_jax.data.proposals import propose
from neurosym_jax.data.table import Table
from neurosym_jax.errors import InputError, option

__all__ = [
    "BOX",
    "FLAGS",
    "ROLES",
    "Schema",
    "column_name",
    "names_in_comments",
    "names_tracks",
    "parse_columns",
    "plain_name",
]
__all__ += ["role_of", "schema_of", "vocabulary"]

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

    Raises: InputError: naming every role that is missing or stands twice, with a
        command to paste.
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
