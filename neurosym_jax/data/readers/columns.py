"""Readers of tables: by their columns, and of layouts that have no names of columns."""

import dataclasses
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import polars as pl

from neurosym_jax.data.columns import (
    FLAGS,
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
from neurosym_jax.data.evidence import doubts_of, roughness
from neurosym_jax.data.tables import (
    Format,
    Head,
    Question,
    ReadOptions,
    Table,
    Unsaid,
    absent,
    read_table,
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
    "recordings_of",
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


YES, NO = ("true", "yes", "t", "y"), ("false", "no", "f", "n")
MANY_KINDS = 10  # of which there may be as many as people
SHARED = 3  # rows at one place that may stand for none
LEAP = 5  # usual steps that people leap there and back
NOWHERE = (-1, -99, -999, -9999, -99999, 99, 999, 9999, 99999)

# Tables whose columns have roles: a user's own, and layouts that are known by their
# numbers.
#
# Rows of other kinds than people, and rows that are no positions, are left out. A column
# of scenes, runs or cameras splits the table into recordings.


class Columns(Format):
    """A user's own table, whose columns are named, numbered or have usual names."""

    title = "table with named columns"
    uses = OF_A_TABLE

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
        """The recordings in a table that was read.

        Raises:
            InputError: as `read`; a question has the answers that read the table.
        """
        table = tidy(table)

        def take(columns: Iterable[str]) -> list[Tracks]:
            stated, _ = parse_columns(columns)
            stated.pop("table", "")  # It was chosen where there are several.
            rows = table
            if stated.get("id") == "none":  # The whole table is one person.
                rows = table.with_column("none", pl.Series([["0"]]))
            schema = schema_of(rows, stated, options.homography is not None)
            return recordings_of(rows, schema, options, period)

        try:
            return take(options.columns)
        except Question as question:
            raise answered(question, options.columns, take) from None


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


@dataclasses.dataclass(frozen=True)
class Layout(Format):
    """A table without a header that is known by its numbers."""

    uses = frozenset({"unit", "fps", "keep", "homography", "flip_y", "missing"})
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

        def take(columns: Iterable[str]) -> list[Tracks]:
            stated = dataclasses.replace(options, columns=tuple(columns))
            return Columns().read(path, stated, period)

        try:
            self.check(table)
        except Question as question:
            raise answered(question, (), take) from None
        places = {
            role: at for at, role in enumerate(self.layout) if role_of(role) == role
        }
        flags = tuple((role, places[role]) for role in FLAGS if role in places)
        schema = Schema(places, flags=flags, declared=frozenset(places))
        return recordings_of(table, schema, options, period, self.decimals, self.people)

    def check(self, table: Table) -> None:
        """Refuse what is no such table after all."""


def answered(
    question: Question,
    stated: Iterable[str],
    take: Callable[[Iterable[str]], list[Tracks]],
) -> InputError:
    """The question with those of its answers that read the table, and which people least belie.

    `take` reads the table by columns; `stated` are those that the user said.
    """
    doubts = dict[tuple[str, ...], int]()
    columns = dict[tuple[str, ...], tuple[str, ...]]()
    previews = []
    stated_pairs = _pairs(stated)
    for answer in question.answers:
        columns[answer] = tuple((stated_pairs | _pairs(answer)).values())
        try:
            recordings = take(columns[answer])
            doubts[answer] = sum(map(doubts_of, recordings))
            previews.append(_preview(recordings[0]))
        except Unsaid:  # Of what another option says, no more can be known.
            doubts[answer] = 0
        except InputError:
            continue
    if not doubts:
        example = option("columns", ("time=..", "id=..", "x=..", "y=.."))
        return InputError(
            f"{question}: none that reads it was found ({example} names them)"
        )
    fewest = min(doubts.values())
    texts = []
    for answer, count in doubts.items():
        if count == fewest:
            text = f"{option('columns', columns[answer])} {question.answers[answer]}"
            texts.append(text.strip())
    error = InputError(f"{question}: say {', or '.join(texts)}")
    if len(texts) == 1 and previews:
        error.add_note(previews[0])
    return error


def _pairs(columns: Iterable[str]) -> dict[str, str]:
    """The pairs ROLE=COLUMN by their roles."""
    return {pair.partition("=")[0]: pair for pair in columns}


def _preview(tracks: Tracks) -> str:
    """The first points of the first person of a recording, as it was read."""
    lines = ["the first points, read so:"]
    for second, person, (x, y) in zip(tracks.stamp[:5], tracks.id, tracks.position):
        lines.append(f"  {second:g} s, id {person}, x {x:g} m, y {y:g} m")
    return "\n".join(lines)


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
        Question: for columns that may mean another thing.
    """
    places = schema.places
    table = _people(_seen(table, schema), schema, options.keep or people)
    table = _with_ids(table, places["id"])
    facts = facts_of(table, schema)
    table, position, raw = positions_of(table, schema, options, facts.get("unit"))
    if decimals is not None:
        position = np.round(position, decimals)
    ids, texts = table.ids(places["id"])
    names, part = _parts(table, schema)
    table, stamp = stamps_of(table, schema, options, period, ids, part, raw, facts)

    is_shared = shared_places(ids, stamp, position)
    if is_shared.any():
        places_shared = np.unique(raw[is_shared], axis=0).tolist()
        values = ", ".join(map(str, places_shared))
        hint = f"at {values}, which people share: no position ({option('missing')})"
        table = table.take(~is_shared, hint)
        ids, stamp, part = ids[~is_shared], stamp[~is_shared], part[~is_shared]
        position = position[~is_shared]
    if schema.recordings:
        table = _warned_of_cameras(table, schema, ids, stamp, part, position)
    used = {*places.values(), *schema.labels, *schema.recordings}
    used |= {at for _, at in schema.flags}
    others = [at for at in range(len(table.names)) if at not in used]
    return table.tracks(
        stamp,
        ids,
        position,
        {name: table.extra(at) for name, at in schema.extras.items()},
        parts=(names, part),
        clock=places["frame"] if schema.clock == "frame" else None,
        columns=[f"{role}={column_name(table, at)}" for role, at in places.items()],
        unused=[column_name(table, at) for at in others],
        people=texts,
    )


def _parts(table: Table, schema: Schema) -> tuple[list[str], np.ndarray]:
    """The names of recordings, and [R] the index of each row's."""
    stem = table.path.stem
    columns = map(table.column, schema.recordings)
    keys = ["_".join(row) for row in zip(*columns)]
    if len(set(keys)) < 2:
        return [printable(stem)], np.zeros(len(table.row), int)
    kinds, part = np.unique(keys, return_inverse=True)
    return [printable(f"{stem}_{kind}"[:200]) for kind in kinds], part


def shared_places(
    ids: np.ndarray, stamp: np.ndarray, position: np.ndarray
) -> np.ndarray:
    """[R] bool: rows at a place that stands for none, as 0, 0 or -9999, -9999.

    People share it, or both its numbers are one of `NOWHERE`; rows of a person repeat
    it; and people leap there and back, so that a door or a seat is none.
    """
    is_shared = np.zeros(len(ids), bool)
    places, place, counts = np.unique(
        position, axis=0, return_inverse=True, return_counts=True
    )
    place = place.ravel()
    visits = np.unique(np.column_stack([place, ids]), axis=0)
    people = np.bincount(visits[:, 0], minlength=len(places))
    x, y = places.T
    is_nowhere = (x == y) & np.isin(x, NOWHERE)
    candidates = np.flatnonzero((counts >= SHARED) & ((people > 1) | is_nowhere))

    order = np.lexsort((stamp, ids))
    same = np.diff(ids[order]) == 0
    move = np.diff(position[order], axis=0)
    length = np.linalg.norm(move, axis=1)
    # The most frequent are enough: a recording has one or two such values.
    frequent = candidates[np.argsort(-counts[candidates])]
    for number in frequent[:5]:
        is_there = place[order] == number
        goes = is_there[1:] != is_there[:-1]
        walks = ~is_there[1:] & ~is_there[:-1]
        leaps = length[same & goes]
        steps = length[same & walks & (length > 0)]
        if not len(leaps) or not len(steps):
            continue
        if np.median(leaps) > LEAP * np.median(steps):
            is_shared |= place == number
    return is_shared


def _warned_of_cameras(
    table: Table,
    schema: Schema,
    ids: np.ndarray,
    stamp: np.ndarray,
    part: np.ndarray,
    position: np.ndarray,
) -> Table:
    """The table, with a warning where people go on in another recording that a column splits."""
    order = np.lexsort((stamp, ids))
    same_person = np.diff(ids[order]) == 0
    soon = np.diff(stamp[order]) <= 1
    other_part = np.diff(part[order]) != 0
    moves = np.diff(position[order], axis=0)[same_person & soon & other_part]
    length = np.linalg.norm(moves, axis=1)
    if not len(length) or np.median(length) >= 1:
        return table
    column = column_name(table, schema.recordings[0])
    unsplit = option("columns", (f"part={column}",))
    return table.warned(
        f"{len(length)} times a person goes on in another recording: is it one that a column "
        f"splits ({unsplit} does not split)?"
    )


def _with_ids(table: Table, at: int) -> Table:
    """The rows of a person: an empty id is no person, nor is -1 if no other id is negative."""
    texts = table.words(at)
    numbers = texts.cast(pl.Float64, strict=False)
    is_nobody = absent(texts)
    if not (numbers < -1).any():
        is_nobody |= (numbers == -1).fill_null(False)
    if is_nobody.all():
        raise InputError(
            f"{table.path}: no row has an id: let a tracker say first which rows are one person"
        )
    return table.take(~is_nobody.to_numpy(), "with no id or -1")


def _seen(table: Table, schema: Schema) -> Table:
    """The rows that no flag calls lost, invalid or without confidence."""
    words = vocabulary()
    flags = dict.fromkeys(schema.flags)
    used = {*schema.places.values(), *schema.recordings, *schema.labels}
    for at in range(min(len(table.names), 50)):
        # A column of such words alone is a flag, whatever its name.
        texts = table.words(at)
        is_unseen = texts.is_in(words["unseen"])
        is_state = (is_unseen | texts.is_in(words["seen"])).all()
        if at not in used and is_state and is_unseen.any():
            flags["state", at] = None
    for role, at in flags:
        is_seen = _is_seen(table, role, at)
        name = table.names[at][:30]
        if not is_seen.any():
            raise InputError(f"{table.path}: column {name!r} leaves no row")
        if table.names[at].isdecimal():
            name = role
        values = table.column(at).filter(~is_seen).unique(maintain_order=True)
        values = [value[:20] or "nothing" for value in values.head(3)]
        table = table.take(is_seen, f"with {name} {printable(', '.join(values))}")
    return table


def _is_seen(table: Table, role: str, at: int) -> np.ndarray:
    """[R] bool: what a flag says of a row, by its words or numbers.

    Raises:
        InputError: for a word or number whose meaning is not known.
    """
    words = vocabulary()
    texts = table.words(at)
    numbers = texts.cast(pl.Float64, strict=False)
    if role == "confidence":
        if (numbers < 0).fill_null(False).all():
            return np.ones(len(texts), bool)  # -1 everywhere: unknown
        return (numbers > 0).fill_null(texts.is_in(YES)).to_numpy()
    seen = texts.is_in(words["seen"])
    unseen = texts.is_in(words["unseen"])
    yes = texts.is_in(YES) | (numbers == 1).fill_null(False)
    no = texts.is_in(NO) | absent(texts) | (numbers == 0).fill_null(False)
    if role == "lost":
        seen = seen | no
        unseen = unseen | yes
    elif role == "valid":
        share = (numbers > 0) & (numbers < 1)
        seen = seen | yes | share.fill_null(False)
        unseen = unseen | no
    others = texts.filter(~(seen | unseen)).unique(maintain_order=True).head(4)
    if len(others):
        column = column_name(table, at)
        kinds = option("columns", (f"label={column}",))
        no_flag = option("columns", (f"{role}=none",))
        raise Unsaid(
            f"{table.path}: column {column!r} has {printable(', '.join(others))}: which rows are "
            f"positions? {kinds} with {option('keep')} and its words says it, {no_flag} takes all"
        )
    return seen.to_numpy()


def _people(table: Table, schema: Schema, keep: Sequence[str]) -> Table:
    """The rows of people by the columns of kinds.

    These are the one that the user named, or else all by name, and those of the first
    columns (there may be millions) whose texts say so; numbers, and kinds in a file
    beside, count only where no texts do, and names of rows or of people are no kinds.
    """
    people = vocabulary()["people"]
    others = vocabulary()["others"]
    kinds = [kind.lower() for kind in keep]
    if "label" in schema.declared:
        columns = {schema.places["label"]: table.words(schema.places["label"])}
    else:
        columns = _kinds(table, schema, people | others | set(kinds))
    columns = {table.names[at][:30]: texts for at, texts in columns.items()}
    if not columns:
        columns = kinds_beside(table, schema)
    if keep and not columns:
        raise InputError(
            f"{table.path}: {option('keep')}: no column is a label, class, type or category"
        )
    in_words = {}
    for name, texts in columns.items():
        if _are_words(texts) or texts.is_in(kinds).any():
            in_words[name] = texts
    is_person = np.ones(len(table.row), bool)
    for name, texts in (in_words or columns).items():
        mask = texts.is_in(kinds or people).to_numpy()
        left = texts.filter(~mask).unique(maintain_order=True).head(6)
        left = printable(", ".join(kind[:30] or "nothing" for kind in left))
        if not mask.any():
            column = f"{table.path}: column {name!r} has {left}"
            hint = f"say with {option('keep')} which are people"
            if not keep and texts.is_in(others).all():
                raise NoPeople(f"{column} alone: {hint}")
            raise Unsaid(f"{column}: {hint}")
        mask = mask[is_person]
        hint = f"({option('keep')} says who is kept)"
        table = table.take(mask, f"with {name} {left} {hint}")
        is_person[is_person] = mask
    return table


def _are_words(texts: pl.Series) -> bool:
    """Whether one of the texts is no number."""
    return texts.cast(pl.Float64, strict=False).null_count() > 0


def _kinds(
    table: Table, schema: Schema, words: Collection[str]
) -> dict[int, pl.Series]:
    """The columns of kinds by their names or `words`, in lower-case letters."""
    columns = {}
    used = {at for role, at in schema.places.items() if role not in schema.extras}
    people = max(table.column(schema.places["id"]).n_unique(), MANY_KINDS)
    for at in schema.labels:
        texts = table.words(at)
        if texts.n_unique() < people or texts.is_in(words).any():
            columns[at] = texts
    for at in range(min(50, len(table.names))):
        texts = table.words(at)
        if at not in used and texts.is_in(vocabulary()["others"]).any():
            columns[at] = texts
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
        """Anything, also binary files, which the reader refuses with the reason."""
        return True

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
                f"{table.path}: its tracks are smooth where the first column is the person, not "
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
