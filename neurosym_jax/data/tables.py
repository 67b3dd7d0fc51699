"""Tables: the fields of any file of rows, which become numbers or ids when a reader asks.

Delimited text, JSON, Parquet and Arrow become a `Table` whose fields are kept as text. So the first
field that does not fit is reported with its row, its column and its text.
"""

import csv
import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from neurosym_jax.data.rows import refuse_rows
from neurosym_jax.data.text import Head, read_head, read_pieces, separator_of
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.memory import refuse_beyond_memory

__all__ = ["Table", "lines_of", "read_table", "split_lines"]

MAX_COLUMNS = 1_000_000

TEXTS = pl.List(pl.String)

_MISSING = ("", "nan", "null", "none", "n/a", "<na>", "nat")


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of R rows whose fields are still text."""

    path: Path
    names: Sequence[str]
    """Of the C columns; 1, 2, ... without a header."""
    fields: pl.Series
    """[R] lists of C texts, None where a field is null."""
    row: np.ndarray | None = None
    """[R] numbers of the rows in messages; None for 1, 2, ..."""

    def take(self, rows: np.ndarray) -> Self:
        """Select rows by a mask [R]; messages go on to name them by their numbers in the file."""
        row = np.arange(1, len(self.fields) + 1) if self.row is None else self.row
        return dataclasses.replace(self, fields=self.fields.filter(rows), row=row[rows])

    def refuse(self, wrong: ArrayLike, reason: Callable[[int], str]) -> None:
        """Raise an InputError for the first row of the mask `wrong` [R]; see `refuse_rows`."""
        refuse_rows(self.path, wrong, reason, self.row)

    def column(self, place: int) -> pl.Series:
        """[R] texts of a column, without blanks and quotes around them."""
        return _stripped(self.fields.list.get(place))

    def numbers(self, *places: int, missing: bool = False) -> np.ndarray:
        """[R, columns] float64.

        Args:
            places: of the columns.
            missing: whether fields may be empty, NaN or infinite; empty ones give NaN.

        Raises:
            InputError: for the first row with a field that is not a finite number.
        """
        texts = _stripped(self.fields.list.gather(list(places)).explode())
        found = texts.cast(pl.Float64, strict=False)
        shape = (len(self.fields), len(places))
        bad = found.is_null() & ~_missing(texts) if missing else found.is_null()
        wrong = bad.to_numpy().reshape(shape)

        def shown(at: int) -> str:
            which = int(np.argmax(wrong[at]))
            text = str(texts[at * len(places) + which])
            hint = " (use a decimal point)" if "," in text else ""
            return f"{self.names[places[which]][:30]} is not a number: {text[:60]!r}{hint}"

        self.refuse(wrong.any(axis=1), shown)
        values = found.fill_null(np.nan).to_numpy().reshape(shape)
        if not missing:
            odd = ~np.isfinite(values)
            self.refuse(
                odd.any(axis=1),
                lambda at: f"{self.names[places[int(np.argmax(odd[at]))]][:30]} is not finite",
            )
        return values

    def whole_numbers(self, place: int) -> np.ndarray:
        """[R] float64 whole numbers of a column.

        Raises:
            InputError: as `numbers`, and for a number that is not whole or beyond 2^53.
        """
        values = self.numbers(place)[:, 0]
        large = np.abs(values) > 2.0**53
        self.refuse(
            large | (values != np.rint(values)),
            lambda at: (
                f"{self.names[place][:30]} {values[at]} is "
                f"{'too large' if large[at] else 'not whole'}"
            ),
        )
        return values

    def ids(self, place: int, prefix: str = "") -> np.ndarray:
        """[R] int64 ids: the numbers if all are whole, else 0, 1, ... in order of text.

        Args:
            place: of the column.
            prefix: removed where all ids have it.

        Raises:
            InputError: for a missing id, and where two texts are one number (1, 01, 1.0).
        """
        texts = self.column(place)
        self.refuse(
            _missing(texts).to_numpy(), lambda at: f"the id is missing ({texts[at] or ''!r})"
        )
        texts = texts.str.strip_prefix(prefix) if texts.str.starts_with(prefix).all() else texts
        unique = texts.unique(maintain_order=True)
        real = unique.cast(pl.Float64, strict=False)
        exact = real.is_not_null() & (real.abs() <= 2.0**53) & (real == real.round())
        whole = unique.cast(pl.Int64, strict=False).fill_null(_where(exact, real).cast(pl.Int64))
        if whole.null_count():
            whole = unique.rank("ordinal").cast(pl.Int64) - 1
        elif whole.is_duplicated().any():
            number = whole.filter(whole.is_duplicated())[0]
            first, second, *_ = unique.filter(whole == number)
            raise InputError(
                f"{self.path}: the ids {first[:40]!r} and {second[:40]!r} are one number: one "
                "person or two? Write them alike"
            )
        return texts.replace_strict(unique, whole, return_dtype=pl.Int64).to_numpy()

    def extra(self, place: int) -> np.ndarray:
        """[R] float64 numbers, else 0, 1, ... in order of text; NaN where a field is missing."""
        texts = self.column(place)
        texts = _where(~_missing(texts), texts)
        values = texts.cast(pl.Float64, strict=False)
        if values.null_count() > texts.null_count():
            values = (texts.rank("dense") - 1).cast(pl.Float64)
        return values.fill_null(np.nan).to_numpy()


def read_table(path: Path, names: Sequence[str] | None = None) -> Table:
    """The table in a file.

    Args:
        path: delimited text, JSON with an object a line, Parquet or Arrow; text and JSON may be
            compressed with gzip.
        names: of the columns of delimited numbers that have no header; default: the file says.

    Raises:
        InputError: naming file, row and reason.
    """
    head = read_head(path)
    if names is None and head.columnary:
        return _columnary(path, pl.scan_parquet if head.magic.startswith(b"PAR1") else pl.scan_ipc)
    if names is None and head.first.startswith(("{", "[")):
        from neurosym_jax.data.json_rows import read_json_table

        names, rows = read_json_table(path)
        return Table(path, names, pl.Series(rows, dtype=TEXTS))
    return _delimited(path, head, names)


def _delimited(path: Path, head: Head, names: Sequence[str] | None) -> Table:
    """Rows separated by commas, semicolons or tabs, else by blanks."""
    header = names is None and not head.columns
    mark = separator_of(head.first)
    if header:
        mark = max(",;\t", key=head.first.count)
    mark = mark if mark and mark in head.first else " "
    if head.first.count(mark) >= MAX_COLUMNS:
        raise InputError(f"{path}: more than {MAX_COLUMNS:,} columns")
    parts: list[pl.Series] = []
    above = 0
    for piece in read_pieces(path):
        lines = lines_of(piece.replace("\t", " ") if mark == " " else piece)
        if not header and "#" in piece:
            lines = lines.str.replace(r"#.*$", "")
        if not header or mark == " ":
            lines = lines.str.strip_chars().str.strip_suffix(mark)
        lines = lines.filter((lines.str.strip_chars() != "") & ~lines.str.starts_with("#"))
        if mark == " " and lines.str.contains("  ", literal=True).any():
            lines = lines.str.replace_all(r" {2,}", " ")
        if names is None and len(lines):
            own = split_lines(path, lines[:1], mark)[0].to_list()
            names = [name.strip() if header else str(at) for at, name in enumerate(own, 1)]
            lines = lines[int(header) :]
        if names is not None and len(lines):
            row = np.arange(above + 1, above + 1 + len(lines))
            parts.append(split_lines(path, lines, mark, len(names), row))
            above += len(lines)
    if names is None or not parts:
        raise InputError(f"{path}: the file has no rows")
    return Table(path, names, pl.concat(parts))


def lines_of(piece: str) -> pl.Series:
    """The lines of a text."""
    return pl.Series([piece]).str.split("\n").explode()


def split_lines(
    path: Path,
    lines: pl.Series,
    mark: str,
    width: int | None = None,
    row: np.ndarray | None = None,
) -> pl.Series:
    """Lists of the fields of `lines` [R].

    Args:
        path: for messages.
        lines: texts.
        mark: what separates the fields, which may be quoted.
        width: fields of every line; None accepts any number.
        row: [R] numbers of the lines in messages.

    Raises:
        InputError: for a line with more or fewer fields, or wrong quotes.
    """
    if lines.str.contains('"', literal=True).any():
        fields = pl.Series(_unquoted(path, lines.to_list(), mark, row), dtype=TEXTS)
    else:
        fields = lines.str.split(mark)
    if width is not None:
        found = fields.list.len()

        def counted(at: int) -> str:
            hint = " (--format, or --columns time=1 id=2 x=3 y=4, says what they are)"
            says = hint if row is not None and row[at] == 1 else ""
            return f"{found[at]} columns, not {width}{says}: {lines[at][:60]!r}"

        refuse_rows(path, (found != width).to_numpy(), counted, row)
    return fields


def _unquoted(path: Path, lines: list[str], mark: str, row: np.ndarray | None) -> list[list[str]]:
    rows = csv.reader(lines, delimiter=mark, skipinitialspace=True, strict=True)
    found: list[list[str]] = []
    try:
        for fields in rows:
            found.append(fields)
            if rows.line_num != len(found):
                raise csv.Error("a quoted field goes on in the next line")
    except csv.Error as error:
        at = max(len(found) - 1, 0)
        raise InputError(f"{path}: row {at + 1 if row is None else row[at]}: {error}") from None
    return found


def _columnary(path: Path, scan_file: Callable[[Path], pl.LazyFrame]) -> Table:
    """A Parquet or Arrow file; columns of lists and structs are left out."""
    try:
        scan = scan_file(path)
        names = [name for name, kind in scan.collect_schema().items() if not kind.is_nested()]
        rows = scan.select(pl.len()).collect().item()
        refuse_beyond_memory(f"{path}: reading it", 64.0 * rows * len(names), "split it")
        texts = scan.select(pl.concat_list(pl.col(names).cast(pl.String)).alias("fields"))
        return Table(path, names, texts.collect()["fields"])
    except (OSError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        reason = str(error).partition("\n")[0][:80]
        raise InputError(f"{path}: cannot be read ({reason})") from None


def _stripped(texts: pl.Series) -> pl.Series:
    return texts.str.strip_chars(' "\t\r')


def _missing(texts: pl.Series) -> pl.Series:
    return texts.fill_null("").str.to_lowercase().is_in(_MISSING)


def _where(mask: pl.Series, values: pl.Series) -> pl.Series:
    """`values` where the mask is True, else null."""
    return pl.select(pl.when(mask).then(values)).to_series()
