"""Readers of tables: by their columns, and of layouts that have no names of columns."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl

from neurosym_jax.data.columns import (
    Rows,
    Schema,
    column_name,
    facts_of,
    kinds_beside,
    parse_columns,
    positions_of,
    rows_of,
    schema_of,
    stamps_of,
)
from neurosym_jax.data.evidence import doubts_of, roughness
from neurosym_jax.data.tables import (
    ROLES,
    Format,
    Head,
    Question,
    ReadOptions,
    Table,
    Unsaid,
    absent,
    read_table,
    vocabulary,
)
from neurosym_jax.data.tidy import tidy
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError, option, printable

__all__ = [
    "OF_A_TABLE",
    "Cliff",
    "Columns",
    "Layout",
    "Mot",
    "MotResults",
    "NoPeople",
    "Obsmat",
    "Stanford",
    "Text",
    "answered",
]


OF_A_TABLE = frozenset(
    {
        "columns",
        "fps",
        "keep",
        "time_unit",
        "unit",
        "homography",
        "flip_y",
        "missing",
    }
)
"""The fields of `ReadOptions` that say what a table does not."""


class NoPeople(InputError):
    """All rows of a table are of vehicles, robots or animals."""


LOOKED_AT = 50  # columns whose words are looked at
MANY_KINDS = 10  # of which there may be as many as people
LEAP = 5  # usual steps that people leap there and back

# Tables whose columns have roles: a user's own, and layouts that are known by their
# numbers.
#
# Rows of other kinds than people, and rows that are no positions, are left out. A column
# of scenes, runs or cameras splits the table into recordings.


class Columns(Format):
    """A user's own table, whose columns are named, numbered or have usual names."""

    title = "table with named columns"
    uses = OF_A_TABLE
    decimals: ClassVar[int | None] = None  # to which positions are rounded
    people: ClassVar[tuple[str, ...]] = ()  # kinds that are kept if no option says

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in one table.

        Raises:
            InputError: naming file, row and reason.
            Question: for columns that are missing or may mean another thing.
        """
        return self.take(tidy(self.table(path, options)), options, period)

    def table(self, path: Path, options: ReadOptions) -> Table:
        """The table in a file, of any shape."""
        header = parse_columns(options.columns).get("header")
        has_header = None if header is None else header == "yes"
        return read_table(path, has_header=has_header)

    def take(self, table: Table, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in a table with a row for each person and moment: people at positions in
        metres, on its clock.

        Raises:
            InputError: as `read`.
        """
        stated = parse_columns(options.columns)
        if stated.get("id") == "none":  # The whole table is one person.
            table = table.with_column("none", pl.Series([["0"]]))
        schema = schema_of(table, stated, options.homography is not None)
        places = schema.places
        table = _people(_seen(table, schema), schema, options.keep or self.people)
        table = _with_ids(table, places["id"], options.keep)
        facts = facts_of(table, schema)
        table, position, raw = positions_of(table, schema, options, facts)
        if self.decimals is not None:
            position = np.round(position, self.decimals)

        rows = rows_of(table, schema, options, position, raw)
        is_shared = shared_places(rows)
        if is_shared.any():
            shared = np.unique(rows.raw[is_shared], axis=0).tolist()
            shown = ", ".join(map(str, shared))
            hint = f"at {shown}, which people share: no position ({option('missing')})"
            rows = rows.take(~is_shared, hint)

        names, part = _parts(rows.table, schema)
        table, stamp = stamps_of(rows, schema, options, period, part, facts)
        if len(names) > 1:
            table = _warned_of_cameras(table, rows, schema, stamp, part)
        others = set(range(len(table.names))) - schema.used
        return table.tracks(
            stamp,
            rows.ids,
            rows.position,
            {name: table.extra(at) for name, at in schema.extras.items()},
            parts=(names, part),
            frame=rows.clock if schema.clock == "frame" else None,
            columns=[f"{role}={column_name(table, at)}" for role, at in places.items()],
            unused=[column_name(table, at) for at in sorted(others)],
            people=rows.people,
        )


def _is_whole(values: np.ndarray) -> np.ndarray:
    return values % 1 == 0


def _has_fractions(values: np.ndarray) -> np.ndarray:
    return (values % 1 != 0).any()


def _is_bit(values: np.ndarray) -> np.ndarray:
    return np.isin(values, (0, 1))


def _is_size(values: np.ndarray) -> np.ndarray:
    return values > 0


