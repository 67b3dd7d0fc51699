"""Strict JSON with numbers kept as they are written, and tables in JSON."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from neurosym_jax.data.text import read_lines
from neurosym_jax.errors import InputError

__all__ = ["json_lines", "json_text", "read_json_table"]


class JsonNumber(str):
    """A number in JSON as it is written: 1, 1.0 and 1e0 stay different ids."""


def json_lines(path: Path) -> Iterator[tuple[int, Any]]:
    """The number of each line that is not empty, from 1, and its value in JSON.

    Raises:
        InputError: naming file, row and reason.
    """
    for row, line in enumerate(read_lines(path), 1):
        if line.strip():
            try:
                yield row, _DECODER.decode(line)
            except (ValueError, RecursionError) as error:
                raise InputError(f"{path}: row {row}: not JSON ({str(error)[:80]})") from None


def read_json_table(path: Path) -> tuple[list[str], list[list[str | None]]]:
    """Names of the columns and the rows of a table with an object a line.

    Values that are null, a list or an object become None.

    Raises:
        InputError: naming file, row and reason.
    """
    names: list[str] = []
    texts: list[list[str | None]] = []
    for at, row in json_lines(path):
        names = names or (list(row) if isinstance(row, dict) else [])
        if not isinstance(row, dict) or row.keys() != set(names):
            raise InputError(
                f"{path}: row {at}: not an object with the keys of row 1 (a table in JSON has an "
                "object a line)"
            )
        texts.append([json_text(row[name]) for name in names])
    return names, texts


def json_text(value: Any) -> str | None:
    """The text of a value in JSON; None for null, a list or an object."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    keys = dict(pairs)
    if len(keys) < len(pairs):
        twice = next(key for at, (key, _) in enumerate(pairs) if key in dict(pairs[:at]))
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
