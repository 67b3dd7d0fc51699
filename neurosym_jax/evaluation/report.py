"""The report of an evaluation: its rows and facts as JSON, replaced when whole.

Beside `evaluation.json`, `evaluation.jsonl` has the rows as they come.
"""

import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.results import Result
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.runtime import files

__all__ = ["FORMAT", "check_report", "logged", "read_report", "write_report"]

FORMAT = 2


def write_report(
    path: Path, rows: Sequence[dict[str, Any]], facts: Mapping[str, Any]
) -> None:
    """Write a report of `rows` with further `facts`; say so where it replaces another."""
    if check_report(path):
        print(f"replacing the report in {path}", file=sys.stderr)
    files.write_json(path, {"format": FORMAT, **facts, "rows": list(rows)})


def logged(path: Path, results: Iterable[Result]) -> Iterator[Result]:
    """Yield `results`, and append the row of each to the log beside the report at `path`."""
    log = path.with_suffix(".jsonl")
    files.write_text(log, "")
    for result in results:
        files.append_text(log, json.dumps(result.row, allow_nan=False) + "\n")
        yield result


def read_report(path: Path) -> pl.DataFrame:
    """Read the rows of a report.

    Raises:
        InputError: for a file that is missing or no report of this version.
    """
    report = _report(path)
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if report.get("format") != FORMAT:
        raise InputError(f"{path}: is not a report of ours of format {FORMAT}")
    return rows_frame(report["rows"])


def check_report(path: Path) -> bool:
    """Whether a report is at `path` already.

    Raises:
        InputError: when `path`, or the log of rows beside it, holds anything else or
            cannot be written.
    """
    if path.suffix == ".jsonl":
        raise InputError(
            f"{path}: rows are kept in a .jsonl beside the report: name it .json"
        )
    log = path.with_suffix(".jsonl")
    for target in (path, log):
        files.refuse_unwritable(target)
    foreign = [log] * (
        log.exists() and log.read_bytes()[:13] not in (b"", b'{"checkpoint"')
    )
    foreign += [path] * (path.exists() and not _report(path))
    if foreign:
        raise InputError(
            f"{foreign[0]}: is not a report of ours, so it is not overwritten"
        )
    return path.exists()


def _report(path: Path) -> dict[str, Any]:
    """The content of a report; nothing for anything else."""
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError):
        return {}
    return (
        content
        if isinstance(content, dict) and {"format", "rows"} <= set(content)
        else {}
    )