FITS: dict[str, Callable[[np.ndarray], Any]] = {
    "frame": _is_whole,
    "id": _is_whole,
    "time": _has_fractions,
    "lost": _is_bit,
    "flag": _is_bit,
    "none": lambda values: values == -1,
    "zero": lambda values: values == 0,
    "label": lambda values: np.isnan(values) | _is_whole(values),
    "share": lambda values: (values >= 0) & (values <= 1),
    "speed": lambda values: values >= 0,
    "heading": lambda values: np.abs(values) <= np.pi + 1e-3,
    "width": _is_size,
    "height": _is_size,
}
"""By role, without its number, what its values [R] are: [R] or [] bool."""


class Layout(Columns):
    """A table without a header that is known by its numbers."""

    uses = frozenset({"unit", "fps", "keep", "homography", "flip_y", "missing"})
    layout: ClassVar[tuple[str, ...]] = ()
    """What each column is: a role, or another name, which is not read."""

    def knows(self, head: Head) -> bool:
        """Whether the first rows fit every role."""
        rows = head.rows
        if head.names or rows.shape[1] != len(self.layout) or not len(rows):
            return False
        column = dict(zip(self.layout, rows.T))
        for role, values in column.items():
            fits = FITS.get(role.rstrip("0123456789"))
            if fits and not fits(values).all():
                return False
        if "right" not in column:
            return True
        has_width = (column["right"] >= column["left"]).all()
        has_height = (column["bottom"] >= column["top"]).all()
        return bool(has_width and has_height)

    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in a file."""
        table = read_table(path, self.layout)
        self.check(table)
        return self.take(table, options, period)

    def check(self, table: Table) -> None:
        """Refuse what is no such table after all."""


def answered(
    question: Question,
    stated: Iterable[str],
    take: Callable[[tuple[str, ...]], list[Tracks]],
) -> InputError:
    """The question with those of its answers that read the table, and which people least belie.

    `take` reads the table by columns; `stated` are those that the user said.
    """
    tried = []
    for answer, case in question.answers.items():
        pairs = {pair.partition("=")[0]: pair for pair in (*stated, *answer)}
        columns = tuple(pairs.values())
        text = f"{option('columns', columns)} {case}".strip()
        try:
            recordings = take(columns)
            doubts = sum(map(doubts_of, recordings))
            tried.append((doubts, text, _preview(recordings[0])))
        except Unsaid:  # Of what another option says, no more can be known.
            tried.append((0, text, ""))
        except InputError:
            continue
    if not tried:
        example = option("columns", ("time=..", "id=..", "x=..", "y=.."))
        return InputError(
            f"{question}: none that reads it was found ({example} names them)"
        )
    fewest, _, preview = min(tried)
    texts = [text for doubts, text, _ in tried if doubts == fewest]
    error = InputError(f"{question}: say {', or '.join(texts)}")
    if len(texts) == 1 and preview:
        error.add_note(preview)
    return error


def _preview(tracks: Tracks) -> str:
    """The first points of the first person of a recording, as it was read."""
    lines = ["the first points, read so:"]
    ids = tracks.ids_as_given()
    for second, person, (x, y) in zip(tracks.stamp[:5], ids, tracks.position):
        lines.append(f"  {second:g} s, id {person}, x {x:g} m, y {y:g} m")
    return "\n".join(lines)


def _parts(table: Table, schema: Schema) -> tuple[list[str], np.ndarray]:
    """The names of recordings, and [R] the index of each row's."""
    stem = table.path.stem
    columns = schema.columns.get("recording", ())
    if not columns:
        return [printable(stem)], np.zeros(len(table.row), int)
    keys = pl.Series([""] * len(table.row))
    for at in columns:
        keys = keys + "_" + table.column(at)
    kinds, part = np.unique(keys.to_numpy(), return_inverse=True)
    if len(kinds) == 1:
        return [printable(stem)], part
    return [printable(f"{stem}{kind}"[:200]) for kind in kinds], part


def shared_places(rows: Rows) -> np.ndarray:
    """[R] bool: rows at a place that stands for none, as 0, 0 or -9999, -9999.

    People share it, and leap there and back, so that a door or a seat is none.
    """
    points = pl.DataFrame(rows.position, schema=["x", "y"]).with_columns(id=rows.ids)
    count, people = pl.len().alias("count"), pl.col("id").n_unique().alias("people")
    places = points.group_by("x", "y").agg(count, people)
    places = places.filter(pl.col("people") > 1)
    # The most frequent are enough: a recording has one or two such values.
    places = places.sort("count", "x", "y", descending=True).head(5)

    length = np.linalg.norm(np.diff(rows.position, axis=0), axis=1)
    is_shared = np.zeros(len(points), bool)
    for place in places.select("x", "y").rows():
        is_there = (rows.position == place).all(axis=1)
        goes = is_there[1:] != is_there[:-1]
        walks = ~is_there[1:] & ~is_there[:-1]
        leaps = length[rows.same & goes]
        steps = length[rows.same & walks & (length > 0)]
        if len(leaps) and len(steps) and np.median(leaps) > LEAP * np.median(steps):
            is_shared |= is_there
    return is_shared


