"""Readers of tables: by their columns, and of layouts that have no names of columns."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
import polars as pl

from neurosym_jax.data.columns import (
    Schema,
    column_name,
    facts_of,
    kinds_beside,
    names_in_comments,
    parse_columns,
    positions_of,
    role_of,
    schema_of,
    stamps_of,
    vocabulary,
)
from neurosym_jax.data.evidence import roughness
from neurosym_jax.data.tables import Format, Head, ReadOptions, Table, read_table
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, option, printable

__all__ = [
    "Cliff",
    "Columns",
    "Layout",
    "Mot",
    "MotResults",
    "Obsmat",
    "Stanford",
    "Text",
    "recordings_of",
]


# Tables whose columns have roles: a user's own, and layouts that are known by their
# numbers.
#
# Rows of other kinds than people, and rows that are no positions, are left out. A column
# of scenes, runs or cameras splits the table into recordings.


class Columns(Format):
    """A user's own table, whose columns are named, numbered or have usual names."""

    title = "table with named columns"
    uses = frozenset(
        {"columns", "fps", "keep", "time_unit", "unit", "homography", "flip_y"}
    )

    def knows(self, head: Head) -> bool:
        """Names in a header or a comment, a column of texts, or more than four columns."""
        width = head.rows.shape[1]
        texts = (np.isnan(head.rows).mean(axis=0) > 0.5).any()
        named = head.names or names_in_comments(head.comments, width)
        return bool(named or texts or width > 4)

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in one table.

        Raises:
            InputError: naming file, row and reason.
        """
        _, has_header = parse_columns(options.columns)
        return self.take(read_table(path, has_header=has_header), options, period)

    def take(self, table: Table, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in a table that was read."""
        stated, _ = parse_columns(options.columns)
        table = _named_by_comments(table)
        if stated.get("id") == "none":  # The whole table is one person.
            fields = table.fields.list.concat(pl.Series([["0"]]))
            table = dataclasses.replace(
                table, names=[*table.names, "none"], fields=fields
            )
        return recordings_of(table, schema_of(table, stated), options, period)


