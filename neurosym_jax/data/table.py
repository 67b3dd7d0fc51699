"""Tables: the fields of a file of rows, which become numbers or ids when a reader asks for them.

So the first field that does not fit is reported with its line in the file, its column
and its text.
"""

import csv
import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from neurosym_jax.data.reading import METRES, header_in, read_text_file, separator_of
from neurosym_jax.data.tracks import Reading, Tracks, make_tracks
from neurosym_jax.errors import InputError, option, printable

__all__ = ["STEPS", "Table", "absent", "read_table"]

MOST = 1_000_000  # columns of a table
BLANKS = ' "\t\r'  # around a field
UNITS = {"", *METRES, "m/s", "s", "ms", "us", "ns", "deg", "rad", "frame"}
"""Fields of a row of units below the header."""
# Frame numbers that are taken for 0.4 s: of a list of steps, and at 15, 25 and 30 a
# second.
STEPS = (1, 6, 10, 12)


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of R rows whose fields are still text."""

    path: Path
    names: Sequence[str]  # of the C columns; 1, 2, ... without a header
    fields: pl.Series  # [R] lists of C texts
    row: np.ndarray  # [R] lines of the file
    comments: tuple[str, ...] = ()  # before the first row, without #
    facts: Mapping[str, str] = dataclasses.field(
        default_factory=dict
    )  # `fps`, `unit` that it has
    notes: tuple[str, ...] = ()  # how it was read, a line each

    def refuse(self, wrong: ArrayLike, reason: Callable[[int], str]) -> None:
        """Refuse the first row of the mask `wrong` [R], if any; `reason` takes its index.

        Raises:
            InputError: naming file, row and reason.
        """
        if np.any(wrong):
            at = int(np.argmax(wrong))
            raise InputError(f"{self.path}: row {self.row[at]}: {reason(at)}")

    def take(self, rows: np.ndarray) -> "Table":
        """The rows of a mask [R]."""
        return dataclasses.replace(
            self, fields=self.fields.filter(rows), row=self.row[rows]
        )

    def column(self, place: int) -> pl.Series:
        """[R] texts of a column, without blanks and quotes around them."""
        return self.fields.list.get(place).str.strip_chars(BLANKS)

    def words(self, place: int) -> pl.Series:
        """[R] texts of a column in lower-case letters."""
        return self.column(place).str.to_lowercase()

    def numbers(self, *places: int, missing: bool = False) -> np.ndarray:
        """[R, columns] finite float64; if fields may be `missing`, empty ones and nan are NaN."""
        texts = self.fields.list.gather(list(places)).explode().str.strip_chars(BLANKS)
        values = texts.cast(pl.Float64, strict=False)
        usable = values.is_finite().fill_null(False) | (missing & absent(texts))
        wrong = ~usable.to_numpy().reshape(-1, len(places))

        def shown(at: int) -> str:
            column = int(np.argmax(wrong[at]))
            text = str(texts[at * len(places) + column])
            hint = " (use a decimal point)" if "," in text else ""
            return f"{self.names[places[column]][:30]} is not a number: {text[:60]!r}{hint}"

        self.refuse(wrong.any(axis=1), shown)
        values = values.fill_null(np.nan).to_numpy().reshape(wrong.shape)
        return np.where(np.isfinite(values), values, np.nan)

    def whole_numbers(self, place: int) -> np.ndarray:
        """[R] float64 whole numbers of a column."""
        values = self.numbers(place)[:, 0]
        self.refuse(
            (np.abs(values) > 2.0**53) | (values != np.rint(values)),
            lambda at: f"{self.names[place][:30]} {values[at]} is not a whole number",
        )
        return values

    def ids(self, place: int, prefix: str = "") -> np.ndarray:
        """[R] int64 ids without `prefix`: numbers if all are whole, else 0, 1, ... by text.

        Raises: InputError: for a missing id, and two that are one number (1, 1.0) or
            word (P1, p01).
        """
        texts = self.column(place).str.strip_prefix(prefix)
        self.refuse(
            absent(texts).to_numpy(), lambda at: f"the id is missing ({texts[at]!r})"
        )
        unique = texts.unique(maintain_order=True)
        real = unique.cast(pl.Float64, strict=False)
        if ((real.round() == real) & (real.abs() < 2.0**53)).fill_null(False).all():
            number = spelling = real.cast(pl.Int64)
        else:
            number = unique.rank("ordinal").cast(pl.Int64) - 1
            spelling = unique.str.to_lowercase().str.replace_all(
                r"\s|(^|[^\d.])0+(\d)", "$1$2"
            )
        if (twice := spelling.is_duplicated()).any():
            first, second, *_ = unique.filter(spelling == spelling.filter(twice)[0])
            raise InputError(
                f"{self.path}: the ids {first[:40]!r} and {second[:40]!r} are one number or word: "
                "one person or two? Write them alike"
            )
        return texts.replace_strict(unique, number, return_dtype=pl.Int64).to_numpy()

    def extra(self, place: int, texts: bool = True) -> np.ndarray:
        """[R] float64 numbers, else with `texts` 0, 1, ... in order of text; NaN where a field is
        missing or, without, no number."""
        column = self.column(place)
        column = column.set(absent(column), None)
        values = column.cast(pl.Float64, strict=False)
        if texts and values.null_count() > column.null_count():
            values = (column.rank("dense") - 1).cast(pl.Float64)
        return values.fill_null(np.nan).to_numpy()

    def tracks(
        self,
        stamp: np.ndarray,
        id: np.ndarray,
        position: np.ndarray,
        extras: Mapping[str, np.ndarray] = MappingProxyType({}),
        *,
        row: np.ndarray | None = None,
        parts: tuple[Sequence[str], np.ndarray] | None = None,
        warnings: Sequence[str] = (),
        clock: int | None = None,
        columns: Sequence[str] = (),
    ) -> list[Tracks]:
        """The recordings in the lines `row` [R'] of the file (default: all), in any order.

        `stamp`, `id` [R'], `position` [R', 2] and `extras` name: [R'] are those of the
        lines; `parts` has the names of the recordings and [R'] the index of each line's
        (default: one). One more of the `warnings` says where time runs backward.
        `clock` is the column of frame numbers, if there is one; `columns` has
        ROLE=COLUMN of all.
        """
        row, last = self.row if row is None else row, int(np.argmax(np.abs(stamp)))
        rate = None
        if clock is not None and stamp[last]:
            rate = round(float(self.whole_numbers(clock)[last] / stamp[last]), 6)
        names, part = parts or ([printable(self.path.stem)], np.zeros(len(row), int))
        recordings = []
        for number, name in enumerate(names):
            at = np.flatnonzero(part == number)
            order = at[np.argsort(id[at], kind="stable")]
            back = order[1:][(np.diff(stamp[order]) < 0) & (np.diff(id[order]) == 0)]
            lines = list(warnings)
            if len(back):
                first = (
                    f"row {row[back[0]]}: time runs backward for agent {id[back[0]]}"
                )
                lines.append(f"{first} ({len(back)} times in all); the rows are sorted")
            reading = Reading(
                name,
                printable(str(self.path)),
                rows=len(at),
                warnings=tuple(lines),
                notes=self.notes,
                rate=rate,
                columns=tuple(columns),
            )
            points = (
                stamp[at],
                id[at],
                position[at],
                {key: extras[key][at] for key in extras},
            )
            recordings.append(make_tracks(name, *points, reading=reading, row=row[at]))
        return recordings


def absent(texts: pl.Series) -> pl.Series:
    """[R] bool: fields that say that there is no value."""
    words = ("", "nan", "null", "none", "na", "n/a", "<na>", "nat", "?")
    return texts.str.to_lowercase().is_in(words)


def read_table(
    path: Path,
    names: Sequence[str] | None = None,
    header: str = "",
    has_header: bool | None = None,
) -> Table:
    """The table in a file of text, whose lines with # are comments.

    Columns without `names` have those of the header, else 1, 2, ... The header is the
    first line that begins with the regular expression `header`, among the first 200; by
    default the first line, unless it has numbers where others have (or `has_header`
    says).

    Raises:
        InputError: naming file, row and reason.
    """
    lines = (
        pl.Series([read_text_file(path)])
        .str.split("\n")
        .explode()
        .str.strip_chars(" \r")
    )
    is_comment = lines.str.starts_with("#")
    is_row = ((lines != "") & ~is_comment).to_numpy()
    comments = lines.head(int(np.argmax(is_row))).filter(
        is_comment.head(int(np.argmax(is_row)))
    )
    lines, row = lines.filter(is_row), 1 + np.flatnonzero(is_row)
    if len(lines) and re.match(r"<\?xml|<[^<>,;\t]*>$", lines[0]):
        raise InputError(f"{path}: XML is not read: write rows of time, id, x and y")
    starts = lines[:200].str.contains(f"^{header}").arg_true()
    if not len(starts):
        without = f", or no header {header!r}" * bool(header)
        raise InputError(f"{path}: the file has no rows{without}")
    lines, row = lines[starts[0] :], row[starts[0] :]
    mark = separator_of(lines[0])
    if lines[0].count(mark) > MOST:
        raise InputError(f"{path}: row {row[0]}: has more than {MOST} columns")
    if mark == " ":
        lines = lines.str.replace_all(r"\s+", " ")
    notes = ()
    if mark != "," and _are_decimal_commas("\n".join(lines.head(200))):
        lines, notes = (
            lines.str.replace_all(r"([0-9]),([0-9])", "$1.$2"),
            ("decimal commas",),
        )
    if names is None:
        rows = list(_split(path, lines.head(50).str.strip_suffix(mark), mark))
        names = [name.strip() for name in rows[0]]
        if has_header is None:
            rows = [[field.strip(BLANKS) for field in fields] for fields in rows]
            has_header = bool(header) or header_in(rows)
        if has_header:
            lines, row = lines[1:], row[1:]
            units = [field.lower() for field in rows[1]] if len(rows) > 1 else []
            if len(units) == len(names) and METRES.keys() & units and {*units} <= UNITS:
                names = [
                    f"{name} [{unit}]" if unit else name
                    for name, unit in zip(names, units)
                ]
                lines, row = lines[1:], row[1:]
                notes += ("units below the header",)
        else:
            names = [str(place) for place in range(1, len(names) + 1)]
    if not len(lines):
        raise InputError(f"{path}: the file has no rows")
    fields = _split(path, lines, mark)
    if len(fields[0]) == len(names) + 1 and lines[0].endswith(mark):
        names = [*names, ""]  # The rows end in a separator.
    remarks = tuple(comments.str.strip_chars("# ").to_list())
    table = Table(path, names, fields, row, comments=remarks, notes=notes)
    widths = fields.list.len().to_numpy()
    columns = option("columns", ("time=1", "id=2", "x=3", "y=4"))
    hint = f"{option('format')}, or {columns}, says what they are"
    if len(np.unique(widths)) > 2 or widths.max() < 3:
        hint = "this is no table: write rows of time, id, x and y"
    table.refuse(
        widths != len(names),
        lambda at: (
            f"{widths[at]} columns, not {len(names)}: {lines[at][:60]!r} ({hint})"
        ),
    )
    return table


def _are_decimal_commas(text: str) -> bool:
    """Whether commas stand only between digits, and points nowhere there."""
    commas = len(re.findall(r"[0-9],[0-9]", text))
    return bool(
        commas and commas == text.count(",") and not re.search(r"[0-9]\.[0-9]", text)
    )


def _split(path: Path, lines: pl.Series, mark: str) -> pl.Series:
    """[R] lists of the fields of `lines` [R], which may be quoted."""
    if not lines.str.contains('"', literal=True).any():
        return lines.str.split(mark)
    try:
        quoted = list(
            csv.reader(lines, delimiter=mark, skipinitialspace=True, strict=True)
        )
        if len(quoted) < len(lines):
            raise csv.Error("a field goes on in the next line")
    except csv.Error as error:
        raise InputError(f"{path}: wrong quotes ({error})") from None
    return pl.Series(quoted, dtype=pl.List(pl.String))
