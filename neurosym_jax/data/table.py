"""Tables: the fields of a file of rows, which become numbers or ids when a reader asks for them.

So the first field that does not fit is reported with its line in the file, its column and its text.
"""

import csv
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import ArrayLike

from neurosym_jax.data.reading import ReadOptions, numbers_in, read_text_file, separator_of
from neurosym_jax.data.tracks import Reading, Tracks, common, make_tracks
from neurosym_jax.errors import InputError, printable

__all__ = ["FRAME", "Table", "is_frame", "read_table"]

FRAME = Path("dataframe")  # what messages call one, and its recording

MOST = 1_000_000  # columns of a table
BLANKS = ' "\t\r'  # around a field
# Frame numbers that are taken for 0.4 s: of a list of steps, and at 15, 25 and 30 a second.
STEPS = (1, 6, 10, 12)


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of R rows whose fields are still text."""

    path: Path
    names: Sequence[str]  # of the C columns; 1, 2, ... without a header
    fields: pl.Series  # [R] lists of C texts
    row: np.ndarray  # [R] lines of the file

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
        return dataclasses.replace(self, fields=self.fields.filter(rows), row=self.row[rows])

    def column(self, place: int) -> pl.Series:
        """[R] texts of a column, without blanks and quotes around them."""
        return self.fields.list.get(place).str.strip_chars(BLANKS)

    def numbers(self, *places: int, missing: bool = False) -> np.ndarray:
        """[R, columns] finite float64; if fields may be `missing`, empty ones and nan are NaN."""
        texts = self.fields.list.gather(list(places)).explode().str.strip_chars(BLANKS)
        found = texts.cast(pl.Float64, strict=False)
        usable = found.is_finite().fill_null(False) | (missing & _missing(texts))
        wrong = ~usable.to_numpy().reshape(-1, len(places))

        def shown(at: int) -> str:
            which = int(np.argmax(wrong[at]))
            text = str(texts[at * len(places) + which])
            hint = " (use a decimal point)" if "," in text else ""
            return f"{self.names[places[which]][:30]} is not a number: {text[:60]!r}{hint}"

        self.refuse(wrong.any(axis=1), shown)
        return found.fill_null(np.nan).to_numpy().reshape(wrong.shape)

    def whole_numbers(self, place: int) -> np.ndarray:
        """[R] float64 whole numbers of a column."""
        values = self.numbers(place)[:, 0]
        self.refuse(
            (np.abs(values) > 2.0**53) | (values != np.rint(values)),
            lambda at: f"{self.names[place][:30]} {values[at]} is not a whole number",
        )
        return values

    def times(
        self,
        place: int,
        ids: np.ndarray,
        options: ReadOptions,
        period: float,
        any_step: bool = False,
    ) -> np.ndarray:
        """[R] seconds of frame numbers. The most common step of people, `ids` [R], is `period`
        unless `options` say.

        Raises:
            InputError: for a frame that is not a whole number, and where that step is unusual.
        """
        frame, stride = self.whole_numbers(place), options.fps and options.fps * period
        if options.eth_stride and self.path.stem.startswith("biwi_eth"):
            stride = options.eth_stride
        if stride is None:
            order = np.lexsort((frame, ids))
            steps = np.diff(frame[order])[(np.diff(ids[order]) == 0) & (np.diff(frame[order]) > 0)]
            steps = steps if len(steps) else np.diff(np.unique(frame))
            stride = common(steps) if len(steps) else 1.0
            if not any_step and stride not in STEPS:
                raise InputError(
                    f"{self.path}: its frames are {stride:g} apart, at 25 a second "
                    f"{stride / 25:.2f} s: say how many make a second (--fps 25)"
                )
        return frame / stride * period

    def ids(self, place: int, prefix: str = "") -> np.ndarray:
        """[R] int64 ids without `prefix`: numbers if all are whole, else 0, 1, ... by text.

        Raises:
            InputError: for a missing id, and two that are one number (1, 1.0) or word (P1, p01).
        """
        texts = self.column(place).str.strip_prefix(prefix)
        self.refuse(_missing(texts).to_numpy(), lambda at: f"the id is missing ({texts[at]!r})")
        unique = texts.unique(maintain_order=True)
        real = unique.cast(pl.Float64, strict=False)
        if ((real.round() == real) & (real.abs() < 2.0**53)).fill_null(False).all():
            number = alike = real.cast(pl.Int64)
        else:
            number = unique.rank("ordinal").cast(pl.Int64) - 1
            alike = unique.str.to_lowercase().str.replace_all(r"\s|(^|[^\d.])0+(\d)", "$1$2")
        if (twice := alike.is_duplicated()).any():
            first, second, *_ = unique.filter(alike == alike.filter(twice)[0])
            raise InputError(
                f"{self.path}: the ids {first[:40]!r} and {second[:40]!r} are one number or word: "
                "one person or two? Write them alike"
            )
        return texts.replace_strict(unique, number, return_dtype=pl.Int64).to_numpy()

    def extra(self, place: int) -> np.ndarray:
        """[R] float64 numbers, else 0, 1, ... in order of text; NaN where a field is missing."""
        texts = self.column(place)
        texts = texts.set(_missing(texts), None)
        values = texts.cast(pl.Float64, strict=False)
        if values.null_count() > texts.null_count():
            values = (texts.rank("dense") - 1).cast(pl.Float64)
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
        said: Sequence[str] = (),
        clock: int | None = None,
    ) -> list[Tracks]:
        """The recordings in the lines `row` [R'] of the file (default: all), in any order.

        `stamp`, `id` [R'], `position` [R', 2] and `extras` name: [R'] are those of the lines;
        `parts` has the names of the recordings and [R'] the index of each line's (default: one).
        Warnings are those `said`, and one where time runs backward. `clock` is the column of frame
        numbers, where there is one.
        """
        row, last = self.row if row is None else row, int(np.argmax(np.abs(stamp)))
        rate = None
        if clock is not None and stamp[last]:
            rate = round(float(self.whole_numbers(clock)[last] / stamp[last]), 6)
        names, part = parts or ([printable(self.path.stem)], np.zeros(len(row), int))
        found = []
        for number, name in enumerate(names):
            at = np.flatnonzero(part == number)
            order = at[np.argsort(id[at], kind="stable")]
            back = order[1:][(np.diff(stamp[order]) < 0) & (np.diff(id[order]) == 0)]
            lines = list(said)
            if len(back):
                first = f"row {row[back[0]]}: time runs backward for agent {id[back[0]]}"
                lines.append(f"{first} ({len(back)} times in all); the rows are sorted")
            how = Reading(
                name, printable(str(self.path)), rows=len(at), warnings=tuple(lines), rate=rate
            )
            columns = stamp[at], id[at], position[at], {key: extras[key][at] for key in extras}
            found.append(make_tracks(name, *columns, reading=how, row=row[at]))
        return found


def _missing(texts: pl.Series) -> pl.Series:
    return texts.str.to_lowercase().is_in(("", "nan", "null", "none", "n/a", "<na>", "nat"))


def is_frame(data: object) -> bool:
    """Whether `data` is a dataframe of pandas or polars; neither is imported."""
    return hasattr(data, "columns") and (hasattr(data, "itertuples") or hasattr(data, "iter_rows"))


def read_table(path: Any, names: Sequence[str] | None = None, header: str = "") -> Table:
    """The table in a dataframe (rows from 0) or a file of text, whose lines with # are left out.

    Columns without `names` have those of the header, else 1, 2, ... The header is the first line
    that begins with the regular expression `header`, among the first 200.

    Raises:
        InputError: naming file, row and reason.
    """
    if is_frame(path):
        polars = hasattr(path, "iter_rows")
        rows = path.iter_rows() if polars else path.itertuples(index=False, name=None)
        fields = pl.Series([list(map(str, row)) for row in rows], dtype=pl.List(pl.String))
        if not len(fields):
            raise InputError(f"{FRAME}: has no rows")
        return Table(FRAME, list(map(str, path.columns)), fields, np.arange(len(fields)))
    lines = pl.Series([read_text_file(path)]).str.split("\n").explode().str.strip_chars(" \r")
    kept = ((lines != "") & ~lines.str.starts_with("#")).to_numpy()
    lines, row = lines.filter(kept), 1 + np.flatnonzero(kept)
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
    if names is None:
        names = [name.strip() for name in _split(path, lines[:1].str.strip_suffix(mark), mark)[0]]
        if numbers_in(lines[0]):
            names = [str(place) for place in range(1, len(names) + 1)]
        else:
            lines, row = lines[1:], row[1:]
    if not len(lines):
        raise InputError(f"{path}: the file has no rows")
    fields = _split(path, lines, mark)
    if len(fields[0]) == len(names) + 1 and lines[0].endswith(mark):
        names = [*names, ""]  # The rows end in a separator.
    table = Table(path, names, fields, row)
    found = fields.list.len().to_numpy()
    table.refuse(
        found != len(names),
        lambda at: (
            f"{found[at]} columns, not {len(names)}: {lines[at][:60]!r} (--format, or --columns "
            "time=1 id=2 x=3 y=4, says what they are)"
        ),
    )
    return table


def _split(path: Path, lines: pl.Series, mark: str) -> pl.Series:
    """[R] lists of the fields of `lines` [R], which may be quoted."""
    if not lines.str.contains('"', literal=True).any():
        return lines.str.split(mark)
    try:
        quoted = list(csv.reader(lines, delimiter=mark, skipinitialspace=True, strict=True))
        if len(quoted) < len(lines):
            raise csv.Error("a field goes on in the next line")
    except csv.Error as error:
        raise InputError(f"{path}: wrong quotes ({error})") from None
    return pl.Series(quoted, dtype=pl.List(pl.String))
