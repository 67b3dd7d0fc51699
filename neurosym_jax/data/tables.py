"""Files to tables: the options of reading, the head of a file, the table of formats, a
table of text columns, and what words in the names of columns mean.
"""

import abc
import codecs
import contextlib
import csv
import dataclasses
import functools
import gzip
import itertools
import math
import re
import stat
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.configuration import NotNegative, Positive, refuse
from neurosym_jax.data.tracks import Reading, Tracks, make_tracks
from neurosym_jax.errors import InputError, brief, option, printable
from neurosym_jax.plugins import Registry
from neurosym_jax.runtime.foreign import TIMES, UNPACKED

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "AS_IT_SAYS",
    "BOX",
    "CLOCKS",
    "DEGREES",
    "FLAGS",
    "FORMATS",
    "GUARDS",
    "POINT",
    "ROLES",
    "SCALED",
    "SIGNATURES",
    "STEPS",
    "Format",
    "Head",
    "Question",
    "ReadOptions",
    "Table",
    "Unsaid",
    "absent",
    "has_position",
    "metres_in",
    "names_in_comments",
    "names_tracks",
    "plain_name",
    "read_head",
    "read_table",
    "read_text_file",
    "register_format",
    "role_of",
    "vocabulary",
]

# How files are read: what a user says of them, how they begin, and what a format is.

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001}  # in each unit
GUARDS = {
    # what a recording may be refused for: in words
    "slow": "people move more slowly than people walk",
    "fast": "people move faster than people walk",
    "held": "positions stay and then leap",
    "ends": "people stay where their tracks begin or end",
    "origins": "people begin at one place",
    "together": "people begin at one moment",
    "twins": "two people are at one place",
    "clock": "two columns, options or files disagree about the clock",
    "scale": "two columns, options or files disagree about the unit",
    "seen": "a model is validated or tested on what it learns from",
}


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """What files do not say themselves. An option that a format does not use is refused."""

    format: str | None = None
    """Format of the files, NAME or NAME,OPTION=VALUE,...; default: detected from the content."""
    columns: tuple[str, ...] = ()
    """Columns of a table by name, or by number from 1: time=t (or frame=3) id=who x=px y=py; boxes
    left top right bottom (or width height), of which the middle of the lower edge is read, or x y
    width height, of whose middle they are; lost, valid, state, confidence, which say what is no
    position; label; vx vy. ROLE=none: no column is that. Any other NAME=column is kept as an extra
    of each agent, as group=g. header=no: the first row is data."""
    unit: str | None = None
    """Unit of the coordinates, where the file does not say it: m (default), cm, mm, or metres as
    a number, such as 0.032 for pixels of 3.2 cm; or one of each recording, gates=0.03,quad=0.04."""
    homography: str | None = None
    """File of 3 x 3 numbers that turn coordinates of a picture (column, row, 1) into metres; with
    FILE,row-column those of (row, column, 1)."""
    flip_y: bool = False
    """Turn y round: for coordinates whose y points down, so that left is counter-clockwise."""
    time_unit: Literal["s", "ms", "us", "ns"] | None = None
    """Unit of a table's times; default: seconds."""
    keep: tuple[str, ...] = ()
    """Kinds of rows that are people, where a table's column label, class, type, category, ... says
    what each row is; default: person, pedestrian, human, adult, ...; others are left out."""
    fps: float | str | None = None
    """Frames per second, where frames are numbered; default: their most common step is 0.4 s. Or
    those of each recording, gates=10,quad=25."""
    eth_stride: float | None = None
    """Frames per 0.4 s of files called biwi_eth* only: 6 gives the true time of SGAN's eth, whose
    frames are 10 apart in a video of 15 frames per second. Published numbers use the wrong one."""
    missing: float | None = None
    """Coordinate of rows without a position, such as -9999; it is found where people share it."""
    max_gap: float = 1.0
    """Longest gap in a person's track that is filled by interpolation, seconds."""
    allow: tuple[str, ...] = ()
    """Guards to waive by the names that refusals say, such as slow or held; each becomes a
    warning."""

    def __post_init__(self):
        """Check the numbers, the unit and the guards.

        Raises:
            InputError: naming the option.
        """
        refuse(Positive, {option("eth_stride"): self.eth_stride}, optional=True)
        for rate in _by_recording(self.fps).values():
            if not 0 < _number(rate) < math.inf:
                raise InputError(f"{option('fps')} must be positive, not {rate}")
        refuse(NotNegative, {option("max_gap"): self.max_gap}, optional=True)
        for name in self.allow:
            if name not in GUARDS:
                raise InputError(
                    f"{option('allow')} is one of {', '.join(GUARDS)}, not {name!r}"
                )
        for unit in _by_recording(self.unit).values():
            if not 1e-6 <= (METRES.get(unit) or _number(unit)) <= 1e4:
                raise InputError(
                    f"{option('unit')} is one of {', '.join(METRES)}, or metres as a number, not "
                    f"{unit!r} (pixels of 3.2 cm: {option('unit', '0.032')})"
                )

    def unit_of(self, recording: str) -> str:
        """The unit that was given for a file's recordings, by the file's name without ending; else
        nothing."""
        return _value_of(self.unit, recording)

    def fps_of(self, recording: str) -> float:
        """The frames per second that were given for a file's recordings, as `unit_of`; else 0."""
        return float(_value_of(self.fps, recording) or 0)

    def allowed(self, guard: str, line: str) -> str:
        """The warning of a guard that is waived.

        Raises:
            InputError: with `line`, where it is not.
        """
        if guard not in self.allow:
            waive = option("allow", (guard,))
            raise InputError(f"{line} (to read it all the same: {waive})")
        return f"allowed {guard}: {line}"