@dataclasses.dataclass(frozen=True)
class Layout(Format):
    """A table without a header that is known by its numbers."""

    uses = frozenset({"unit", "fps", "keep", "homography", "flip_y"})
    layout: ClassVar[tuple[str, ...]] = ()
    """What each column is: a role, or another name, which is not read."""
    decimals: ClassVar[int | None] = None  # to which positions are rounded
    people: ClassVar[
        tuple[str, ...]
    ] = ()  # kinds that are kept, where the column has numbers

    def knows(self, head: Head) -> bool:
        """Whether the first rows fit every role."""
        rows = head.rows
        if rows.shape[1] != len(self.layout) or not len(rows):
            return False
        column = dict(zip(self.layout, rows.T))
        fits = {
            "frame": lambda values: (values % 1 == 0).all(),
            "id": lambda values: (values % 1 == 0).all(),
            "time": lambda values: (values % 1 != 0).any(),
            "lost": lambda values: np.isin(values, (0, 1)).all(),
            "flag": lambda values: np.isin(values, (0, 1)).all(),
            "zero": lambda values: not values.any(),
            "zero2": lambda values: not values.any(),
            "text": lambda values: np.isnan(values).all(),
            "label": lambda values: (np.isnan(values) | (values % 1 == 0)).all(),
            "share": lambda values: ((values >= 0) & (values <= 1)).all(),
            "speed": lambda values: (values >= 0).all(),
            "heading": lambda values: (np.abs(values) <= np.pi + 1e-3).all(),
            "width": lambda values: (values > 0).all(),
            "height": lambda values: (values > 0).all(),
            "right": lambda values: (values >= column["left"]).all(),
            "bottom": lambda values: (values >= column["top"]).all(),
        }
        return all(
            fits[role](values) for role, values in column.items() if role in fits
        )

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in a file."""
        table = read_table(path, self.layout)
        self.check(table)
        places = {
            role: at for at, role in enumerate(self.layout) if role_of(role) == role
        }
        schema = Schema(places, declared=frozenset(places))
        return recordings_of(table, schema, options, period, self.decimals, self.people)

    def check(self, table: Table) -> None:
        """Refuse what is no such table after all."""


def recordings_of(
    table: Table,
    schema: Schema,
    options: ReadOptions,
    period: float,
    decimals: int | None = None,
    people: Sequence[str] = (),
) -> list[Tracks]:
    """The recordings in a table: people at positions in metres, on the clock that it says.

    Positions are rounded to `decimals`; `people` are kinds of people where `options`
    say nothing.

    Raises:
        InputError: naming file, row and reason.
    """
    places, path = schema.places, table.path
    table, warnings = _seen(table, schema)
    table, lines = _people(table, schema, options.keep or people)
    warnings += lines
    facts = facts_of(table, schema)
    table, position, raw, lines = positions_of(
        table, schema, options, facts.get("unit")
    )
    warnings += lines
    if decimals is not None:
        position = np.round(position, decimals)
    ids = table.ids(places["id"])
    keys = ["_".join(row) for row in zip(*map(table.column, schema.recordings))]
    kinds, part = np.unique(keys or [""] * len(table.row), return_inverse=True)
    names = [printable(f"{path.stem}_{kind}"[:200]) for kind in kinds]
    names = names if len(names) > 1 else [printable(path.stem)]
    stamp, lines, notes = stamps_of(
        table, schema, options, period, ids, part, raw, facts
    )
    warnings += lines
    table = dataclasses.replace(table, notes=(*table.notes, *notes))
    extras = {name: table.extra(at) for name, at in schema.extras.items()}
    order = np.lexsort((stamp, ids))
    over = (np.diff(ids[order]) == 0) & (np.diff(stamp[order]) <= 1)
    over &= np.diff(part[order]) != 0
    moves = np.linalg.norm(np.diff(position[order], axis=0)[over], axis=1)
    if len(moves) and np.median(moves) < 1:
        times = f"{len(moves)} times a person goes on in another recording: is it one that a"
        extra = option("columns", ("camera=camera",))
        warnings.append(f"{times} column splits ({extra} does not split)?")
    frames = places["frame"] if schema.clock == "frame" else None
    columns = [f"{role}={column_name(table, at)}" for role, at in places.items()]
    about = {"warnings": warnings, "clock": frames, "columns": columns}
    return table.tracks(stamp, ids, position, extras, parts=(names, part), **about)


def _named_by_comments(table: Table) -> Table:
    """The table with the names that a comment before its first row has, if it has no header."""
    width = len(table.names)
    names = names_in_comments(table.comments, width)
    if not names or list(table.names) != [str(at + 1) for at in range(width)]:
        return table
    notes = (*table.notes, f"columns named in a comment: {' '.join(names)}")
    return dataclasses.replace(table, names=names, notes=notes)


def _seen(table: Table, schema: Schema) -> tuple[Table, list[str]]:
    """The rows that no flag calls lost, invalid or without confidence, and a line for the rest."""
    lines = []
    for role in ("lost", "valid", "confidence"):
        if role not in schema.places:
            continue
        at = schema.places[role]
        texts = table.words(at)
        number = texts.cast(pl.Float64, strict=False)
        is_set = (
            (number > 0).fill_null(texts.is_in(("true", "yes", "t", "y"))).to_numpy()
        )
        usable = ~is_set if role == "lost" else is_set
        if role == "confidence" and (number < 0).fill_null(False).all():
            continue  # -1 everywhere: unknown
        if not usable.any():
            raise InputError(
                f"{table.path}: column {table.names[at][:30]!r} leaves no row"
            )
        if not usable.all():
            name = role if table.names[at].isdecimal() else table.names[at][:30]
            values = {"lost": "True", "valid": "False", "confidence": "0"}[role]
            lines.append(f"{np.sum(~usable)} rows with {name} {values} are left out")
            table = table.take(usable)
    return table, lines


def _people(
    table: Table, schema: Schema, keep: Sequence[str]
) -> tuple[Table, list[str]]:
    """The rows of people by the columns of kinds, and a line for what each leaves out.

    These are the one that the user named, or else all by name, and those of the first
    columns (there may be millions) whose texts say so; numbers, and kinds in a file
    beside, count only where no texts do.
    """
    people, others = vocabulary()["people"], vocabulary()["others"]
    kinds = [kind.lower() for kind in keep]
    if "label" in schema.places:
        labels = [schema.places["label"]]
    else:
        used = {at for role, at in schema.places.items() if role not in schema.extras}
        free = [at for at in range(min(50, len(table.names))) if at not in used]
        labels = [
            *schema.labels,
            *(at for at in free if table.words(at).is_in(others).any()),
        ]
    columns = {table.names[at][:30]: table.words(at) for at in labels}
    if not columns and (beside := kinds_beside(table, schema)) is not None:
        columns = {beside[0]: beside[1]}
    texts = {
        name: column
        for name, column in columns.items()
        if column.cast(pl.Float64, strict=False).null_count()
        or column.is_in(kinds).any()
    }
    if keep and not columns:
        raise InputError(
            f"{table.path}: {option('keep')}: no column is a label, class, type or category"
        )
    lines, is_person = [], np.ones(len(table.row), bool)
    for name, column in (texts or columns).items():
        mask = column.is_in(kinds or people).to_numpy()
        others = column.filter(~mask).unique(maintain_order=True).head(6)
        left = printable(", ".join(kind[:30] or "nothing" for kind in others))
        if not mask.any():
            raise InputError(
                f"{table.path}: column {name!r} has {left}: say with {option('keep')} which are "
                "people"
            )
        if not mask.all():
            counted = (
                f"{np.sum(~mask & is_person)} rows with {name} {left} are left out"
            )
            lines.append(f"{counted} ({option('keep')} says who is kept)")
            is_person &= mask
    return (table if is_person.all() else table.take(is_person)), lines


# Layouts without a header: what each column is. Numbers alone say which file has one.

# times, by which another reading of the columns gives the lie to the usual one
SMOOTHER = 5


class Text(Layout):
    """Rows `frame ped x y`, as SGAN arranges ETH/UCY, rounded to four decimals as there."""

    title = "rows of `frame ped x y`"
    uses = frozenset({"unit", "fps", "homography", "flip_y"})
    layout = ("frame", "id", "x", "y")
    decimals = 4

    def knows(self, head: Head) -> bool:
        """Anything, also binary files, which the reader refuses with the reason."""
        return True

    def check(self, table: Table) -> None:
        """Refuse tracks that are smoother with frame and ped exchanged.

        Raises:
            InputError: with the columns that fit.
        """
        table.whole_numbers(1)
        rows = np.column_stack([table.numbers(0, 1), table.numbers(2, 3, missing=True)])
        rows = rows[~np.isnan(rows).any(axis=1)]
        if not len(rows):
            return
        frame, ped, position = rows[:, 0], rows[:, 1], rows[:, 2:]
        usual, other = (
            roughness(*pair, position) for pair in ((frame, ped), (ped, frame))
        )
        if SMOOTHER * np.sum(other) < np.sum(usual):
            raise InputError(
                f"{table.path}: its tracks are smooth where the first column is the person, not "
                f"the frame: say {option('columns', ('id=1', 'frame=2', 'x=3', 'y=4'))}"
            )


class Obsmat(Layout):
    """ETH's own rows, of which z and vz are zero; 6 frames are 0.4 s in eth, 10 in hotel."""

    title = "ETH's obsmat (`frame id x z y vx vz vy`)"
    uses = frozenset({"fps", "flip_y"})
    layout = ("frame", "id", "x", "zero", "y", "vx", "zero2", "vy")
    decimals = 4


