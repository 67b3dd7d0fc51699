"""From rows of numbers and ids to tracks: what the readers of all formats have in common.

Every reader ends here, so that whatever a file holds becomes tracks or one `InputError` that names
the file. Which column means what is the readers' own business.
"""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.provenance import Reading
from neurosym_jax.data.text import JsonNumber, number, read_pieces, separator_of, split_row
from neurosym_jax.data.tracks import LATE, MAX_METRES, Tracks, common, make_tracks
from neurosym_jax.errors import InputError, printable

__all__ = ["People", "assemble", "consecutive", "frame_step", "number_table", "refuse_unwhole"]

_ID = 26  # characters; a float as numpy writes it has 25
_MISSING = ("", "nan", "null", "none", "n/a", "<na>", "nat")
_INTEGER = re.compile(r"[+-]?[0-9]+")


class People:
    """Ids as they come, row by row; distinct texts are distinct people."""

    def __init__(self, path: Path):
        self._path = path
        self._codes: dict[str, int] = {}
        self._rows: list[int] | np.ndarray = []
        self._kinds: set[bool] = set()

    def code(self, value: Any, row: int) -> int:
        """A number for the id in row `row`, the same for the same text.

        Raises:
            InputError: for an id that is missing or is no text or number.
        """
        text = value.strip() if isinstance(value, str) else str(value)
        if isinstance(value, bool) or not isinstance(value, str | int):
            raise InputError(f"{self._path}: row {row}: the id is {str(value)[:40]}, not an id")
        if text.lower() in _MISSING:
            raise InputError(f"{self._path}: row {row}: the id is missing ({text!r})")
        # In JSON 1 and "1" are two things.
        self._kinds.add(isinstance(value, str) and not isinstance(value, JsonNumber))
        return self._codes.setdefault(text, len(self._codes))

    def numbers(self, codes: ArrayLike) -> np.ndarray:
        """[R] int64 of [R] codes: the ids themselves if all are whole, else in order of name.

        Raises:
            InputError: where two texts are one number, as 1, 01 and 1.0 are.
        """
        if len(self._kinds) > 1:
            raise InputError(f"{self._path}: some ids are texts and some numbers: write them alike")
        whole = {text: _whole(text) for text in self._codes}
        if None in whole.values():
            known = {text: place for place, text in enumerate(sorted(whole))}
        else:
            texts: dict[Any, str] = {}
            for text, value in whole.items():
                if texts.setdefault(value, text) != text:
                    raise InputError(
                        f"{self._path}: the ids {texts[value][:40]!r} and {text[:40]!r} are one "
                        "number: one person or two? Write them alike"
                    )
            known = whole
        return np.array([known[text] for text in self._codes], np.int64)[np.asarray(codes)]


def _whole(text: str) -> int | None:
    """The whole number that a text is, if an int64 can be it."""
    try:
        value = int(text) if _INTEGER.fullmatch(text) else number(text)
    except ValueError:
        return None
    exact = isinstance(value, int) and abs(value) < 2**63
    return int(value) if exact or (abs(value) <= 2**53 and value == round(value)) else None