def _by_recording(value: str | float | None) -> dict[str, str]:
    """The values in `VALUE` or `RECORDING=VALUE,...` by recording; "" has that of all others."""
    if value is None:
        return {}
    values = {}
    for part in str(value).split(","):
        recording, _, text = part.rpartition("=")
        values[recording] = text
    return values


def _value_of(value: str | float | None, recording: str) -> str:
    """The value of a recording, else nothing."""
    values = _by_recording(value)
    return values.get(recording) or values.get("", "")


def _number(text: str) -> float:
    """The number that a text is; else NaN."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def metres_in(unit: str) -> float:
    """Metres in a unit of coordinates."""
    return METRES.get(unit) or float(unit)


class Unsaid(InputError):
    """A fact is missing that a file does not say and an option gives."""


class Question(InputError):
    """Columns have more than one meaning, or none that is known; `answers` are tried before they
    are printed."""

    def __init__(self, text: str, answers: Mapping[tuple[str, ...], str]):
        """Ask `text`; each of the `answers` is a value of `columns` and the case it is for."""
        super().__init__(text)
        self.answers = answers


AS_IT_SAYS = ReadOptions()  # everything is taken from the files


@dataclasses.dataclass(frozen=True)
class Head:
    """How a file begins; formats are recognised by it."""

    lines: list[str]
    """Its first 64 kB without blank lines and comments; one empty line if not text."""
    magic: bytes = b""  # its first 16 bytes
    comments: tuple[str, ...] = ()  # lines with #, without that

    @functools.cached_property
    def table(self) -> "Table":
        """The table of its first lines, which may differ in width; one column of them if it is none."""
        import polars as pl

        lines = pl.Series(self.lines[:FIRST])
        with contextlib.suppress(InputError):
            return _table_in(Path(), lines, np.arange(len(lines)), self.comments)
        return Table(Path(), ["line"], lines.str.split("\n"), np.arange(len(lines)))

    @property
    def names(self) -> Sequence[str]:
        """The names in a header; none if the file begins otherwise."""
        return self.table.names if self.table.has_names else []

    @functools.cached_property
    def rows(self) -> np.ndarray:
        """[R, columns] numbers of the first rows, up to one of another width; NaN where a field is
        none."""
        import polars as pl

        width = len(self.table.names)
        is_row = (self.table.fields.list.len() == width).to_numpy() & (width > 0)
        count = int(np.argmin(np.append(is_row, False)))
        texts = self.table.fields.head(count).explode().str.strip_chars(BLANKS)
        values = texts.cast(pl.Float64, strict=False).fill_null(math.nan)
        rows = values.to_numpy().reshape(count, width)
        ends_in_separator = width > 0 and not self.table.names[-1]
        return rows[:, :-1] if ends_in_separator else rows


def header_in(rows: Sequence[Sequence[str]]) -> bool:
    """Whether the first of some rows of fields has names: no number where others have numbers.

    Names stand in no column of text, so a text beside numbers is data.
    """
    first, *others = rows
    columns = range(len(first))
    numeric = []
    for at in columns:
        count = sum(at < len(row) and _is_number(row[at]) for row in others)
        if 2 * count > len(others):
            numeric.append(at)
    return not any(_is_number(first[at]) for at in numeric or columns) and any(first)


def _is_number(field: str) -> bool:
    return _NUMBER.fullmatch(field) is not None


_NUMBER = re.compile(
    r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE
)


SCALED = frozenset({"unit", "flip_y"})
"""Options by which positions of any format become metres whose y points up."""


@dataclasses.dataclass(frozen=True)
class Format(abc.ABC):
    """A format of files. A subclass with these attributes and methods is registered by name; its
    fields, if any, are options that only this format has."""

    title: ClassVar[str] = ""  # what messages call it
    uses: ClassVar[frozenset[str] | None] = None
    """The fields of `ReadOptions` that `read` uses; None for `SCALED`, which are applied to the
    positions that it returns."""

    def knows(self, head: Head) -> bool:
        """Whether a file that begins so is of this format."""
        return False

    def owns(self, path: Path) -> bool:
        """Whether a path is of this format by its name alone; it may be a folder."""
        return False

    @abc.abstractmethod
    def read(self, path: Path, options: ReadOptions, period: float) -> list[Tracks]:
        """The recordings in a file; where frames are numbered, one step is `period` seconds."""

    def in_metres(
        self, path: Path, options: ReadOptions, period: float
    ) -> list[Tracks]:
        """What `read` returns, scaled as `options` say unless `read` does that itself."""
        recordings = self.read(path, options, period)
        if self.uses is not None:
            return recordings
        scale = metres_in(options.unit_of(path.stem) or "m")
        factors = np.array([scale, -scale if options.flip_y else scale])
        return [
            dataclasses.replace(tracks, position=tracks.position * factors)
            for tracks in recordings
        ]


_READERS = "neurosym_jax.data.readers"
FORMATS: Registry[type[Format]] = Registry(
    "format",
    modules={
        "text": f"{_READERS}.columns:Text",
        "columns": f"{_READERS}.columns:Columns",
        "obsmat": f"{_READERS}.columns:Obsmat",
        "stanford": f"{_READERS}.columns:Stanford",
        "mot": f"{_READERS}.columns:Mot",
        "mot_results": f"{_READERS}.columns:MotResults",
        "qtm": f"{_READERS}.thor:Qtm",
        "tracklets": f"{_READERS}.thor:Tracklets",
        "cliff": f"{_READERS}.columns:Cliff",
        "storage": f"{_READERS}.storage:Storage",
        "json": f"{_READERS}.storage:Json",
        "trajnet": f"{_READERS}.trajnet:Trajnet",
    },
)
"""The last is asked first whether it knows a file; `columns` takes what no format knows."""
SIGNATURES = {
    "qtm": r"^Frame[\t,].*Helmet",
    "tracklets": r"tracklet_id",
    "storage": r"^MATLAB|[^\t\r\n -~]",  # bytes that are no plain letters
    "json": r"^\s*[{\[]",
    "trajnet": r"^\{\s*\"(track|scene)\"",
}
"""What stands in the first bytes or lines of a file of some formats: others are not imported for
it."""

register_format = FORMATS.register
"""Decorate a class of `Format` with its name."""


def read_text_file(path: Path) -> str:
    """The text of a file in UTF-8, UTF-16 or Windows-1252, without byte-order mark.

    Raises:
        InputError: if the file cannot be read or is not text.
    """
    text = _text_in(_bytes_of(path))
    if text is None:
        raise InputError(f"{path}: no text, and of no other format that is read here")
    return text


def _text_in(content: bytes) -> str | None:
    """The text in a file, or in its beginning; None if it is none."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return codecs.getincrementaldecoder("utf-16")().decode(content)
    try:
        return codecs.getincrementaldecoder("utf-8-sig")().decode(content)
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    # Others would be letters of other languages, or no text at all.
    is_text = all(
        letter.isprintable() or letter in "\t\r\n" for letter in text[:10_000]
    )
    return text if is_text and "\ufffd" not in text else None


