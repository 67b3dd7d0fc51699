"""Tables, of CSV or JSON, as names of columns and rows of fields; what these mean others know."""

import csv
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from neurosym_jax.data.text import decode_json, number, read_head, read_lines, split_row
from neurosym_jax.errors import InputError

__all__ = ["Rows", "read_table"]

_WHOLE_JSON = 40_000_000
"""Bytes of a document that is not an object a line; 25 times that in memory."""

Rows = tuple[list[str], Iterator[Sequence[Any]]]
"""Names of the columns, and the rows' fields."""


def read_table(path: Path) -> Rows:
    """The table in a file: CSV (comma, semicolon or tab between the fields, else blanks), or JSON.

    The columns of CSV without a header, whose first row is numbers, are named 1, 2, ...

    Raises:
        InputError: naming file, row and reason; also while the rows are being read.
    """
    return _json(path) if read_head(path).first.startswith(("{", "[")) else _csv(path)


def _csv(path: Path) -> Rows:
    lines = (line for line in read_lines(path) if line.strip() and not line.startswith("#"))
    first = next(lines, None)
    if first is None:
        raise InputError(f"{path}: the file has no rows")
    try:
        width = len([number(field) for field in split_row(first)])
    except ValueError:
        width = 0
    if width:
        names = [str(at + 1) for at in range(width)]
        return names, _of_width(path, map(split_row, chain([first], lines)), width)
    mark = max(",;\t", key=first.count)
    if mark in first:
        rows = _parsed(path, chain([first], lines), mark)
    else:
        rows = map(str.split, chain([first], lines))
    names = [name.strip() for name in next(rows)]
    return names, _of_width(path, rows, len(names))


def _parsed(path: Path, lines: Iterator[str], mark: str) -> Iterator[list[str]]:
    rows = csv.reader(lines, delimiter=mark, skipinitialspace=True, strict=True)
    try:
        for row, fields in enumerate(rows):
            if rows.line_num != row + 1:
                raise InputError(f"{path}: row {row}: a quoted field goes on in the next line")
            yield fields
    except csv.Error as error:
        raise InputError(f"{path}: not CSV ({error})") from None


def _of_width(path: Path, rows: Iterator[list[str]], width: int) -> Iterator[list[str]]:
    for row, fields in enumerate(rows, 1):
        if len(fields) != width:
            raise InputError(f"{path}: row {row} has {len(fields)} of {width} columns")
        yield fields


def _json(path: Path) -> Rows:
    lines = (line for line in read_lines(path) if line.strip())
    try:
        table = decode_json(next(lines))
        whole = not isinstance(table, dict)
    except ValueError:
        table, whole = None, True
    if not whole and isinstance(table, dict) and not _is_lists(table):
        return list(table), _values(path, chain([table], map(_object_of(path), lines)))
    if whole or next(lines, None) is not None:
        if path.stat().st_size > _WHOLE_JSON:
            raise InputError(f"{path}: more than {_WHOLE_JSON:,} bytes: write a JSON object a line")
        try:
            table = decode_json("".join(read_lines(path)))
        except ValueError as error:
            reason = str(error)[:80]
            raise InputError(f"{path}: neither JSON nor a JSON object a line ({reason})") from None
    if isinstance(table, dict) and _is_lists(table):
        if len({len(column) for column in table.values()}) > 1:
            raise InputError(f"{path}: its lists are of different lengths")
        if not table:
            raise InputError(f"{path}: the table has no columns")
        return list(table), zip(*table.values())
    rows = [table] if isinstance(table, dict) else table
    if not isinstance(rows, list) or not rows or not isinstance(rows[0], dict):
        raise InputError(f"{path}: a table in JSON is a list of objects or an object of lists")
    return list(rows[0]), _values(path, iter(rows))


def _is_lists(table: dict[str, Any]) -> bool:
    return all(isinstance(column, list) for column in table.values())


def _object_of(path: Path) -> Callable[[str], Any]:
    def decode(line: str) -> Any:
        try:
            return decode_json(line)
        except ValueError as error:
            raise InputError(f"{path}: not a JSON object a line ({str(error)[:80]})") from None

    return decode


def _values(path: Path, rows: Iterator[Any]) -> Iterator[list[Any]]:
    names: list[str] = []
    for at, row in enumerate(rows, 1):
        names = names or (list(row) if isinstance(row, dict) else [])
        if not isinstance(row, dict) or row.keys() != set(names):
            raise InputError(f"{path}: row {at} is not an object with the keys of row 1")
        yield [row[name] for name in names]