def number_table(path: Path, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """The rows of a file of finite numbers whose second column is ids.

    Commas or semicolons, else tabs and spaces stand between the numbers, the same in all rows; `#`
    begins a comment.

    Args:
        path: of the file.
        names: of the columns.

    Returns:
        [R, len(names)] float64, and [R] int64 ids.

    Raises:
        InputError: naming file, row and reason.
    """
    people, above, mark = People(path), 0, None
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    for piece in read_pieces(path):
        lines = [line for line in piece if line.split("#", 1)[0].strip()]
        if not lines:
            continue
        mark = mark if parts else separator_of(lines[0].split("#", 1)[0])
        rows, ids = _numbers(path, lines, names, mark, above)
        first = {text: above + row for row, text in zip(range(len(ids), 0, -1), reversed(ids))}
        known = {text: people.code(text.decode(), row) for text, row in first.items()}
        parts.append((rows, np.array([known[text] for text in ids])))
        above += len(lines)
    if not parts:
        raise InputError(f"{path}: the file has no rows")
    codes = np.concatenate([codes for _, codes in parts])
    return np.concatenate([rows for rows, _ in parts]), people.numbers(codes)


def _numbers(
    path: Path, lines: list[str], names: Sequence[str], mark: str | None, above: int
) -> tuple[np.ndarray, list[bytes]]:
    """[R, columns] numbers of a piece of a file, and the texts of their second column."""
    kinds = [(name, f"S{_ID}" if at == 1 else "f8") for at, name in enumerate(names)]
    clean = lines if mark is None else [_without_end(line, mark) for line in lines]
    try:
        table = np.loadtxt(clean, np.dtype(kinds), delimiter=mark, comments="#", ndmin=1)
        if len(table) < len(lines):
            raise ValueError("rows without a field")
        ids = table[names[1]].tolist()
        values = {text: number(text.decode()) for text in set(ids)}
        columns = [table[name] for name in names]
        columns[1] = np.array([values[text] for text in ids])
        rows = np.stack(columns, axis=1)
    except ValueError:
        raise InputError(_malformed(path, lines, names, mark, above)) from None
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise InputError(f"{path}: row {above + bad[0] + 1} is not finite: {rows[bad[0]].tolist()}")
    if max(map(len, ids)) == _ID:
        row = next(row for row, text in enumerate(ids) if len(text) == _ID)
        raise InputError(f"{path}: row {above + row + 1}: the id {ids[row]!r}... is too long")
    return rows, ids


def _without_end(line: str, mark: str) -> str:
    """A row without its comment, and without a separator after its last field."""
    return line.split("#", 1)[0].strip().removesuffix(mark)


def _malformed(
    path: Path, lines: list[str], names: Sequence[str], mark: str | None, above: int
) -> str:
    wanted = " ".join(names)
    for row, line in enumerate(lines, above + 1):
        fields = split_row(line) if separator_of(line.split("#")[0]) == mark else []
        shown = repr(line.strip() if len(line) < 60 else f"{line[:60]}...")
        if not fields:
            return f"{path}: row {row} is not separated as row 1 is (decimal commas?): {shown}"
        if len(fields) != len(names):
            which = " (--columns time=1 id=2 x=3 y=4, or --format, says what they are)"
            hint = which if row == 1 else ""
            return f"{path}: row {row} has {len(fields)} columns, not `{wanted}`{hint}: {shown}"
        for field in fields:
            try:
                number(field)
            except ValueError:
                hint = " (numbers are written with points)" if "," in field else ""
                return f"{path}: row {row}: {field[:60]!r} is not a number{hint}"
    return f"{path}: not a table of `{wanted}`"


def refuse_unwhole(path: Path, values: np.ndarray, name: str) -> None:
    """Refuse [R] `values`, called `name`, of which one is no whole number.

    Raises:
        InputError: naming the row of the first.
    """
    bad = np.flatnonzero((values != np.rint(values)) | (np.abs(values) > 2.0**53))
    if len(bad):
        value = values[bad[0]]
        reason = "too large" if abs(value) > 2.0**53 else "not whole"
        raise InputError(f"{path}: row {bad[0] + 1}: {name} {value} is {reason}")


def frame_step(path: Path, frame: np.ndarray, stride: float | None) -> float:
    """How many frame numbers make one period: `stride`, or the most common step between frames.

    Args:
        path: for messages.
        frame: [R] whole numbers.
        stride: frame numbers; None if the frames are to tell.

    Raises:
        InputError: for a stride that is not a usable number.
    """
    if stride is None:
        steps = np.diff(np.unique(frame))
        return common(steps) if len(steps) else 1.0
    if not 1e-3 <= stride <= 1e9:
        raise InputError(f"{path}: the stride must be 0.001 to 1e9 frames, not {stride}")
    return stride


def _refuse_repeats(path: Path, times: np.ndarray, ids: np.ndarray, numbers: np.ndarray) -> None:
    order = np.lexsort((times, ids))
    again = np.flatnonzero((np.diff(times[order]) == 0) & (np.diff(ids[order]) == 0))
    if len(again):
        row = int(max(order[again[0]], order[again[0] + 1]))
        what = f"time {times[row]:.12g}, id {ids[row]}"
        raise InputError(f"{path}: row {numbers[row]} repeats ({what})")


def consecutive(time: np.ndarray, id: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of [R] rows those that another of the same id follows in time, and these others."""
    order = np.lexsort((time, id))
    same = np.diff(id[order]) == 0
    return order[:-1][same], order[1:][same]


def assemble(
    path: Path,
    stamp: ArrayLike,
    id: ArrayLike,
    position: ArrayLike,
    recording: str | None = None,
    *,
    row: np.ndarray | None = None,
    **reading: Any,
) -> Tracks:
    """Tracks of R rows in the file's order, refused or warned of in the file's words.

    Args:
        path: of the file.
        stamp: [R] seconds.
        id: [R] int64.
        position: [R, 2] metres.
        recording: name; the file's without its ending if None.
        row: [R] the rows' numbers in messages; from 1 if None.
        **reading: further fields of `Reading`.

    Returns:
        Tracks whose `reading` says that an agent's time runs backward in the file, if it does;
        the rows are sorted.

    Raises:
        InputError: naming file, row (from 1) and reason: no rows, numbers that are not finite or
            larger than any clock's or map's, an agent twice at one time.
    """
    times, ids = np.asarray(stamp, np.float64), np.asarray(id, np.int64)
    points = np.asarray(position, np.float64).reshape(-1, 2)
    if len(times) == 0:
        raise InputError(f"{path}: the file has no rows")
    numbers = np.arange(1, len(times) + 1) if row is None else row
    for name, values, limit in (
        ("time", times[:, None], LATE),
        ("position", points, MAX_METRES),
    ):
        bad = np.flatnonzero(~(np.abs(values) <= limit).all(axis=1))
        if len(bad):
            shown = ", ".join(f"{value:g}" for value in values[bad[0]])
            raise InputError(
                f"{path}: row {numbers[bad[0]]}: {name} {shown} is not a usable number"
            )
    _refuse_repeats(path, times, ids, numbers)
    order = np.argsort(ids, kind="stable")
    back = np.flatnonzero((np.diff(times[order]) < 0) & (np.diff(ids[order]) == 0))
    warnings: tuple[str, ...] = ()
    if len(back):
        first = order[back[0] + 1]
        warnings = (
            f"row {numbers[first]}: time runs backward for agent {ids[first]} "
            f"({len(back)} times in all); the rows are put in order",
        )
    tracks = make_tracks(recording or printable(path.stem), times, ids, points)
    how = Reading(
        tracks.recording, printable(str(path)), rows=len(times), warnings=warnings, **reading
    )
    return dataclasses.replace(tracks, reading=how)