def _bytes_of(path: Path, size: int = -1) -> bytes:
    """The first `size` bytes of a regular file."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):  # Opening a pipe would block.
            raise InputError(f"{path}: is a folder, pipe or device, not a file")
        with path.open("rb") as file:
            if file.read(2) == b"\x1f\x8b":
                return _unpacked(path, size)
            file.seek(0)
            return file.read(size)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(
            f"{path}: cannot be read ({getattr(error, 'strerror', 0) or error})"
        ) from None


def _unpacked(path: Path, size: int) -> bytes:
    """The first `size` bytes of a file packed by gzip, which must not be a bomb."""
    limit = max(UNPACKED, TIMES * path.stat().st_size)
    with gzip.open(path) as file:
        content = file.read(limit + 1 if size < 0 else size)
    if len(content) > limit:
        raise InputError(
            f"{path}: unpacks to more than {limit / 1e6:.0f} MB, the most of a file of its size"
        )
    return content


def read_head(path: Path) -> Head:
    """How the file at `path` begins."""
    content = _bytes_of(path, HEAD)
    text = _text_in(content) or ""  # The reader explains it; here it fits no format.
    lines, _, comments = _lines_in(text)
    if len(content) == HEAD and len(lines) > 1:
        lines = lines[:-1]  # It is cut.
    return Head(lines.to_list() or [""], content[:16], comments)


def separator_of(line: str) -> str:
    """What separates the fields of a line: semicolons, tabs or commas, else blanks."""
    mark = max(";,\t", key=line.count)
    if mark == ",":
        for other in ";\t":
            if line.count(other) > 1:
                return other  # The commas are decimal.
    return mark if mark in line else " "


# Tables: the fields of a file of rows, which become numbers or ids when a reader asks
# for them.
#
# So the first field that does not fit is reported with its line in the file, its column
# and its text.

FIRST = 50  # lines that say how a table is divided, and what a file is
HEAD = 1 << 16  # bytes of a file's beginning
MOST = 1_000_000  # columns of a table
BLANKS = ' "\t\r'  # around a field
UNITS = {"", *METRES, "m/s", "s", "sec", "ms", "us", "ns", "deg", "rad", "frame"}
"""Fields of a row of units below the header."""
# Frame numbers that are taken for 0.4 s: of a list of steps, and at 15, 25 and 30 a
# second.
STEPS = (1, 6, 10, 12)


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of R rows whose fields are still text."""

    path: Path
    names: Sequence[str]  # of the C columns; 1, 2, ... without a header
    fields: "pl.Series"  # [R] lists of C texts
    row: np.ndarray  # [R] lines of the file
    comments: tuple[str, ...] = ()  # before the first row, without #
    facts: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """`fps` and `unit` that it has."""
    notes: tuple[str, ...] = ()  # how it was read, a line each
    warnings: tuple[str, ...] = ()  # what looks wrong in it, a line each
    left_out: tuple[str, ...] = ()  # rows that were left out, and why, a line each

    @property
    def has_names(self) -> bool:
        """Whether its columns have other names than 1, 2, ..."""
        names = [name for name in self.names if name]
        return names != [str(at + 1) for at in range(len(names))]

    def noted(self, line: str) -> "Table":
        """The table with one more of the notes."""
        return dataclasses.replace(self, notes=(*self.notes, line))

    def warned(self, line: str) -> "Table":
        """The table with one more of the warnings."""
        return dataclasses.replace(self, warnings=(*self.warnings, line))

    def refuse(self, wrong: ArrayLike, reason: Callable[[int], str]) -> None:
        """Refuse the first row of the mask `wrong` [R], if any; `reason` takes its index.

        Raises:
            InputError: naming file, row and reason.
        """
        if np.any(wrong):
            at = int(np.argmax(wrong))
            raise InputError(f"row {self.row[at]}: {reason(at)}")

    def take(self, rows: np.ndarray, others: str = "") -> "Table":
        """The rows of a mask [R], or of indices; what the `others` are, which is said with their
        number."""
        index = np.arange(len(self.row))[rows]
        left_out = self.left_out
        if others and len(index) < len(self.row):
            left_out += (f"{len(self.row) - len(index)} rows {others}",)
        return dataclasses.replace(
            self, fields=self.fields[index], row=self.row[index], left_out=left_out
        )

    def with_column(self, name: str, texts: "pl.Series") -> "Table":
        """The table with one more column, [R] texts."""
        fields = self.fields.list.concat(texts)
        return dataclasses.replace(self, names=[*self.names, name], fields=fields)

    def column(self, place: int) -> "pl.Series":
        """[R] texts of a column, without blanks and quotes around them."""
        return self.fields.list.get(place).str.strip_chars(BLANKS)

    def words(self, place: int) -> "pl.Series":
        """[R] texts of a column in lower-case letters."""
        return self.column(place).str.to_lowercase()

    def numbers(self, *places: int, missing: bool = False) -> np.ndarray:
        """[R, columns] finite float64; if fields may be `missing`, empty ones and nan are NaN."""
        import polars as pl

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
        name = self.names[place][:30]
        self.refuse(
            (np.abs(values) > 2.0**53) | (values != np.rint(values)),
            lambda at: (
                f"{name} {values[at]} is not a whole number (if the column is no {name}, "
                f"{option('columns')} says what the columns are)"
            ),
        )
        return values

    def ids(self, place: int, prefix: str = "") -> tuple[np.ndarray, tuple[str, ...]]:
        """[R] int64 ids without `prefix`, and the texts of 0, 1, ... if they are no numbers.

        Raises:
            InputError: for a missing id, and two that are one number (1, 1.0) or word
                (P1, p01).
        """
        import polars as pl

        texts = self.column(place).str.strip_prefix(prefix)
        self.refuse(
            absent(texts).to_numpy(), lambda at: f"the id is missing ({texts[at]!r})"
        )
        unique = texts.unique(maintain_order=True)
        real = unique.cast(pl.Float64, strict=False)
        if ((real.round() == real) & (real.abs() < 2.0**53)).fill_null(False).all():
            number = spelling = real.cast(pl.Int64)
            names = ()
        else:
            names = tuple(unique.sort().to_list())
            number = unique.rank("ordinal").cast(pl.Int64) - 1
            spelling = unique.str.to_lowercase().str.replace_all(
                r"\s|(^|[^\d.])0+(\d)", "$1$2"
            )
        is_twice = spelling.is_duplicated()
        if is_twice.any():
            first, second, *_ = unique.filter(spelling == spelling.filter(is_twice)[0])
            raise InputError(
                f"the ids {first[:40]!r} and {second[:40]!r} are one number or word: "
                "one person or two? Write them alike"
            )
        ids = texts.replace_strict(unique, number, return_dtype=pl.Int64).to_numpy()
        return ids, names

    def extra(self, place: int, texts: bool = True) -> np.ndarray:
        """[R] float64 numbers, else with `texts` 0, 1, ... in order of text; NaN where a field is
        missing or, without, no number."""
        import polars as pl

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
        parts: tuple[Sequence[str], np.ndarray] | None = None,
        frame: np.ndarray | None = None,
        columns: Sequence[str] = (),
        unused: Sequence[str] = (),
        people: Sequence[str] = (),
    ) -> list[Tracks]:
        """The recordings in its rows, which may be in any order.

        `stamp`, `id` [R], `position` [R, 2] and `extras` name: [R] are those of the rows;
        `parts` has the names of the recordings and [R] the index of each row's (default:
        one). Rows that stand twice count once. `frame` [R] are the numbers of frames, if
        there are any; `columns` has ROLE=COLUMN of all, `unused` the others. `people` are
        the texts of ids.
        """
        person = np.array(people)[id] if people else id
        rate = None
        last = int(np.argmax(np.abs(stamp)))
        if frame is not None and stamp[last]:
            rate = round(float(frame[last] / stamp[last]), 6)
        names, part = parts or ([printable(self.path.stem)], np.zeros(len(stamp), int))
        is_first, is_back = _order_of(part, id, stamp, position, self.row)
        recordings = []
        for number, name in enumerate(names):
            is_here = part == number
            table = self._told(is_here & ~is_first, is_here & is_back, person)
            at = np.flatnonzero(is_here & is_first)
            reading = Reading(
                name,
                printable(str(self.path)),
                rows=len(at),
                left_out=table.left_out,
                warnings=table.warnings,
                notes=self.notes,
                rate=rate,
                columns=tuple(columns),
                unused=tuple(unused),
            )
            points = stamp[at], person[at], position[at]
            others = {key: values[at] for key, values in extras.items()}
            tracks = make_tracks(
                name, *points, others, reading=reading, row=self.row[at]
            )
            recordings.append(tracks)
        return recordings

    def _told(
        self, repeats: np.ndarray, back: np.ndarray, person: np.ndarray
    ) -> "Table":
        """The table with warnings of all that is left out, and of the rows of two masks [R]: those
        that stand twice, and those before which time runs on."""
        left_out = self.left_out
        if repeats.any():
            left_out += (f"{repeats.sum()} rows that stand twice",)
        warnings = tuple(f"{line} are left out" for line in left_out) + self.warnings
        if back.any():
            at = back.argmax()
            warnings += (
                f"row {self.row[at]}: time runs backward for agent {person[at]} ({back.sum()} times "
                "in all); the rows are sorted",
            )
        return dataclasses.replace(self, left_out=left_out, warnings=warnings)