def _warned_of_cameras(
    table: Table, rows: Rows, schema: Schema, stamp: np.ndarray, part: np.ndarray
) -> Table:
    """The table, with a warning where people go on in another recording that a column splits."""
    soon = np.diff(stamp) <= 1
    other_part = np.diff(part) != 0
    moves = np.diff(rows.position, axis=0)[rows.same & soon & other_part]
    length = np.linalg.norm(moves, axis=1)
    if not len(length) or np.median(length) >= 1:
        return table
    column = column_name(table, schema.columns["recording"][0])
    unsplit = option("columns", (f"part={column}",))
    return table.warned(
        f"{len(length)} times a person goes on in another recording: is it one that a column "
        f"splits ({unsplit} does not split)?"
    )


def _with_ids(table: Table, at: int, keep: Sequence[str]) -> Table:
    """The rows of a person: an empty id is no person, nor is -1 if no other id is negative, nor a
    robot or vehicle among others."""
    texts = table.words(at)
    numbers = texts.cast(pl.Float64, strict=False)
    is_nobody = absent(texts)
    if not (numbers < -1).any():
        is_nobody |= (numbers == -1).fill_null(False)
    if is_nobody.all():
        raise InputError(
            "no row has an id: let a tracker say first which rows are one person"
        )
    # Such as `car_3` or `vehicle.audi`; people may be called `van Dijk`.
    kinds = texts.str.extract(r"^([^\W\d_]+)(?:$|[._/:#-]|\s*\d)").fill_null("")
    is_other = kinds.is_in(vocabulary()["others"])
    if not keep and not (is_other | is_nobody).all():
        name = column_name(table, at)
        as_label = option("columns", (f"id={name}", f"label={name}"))
        hint = (
            f"of {_some(texts, is_other)} ({as_label} with {option('keep')} takes them)"
        )
        table = table.take(~is_other.to_numpy(), hint)
        is_nobody = is_nobody.filter(~is_other)
    return table.take(~is_nobody.to_numpy(), "with no id or -1")


def _seen(table: Table, schema: Schema) -> Table:
    """The rows that no flag calls lost, invalid or without confidence."""
    words = vocabulary()
    flags = list(schema.flags)
    for at in sorted(set(range(min(len(table.names), LOOKED_AT))) - schema.used):
        # A column of such words alone is a flag, whatever its name.
        texts = table.words(at)
        is_unseen = texts.is_in(words["unseen"])
        if is_unseen.any() and (is_unseen | texts.is_in(words["seen"])).all():
            flags.append(("state", at))
    for role, at in flags:
        is_seen = _is_seen(table, role, at)
        name = table.names[at][:30]
        if not is_seen.any():
            raise InputError(f"column {name!r} leaves no row")
        if name.isdecimal():
            name = role
        table = table.take(is_seen, f"with {name} {_some(table.column(at), ~is_seen)}")
    return table


def _some(texts: pl.Series, chosen: Any) -> str:
    """The first of the `chosen` texts, for a message."""
    unique = texts.filter(chosen).unique(maintain_order=True).head(6)
    return printable(", ".join(text[:30] or "nothing" for text in unique))


def _is_seen(table: Table, role: str, at: int) -> np.ndarray:
    """[R] bool: what a flag says of a row, by its words or numbers.

    Raises:
        InputError: for a word or number whose meaning is not known.
    """
    texts = table.words(at)
    kinds = ("seen", "unseen", "yes", "no")
    seen, unseen, yes, no = (texts.is_in(vocabulary()[kind]) for kind in kinds)
    no |= absent(texts)
    number = texts.cast(pl.Float64, strict=False)
    if role == "confidence":
        is_unknown = (number < 0).fill_null(False).all()  # -1 everywhere
        yes |= (number > 0).fill_null(False) | is_unknown
        no = ~yes
    elif role == "valid":
        yes |= number.is_between(0, 1, closed="none").fill_null(False)
    elif role == "lost":
        yes, no = no, yes
    if role != "state":
        seen, unseen = seen | yes, unseen | no
    if not (seen | unseen).all():
        column = column_name(table, at)
        kinds = option("columns", (f"label={column}",))
        no_flag = option("columns", (f"{role}=none",))
        raise Unsaid(
            f"column {column!r} has {_some(texts, ~(seen | unseen))}: which rows "
            f"are positions? {kinds} with {option('keep')} and its words says it, {no_flag} "
            "takes all"
        )
    return seen.to_numpy()