class Cliff(Layout):
    """Tracks that CLiFF-LHMP made of THÖR; each agent has a clock of its own.

    Source: Y. Zhu et al., "CLiFF-LHMP", IROS 2023.
    """

    title = "CLiFF-LHMP tracks (`time,id,x,y,speed,heading`)"
    uses = frozenset({"flip_y"})
    layout = ("time", "id", "x", "y", "speed", "heading")


class Stanford(Layout):
    """Annotations of the Stanford drone data set: boxes in pixels at 30 frames a second."""

    title = "Stanford's annotations (`id left top right bottom frame lost ... label`)"
    layout = (
        "id",
        "left",
        "top",
        "right",
        "bottom",
        "frame",
        "lost",
        "flag",
        "flag2",
        "label",
    )


class Mot(Layout):
    """Ground truth of MOTChallenge: boxes in pixels; class 1 are people who walk."""

    title = "MOTChallenge's ground truth (`frame,id,left,top,width,height,flag,class,visible`)"
    layout = (
        "frame",
        "id",
        "left",
        "top",
        "width",
        "height",
        "confidence",
        "label",
        "share",
    )
    people = ("1", "1.0")


class MotResults(Layout):
    """Results of trackers as MOTChallenge has them: boxes in pixels, and -1 at the end."""

    title = (
        "MOTChallenge's results (`frame,id,left,top,width,height,confidence,-1,-1,-1`)"
    )
    layout = (*Mot.layout[:7], "none", "none2", "none3")