def _order_of(
    part: np.ndarray,
    id: np.ndarray,
    stamp: np.ndarray,
    position: np.ndarray,
    row: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """[R] bool: rows that repeat none before them, and of these the ones that are earlier than the
    row of the same person before them in the file."""
    import polars as pl

    x, y = position.T
    points = pl.DataFrame({"part": part, "id": id, "stamp": stamp, "x": x, "y": y})
    is_first = points.select(pl.struct(pl.all()).is_first_distinct()).to_series()
    points = points.with_columns(row=row)
    step = pl.col("stamp").diff().over("part", "id", order_by="row")
    steps = points.filter(is_first).select(step).to_series()
    is_back = np.zeros(len(part), bool)
    is_back[is_first] = steps.fill_null(0.0).to_numpy() < 0
    return is_first.to_numpy(), is_back


def absent(texts: "pl.Series") -> "pl.Series":
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
    lines, row, comments = _lines_in(read_text_file(path))
    if len(lines) and re.match(r"<\?xml|<[^<>,;\t]*>$", lines[0]):
        raise InputError("XML is not read: write rows of time, id, x and y")
    starts = lines[:200].str.contains(f"^{header}").arg_true()
    if not len(starts):
        without = f", or no header {header!r}" if header else ""
        raise InputError(f"the file has no rows{without}")
    if header:
        lines, row, has_header = lines[starts[0] :], row[starts[0] :], True
    table = _table_in(path, lines, row, comments, names, has_header)
    if not len(table.row):
        raise InputError(f"the file has no rows below its header: {brief(lines[-1])}")
    _refuse_other_widths(table, lines.tail(len(table.row)))
    return table


def _lines_in(text: str) -> "tuple[pl.Series, np.ndarray, tuple[str, ...]]":
    """[R] lines that are no comments nor empty, their [R] numbers from 1, and the comments before
    the first, without #."""
    import polars as pl

    lines = pl.Series([text]).str.split("\n").explode().str.strip_chars(" \r")
    is_comment = lines.str.starts_with("#")
    is_row = ((lines != "") & ~is_comment).to_numpy()
    first = int(np.argmax(is_row))
    comments = lines.head(first).filter(is_comment.head(first))
    comments = tuple(comments.str.strip_chars("# ").to_list())
    return lines.filter(is_row), 1 + np.flatnonzero(is_row), comments


def _table_in(
    path: Path,
    lines: "pl.Series",
    row: np.ndarray,
    comments: tuple[str, ...] = (),
    names: Sequence[str] | None = None,
    has_header: bool | None = None,
) -> Table:
    """The table in the lines `row` [R] of a file, below its comments; rows may differ in width.

    Columns without `names` have those of a header, which is the first line that is as
    wide as most, unless it has numbers where others have (or `has_header` says); else
    those of a comment, else 1, 2, ...

    Raises:
        InputError: for quotes that do not end, and too many columns.
    """
    notes = ()
    above = _lines_above(lines.head(FIRST).to_list())
    if above:
        notes += (f"{above} lines above the header",)
    lines, row = lines[above:], row[above:]
    mark = separator_of(lines[0])
    if lines[0].count(mark) > MOST:
        raise InputError(f"row {row[0]}: has more than {MOST} columns")
    if mark == " ":
        lines = lines.str.replace_all(r"\s+", " ")
    if mark != "," and _are_decimal_commas("\n".join(lines.head(200))):
        lines = lines.str.replace_all(r"([0-9]),([0-9])", "$1.$2")
        notes += ("decimal commas",)

    fields = _split(lines, mark)
    if names is None:
        names, taken = _header(fields.head(FIRST).to_list(), has_header)
        fields, row = fields[taken:], row[taken:]
        if taken > 1:
            notes += ("units below the header",)
        said = names_in_comments(comments, len(names))
        if said and not taken:
            names = said
            notes += (f"columns named in a comment: {' '.join(said)}",)
    if len(row) and len(fields[0]) == len(names) + 1 and not fields[0][-1]:
        names = [*names, ""]  # The rows end in a separator.
    return Table(path, names, fields, row, comments, notes=notes)


def _header(
    rows: Sequence[Sequence[str]], has_header: bool | None
) -> tuple[list[str], int]:
    """The names of columns whose first rows of fields are `rows`, and how many of them name these."""
    rows = [_stripped(fields) for fields in rows]
    names = [re.sub(r"^\$\w+:", "", name) for name in rows[0]]
    if has_header is None:
        has_header = header_in(rows)
    if not has_header:
        return [str(place) for place in range(1, len(names) + 1)], 0
    below = _lines_below(rows, len(names))
    return _with_units(names, rows[1 : 1 + below]), 1 + below


def _stripped(fields: Sequence[str]) -> list[str]:
    """The fields without blanks and quotes around them, and without what follows a last separator."""
    stripped = [field.strip(BLANKS) for field in fields]
    return stripped if stripped[-1] else stripped[:-1]


def _refuse_other_widths(table: Table, lines: "pl.Series") -> None:
    """Refuse the first of the `lines` [R] that has not one field for each name."""
    width = len(table.names)
    widths = table.fields.list.len().to_numpy()
    columns = option("columns", ("time=1", "id=2", "x=3", "y=4"))
    hint = f"{option('format')}, or {columns}, says what they are"
    if len(np.unique(widths)) > 2 or widths.max() < 3:
        hint = "this is no table: write rows of time, id, x and y"
    table.refuse(
        widths != width,
        lambda at: f"{widths[at]} columns, not {width}: {lines[at][:60]!r} ({hint})",
    )


def _lines_above(lines: Sequence[str]) -> int:
    """How many of some lines stand above a header: of another width than most, and of no numbers."""
    mark = separator_of(lines[-1])
    rows = [line.split(mark) for line in lines]
    widths = [len(row) for row in rows]
    above = widths.index(max(set(widths), key=widths.count))
    if not above or not header_in(rows[above:]):
        return 0
    fields = itertools.chain.from_iterable(rows[:above])
    return 0 if any(map(_is_number, fields)) else above


def _lines_below(rows: Sequence[Sequence[str]], width: int) -> int:
    """How many of some rows continue the header above them: units, or names once more."""
    count = 0
    for at in range(1, min(len(rows) - 1, 4)):
        if len(rows[at]) != width or not header_in(rows[at:]):
            break
        is_unit = any(field.lower().strip("()[]") in UNITS for field in rows[at])
        is_name = any(field and field in rows[at - 1] for field in rows[at])
        if not is_unit and not is_name:
            break
        count = at
    return count


def _with_units(names: list[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """The names of columns, with the units of metres that rows below them have."""
    for row in rows:
        units = [field.lower().strip("()[]") for field in row]
        if METRES.keys() & units:
            names = [
                f"{name} [{unit}]" if unit in UNITS and unit else name
                for name, unit in zip(names, units)
            ]
    return names


def _are_decimal_commas(text: str) -> bool:
    """Whether commas stand only between digits, and points nowhere there."""
    commas = len(re.findall(r"[0-9],[0-9]", text))
    has_points = re.search(r"[0-9]\.[0-9]", text) is not None
    return commas > 0 and commas == text.count(",") and not has_points


def _split(lines: "pl.Series", mark: str) -> "pl.Series":
    """[R] lists of the fields of `lines` [R], which may be quoted."""
    import polars as pl

    if not lines.str.contains('"', literal=True).any():
        return lines.str.split(mark)
    reader = csv.reader(lines, delimiter=mark, skipinitialspace=True, strict=True)
    try:
        quoted = list(reader)
        if len(quoted) < len(lines):
            raise csv.Error("a field goes on in the next line")
    except csv.Error as error:
        raise InputError(f"wrong quotes ({error})") from None
    return pl.Series(quoted, dtype=pl.List(pl.String))


# What words in the names of columns mean: roles and units, by `vocabulary.tsv`.

CLOCKS = ("time", "frame")
POINT = ("x", "y")
BOX = ("left", "top", "right", "bottom", "width", "height")
FLAGS = ("lost", "valid", "state", "confidence")  # rows that are no positions
ROLES = (*CLOCKS, "id", *POINT, *BOX, *FLAGS, "label", "vx", "vy")
DEGREES = "deg"  # unit of longitudes and latitudes
_UNIT = re.compile(r"^(.*?\w)\s*(?:[\[(](.+?)[\])]|[\s_/.-]([^\W_]+))$")


@functools.cache
def vocabulary() -> dict[str, frozenset[str]]:
    """The words of each role, and of units, `recording`, `people` and others."""
    path = files("neurosym_jax.data").joinpath("vocabulary.tsv")
    words = {}
    for line in path.read_text(encoding="utf-8").splitlines()[1:]:
        role, texts = line.split("\t")
        words[role] = frozenset(texts.split())
    return words


@functools.cache
def _meanings(kind: str) -> dict[str, str]:
    """The role of each word of a column's name, or where `kind` is "unit " its unit."""
    meanings = {}
    for role, words in vocabulary().items():
        is_role = role in (*ROLES, "z", "recording")
        if role.startswith(kind) and is_role == (not kind):
            meanings = dict.fromkeys(words, role.removeprefix(kind)) | meanings
    return meanings


def plain_name(name: str) -> tuple[str, str]:
    """A column's name in lower-case letters and digits, and its unit, else nothing."""
    name = name.strip().lower()[:60]
    unit = ""
    match = _UNIT.match(name)
    if match:
        unit = _meanings("unit ").get((match[2] or match[3]).strip(), "")
        name = match[1] if unit else name
    word = re.sub(r"[\W_]", "", name)
    return word, DEGREES if word in vocabulary()["globe"] else unit


def role_of(name: str) -> str:
    """The role that a column's name says, else nothing."""
    name = name.removeprefix("field.")  # Of `rostopic echo -p`.
    end = ".".join(name.split(".")[-2:])  # As `pose.position.x`.
    roles = _meanings("")
    return roles.get(plain_name(name)[0]) or roles.get(plain_name(end)[0], "")


def names_tracks(names: Sequence[str]) -> bool:
    """Whether a header names a clock, an id and positions."""
    roles = set(map(role_of, names))
    return "id" in roles and not roles.isdisjoint(CLOCKS) and has_position(roles)


def has_position(roles: Iterable[str]) -> bool:
    """Whether roles are those of points, or of boxes."""
    roles = set(roles)
    has_width = not roles.isdisjoint({"right", "width"})
    has_height = not roles.isdisjoint({"bottom", "height"})
    is_box = {"left", "top"} <= roles and has_width and has_height
    return roles.issuperset(POINT) or is_box


def names_in_comments(comments: Sequence[str], width: int) -> list[str]:
    """The names of `width` columns in the last comment that has them; none if none has."""
    for comment in reversed(comments):
        for mark in (None, ",", ";", "\t"):
            names = comment.split(mark)
            if len(names) == width and {"id", *POINT} <= set(map(role_of, names)):
                return [name.strip() for name in names]
    return []
