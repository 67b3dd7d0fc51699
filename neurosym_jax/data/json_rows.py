"""Strict JSON with numbers kept as they are written, and tables in JSON."""

import json
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

from neurosym_jax.data.text import read_lines, refuse_irregular
from neurosym_jax.errors import InputError

__all__ = ["JsonNumber", "decode_json", "json_text", "read_json_table"]

_WHOLE = 40_000_000
"""Bytes of a document that is not an object a line; it takes 25 times that in memory."""


class JsonNumber(str):
    """A number in JSON as it is written: 1, 1.0 and 1e0 stay different ids."""


def decode_json(text: str) -> Any:
    """The value of a JSON text, numbers as `JsonNumber`.

    Raises:
        ValueError: for text that is not strict JSON, or has a key twice in one object.
    """
    try:
        return _DECODER.decode(text)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def read_json_table(path: Path) -> tuple[list[str], list[list[str | None]]]:
    """Names of the columns and the rows of a table: an object a line, or a list of objects.

    Values that are null, a list or an object become None.

    Raises:
        InputError: naming file, row and reason.
    """
    lines = (line for line in read_lines(path) if line.strip())
    try:
        rows: Any = decode_json(next(lines))
    except ValueError:
        rows = None
    if isinstance(rows, dict):
        rows = chain([rows], _decoded(path, lines))
    else:
        if refuse_irregular(path) > _WHOLE:
            raise InputError(f"{path}: more than {_WHOLE:,} bytes: write a JSON object a line")
        try:
            rows = decode_json("".join(read_lines(path)))
        except ValueError as error:
            reason = str(error)[:80]
            raise InputError(f"{path}: neither JSON nor a JSON object a line ({reason})") from None
        if not isinstance(rows, list) or not rows:
            raise InputError(f"{path}: a table in JSON is a list of objects, or an object a line")
    names: list[str] = []
    found: list[list[str | None]] = []
    for at, row in enumerate(rows, 1):
        names = names or (list(row) if isinstance(row, dict) else [])
        if not isinstance(row, dict) or row.keys() != set(names):
            raise InputError(f"{path}: row {at}: not an object with the keys of row 1")
        found.append([json_text(row[name]) for name in names])
    return names, found


def _decoded(path: Path, lines: Iterable[str]) -> Iterator[Any]:
    for row, line in enumerate(lines, 2):
        try:
            yield decode_json(line)
        except ValueError as error:
            raise InputError(f"{path}: row {row}: not JSON ({str(error)[:80]})") from None


def json_text(value: Any) -> str | None:
    """The text of a value in JSON; None for null, a list or an object."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = dict(pairs)
    if len(keys) < len(pairs):
        seen: set[str] = set()
        twice = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise ValueError(f"the key {twice[:40]!r} is there twice")
    return keys


def _constant(name: str) -> Any:
    raise ValueError(f"{name} is not a number in JSON")


_DECODER = json.JSONDecoder(
    object_pairs_hook=_object,
    parse_float=JsonNumber,
    parse_int=JsonNumber,
    parse_constant=_constant,
)