def _people(table: Table, schema: Schema, keep: Sequence[str]) -> Table:
    """The rows of people by the columns of kinds.

    These are the one that the user named, or else all by name, and those of the first
    columns (there may be millions) whose texts say so; numbers, and kinds in a file
    beside, count only where no texts do, and names of rows or of people are no kinds.
    """
    people, others = vocabulary()["people"], vocabulary()["others"]
    kinds = [kind.lower() for kind in keep]
    columns = _kinds(table, schema) or kinds_beside(table, schema)
    if keep and not columns:
        raise InputError(
            f"{option('keep')}: no column is a label, class, type or category"
        )
    in_words = {}
    for name, texts in columns.items():
        is_number = texts.cast(pl.Float64, strict=False).is_not_null()
        if not is_number.all() or texts.is_in(kinds).any():
            in_words[name] = texts
    is_person = np.ones(len(table.row), bool)
    reasons = []
    wanted = kinds or people
    for name, texts in (in_words or columns).items():
        words = _first_words(texts)
        mask = (texts.is_in(wanted) | words.is_in(wanted)).to_numpy()
        left = _some(texts, ~mask)
        if not mask.any():
            error = Unsaid
            if not keep and words.is_in(others).all():
                error, left = NoPeople, f"{left} alone"
            raise error(
                f"column {name!r} has {left}: say with {option('keep')} which are "
                "people"
            )
        if not mask.all():
            reasons.append(f"{name} {left}")
        is_person &= mask
    hint = f"with {', '.join(reasons)} ({option('keep')} says who is kept)"
    return table.take(is_person, hint)


def _first_words(texts: pl.Series) -> pl.Series:
    """[R] first words, as `walker` of `walker.pedestrian.0001`; texts that begin with none."""
    return texts.str.extract(r"^([^\W\d_]+)").fill_null(texts)


def _kinds(table: Table, schema: Schema) -> dict[str, pl.Series]:
    """The columns of kinds by their names or words, in lower-case letters, by name."""
    labels = schema.columns.get("label", [])
    if "label" in schema.declared:
        return {table.names[at][:30]: table.words(at) for at in labels}
    people = max(table.column(schema.places["id"]).n_unique(), MANY_KINDS)
    used = {schema.places[role] for role in schema.places if role in ROLES}
    others = vocabulary()["others"]
    columns = {}
    for at in dict.fromkeys([*labels, *range(min(len(table.names), LOOKED_AT))]):
        texts = table.words(at)
        is_kind = texts.is_in(others).any() and at not in used
        if at in labels:
            has_others = _first_words(texts).is_in(others).any()
            is_kind = has_others or texts.n_unique() < people
        if is_kind:
            columns[table.names[at][:30]] = texts
    return columns


# Layouts without a header: what each column is. Numbers alone say which file has one.

SMOOTHER = 5
"""How many times smoother another reading of the columns must be to replace the usual one."""


class Text(Layout):
    """Rows `frame ped x y`, as SGAN arranges ETH/UCY, rounded to four decimals as there."""

    title = "rows of `frame ped x y`"
    uses = frozenset({"unit", "fps", "homography", "flip_y", "missing"})
    layout = ("frame", "id", "x", "y")
    decimals = 4

    def knows(self, head: Head) -> bool:
        """Up to four columns of numbers without names; also an empty file."""
        is_text = 2 * np.isnan(head.rows).sum(axis=0) > len(head.rows)
        return len(is_text) <= 4 and not (is_text.any() or head.names)

    def check(self, table: Table) -> None:
        """Refuse frames with fractions, and tracks that are smoother with frame and ped exchanged.

        Raises:
            InputError: with the columns that fit.
        """
        table.whole_numbers(1)
        numbers = table.numbers(0, 1)
        position = table.numbers(2, 3, missing=True)
        is_seen = ~np.isnan(position).any(axis=1)
        if not is_seen.any():
            return
        try:
            table.whole_numbers(0)
        except InputError as error:
            # It is no person's number either.
            time = {("time=1", "id=2", "x=3", "y=4"): ""}
            raise Question(f"{error}, so it may be the time", time) from None
        frame, ped = numbers[is_seen].T
        position = position[is_seen]
        usual = roughness(frame, ped, position)
        other = roughness(ped, frame, position)
        if SMOOTHER * np.sum(other) < np.sum(usual):
            raise Question(
                "its tracks are smooth where the first column is the person, not "
                "the frame",
                {("id=1", "frame=2", "x=3", "y=4"): ""},
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
