"""Files of an evaluation: the report, replaced when whole, and beside it the rows as they come.

`evaluation.json` has `evaluation.jsonl` beside it, a line for each row. Each line has a digest of
the row's inputs, so that an interrupted evaluation continues from these rows.
"""

import dataclasses
import hashlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import polars as pl

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.results import Result, Row, Settings, each_result, rows_frame
from neurosym_jax.evaluation.test_sets import Test
from neurosym_jax.forecasting.parameters import flat_parameters
from neurosym_jax.runtime import files

__all__ = ["FORMAT", "check_report", "evaluate_into", "read_report", "write_report"]

FORMAT = 2


def evaluate_into(
    path: Path,
    tests: Sequence[Test],
    settings: Settings,
    *,
    resume: bool = False,
    pool: Executor | None = None,
    facts: Mapping[str, Any] | None = None,
    show: Callable[[Sequence[Row]], None] | None = None,
) -> tuple[list[Row], list[Result]]:
    """Evaluate all `tests` and write a report; rows are appended beside it as they come.

    Args:
        path: of the report.
        tests: to evaluate.
        settings: of the evaluation.
        resume: keep the rows that an interrupted evaluation of the same models, windows and
            settings left, and evaluate the others.
        pool: see `each_result`.
        facts: further content of the report; JSON-able.
        show: called with the rows of a test set as soon as all are there.

    Returns:
        All rows in order, and the results of the test sets of which no row was kept.
    """
    check_report(path)
    log = path.with_suffix(".jsonl")
    digests = {test.test_set: _digests(test, settings) for test in tests}
    order = [digest for of_test in digests.values() for digest in of_test]
    kept = {digest: row for digest, row in _kept(log).items() if resume and digest in order}
    files.write_text(log, "".join(_line(digest, row) for digest, row in kept.items()))
    left = [digest for digest in order if digest not in kept]
    todo = []
    for test in tests:
        both = zip(test.entries, digests[test.test_set])
        if entries := [entry for entry, digest in both if digest in left]:
            todo.append(dataclasses.replace(test, entries=entries))
    whole = {test_set for test_set, of_test in digests.items() if not kept.keys() & set(of_test)}
    unseen, results = dict(digests), []

    def show_whole() -> None:
        for test_set, of_test in list(unseen.items()):
            if all(digest in kept for digest in of_test):
                del unseen[test_set]
                if show:
                    show([kept[digest] for digest in of_test])

    show_whole()
    for result, digest in zip(each_result(todo, settings, pool), left):
        kept[digest] = result.row
        files.append_text(log, _line(digest, result.row))
        results += [result] if result.test_set in whole else []
        show_whole()
    rows = [kept[digest] for digest in order]
    readings = {how.recording: how.to_json() for test in tests for how in test.windows.reading}
    write_report(path, rows, {**(facts or {}), "recordings": list(readings.values())})
    return rows, results


def write_report(path: Path, rows: Sequence[Row], facts: Mapping[str, Any]) -> None:
    """Write a report of `rows` with further `facts`; say so where it replaces another.

    Raises:
        InputError: when `path` holds anything else, or cannot be written.
    """
    if check_report(path):
        print(f"replacing the report in {path}", file=sys.stderr)
    files.write_json(path, {"format": FORMAT, **facts, "rows": list(rows)})


def read_report(path: Path) -> pl.DataFrame:
    """Read the rows of a report.

    Raises:
        InputError: for a file that is missing or no report of this version.
    """
    report = _report(path)
    if report is None or report["format"] != FORMAT:
        raise InputError(f"{path}: is not a report of ours of format {FORMAT}")
    return rows_frame(report["rows"])


def check_report(path: Path) -> bool:
    """Whether a report is at `path` already.

    Raises:
        InputError: when `path`, or the file of rows beside it, holds anything else or cannot be
            written.
    """
    if path.suffix == ".jsonl":
        raise InputError(f"{path}: rows are kept in a .jsonl beside the report: name it .json")
    for each in (path, path.with_suffix(".jsonl")):
        files.refuse_unwritable(each)
        if each.exists() and (_report(each) if each == path else _log_text(each)) is None:
            raise InputError(f"{each}: is not a report of ours, so it is not overwritten")
    return path.exists()


def _report(path: Path) -> dict[str, Any] | None:
    """The content of a report; None for anything else."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and {"format", "rows"} <= set(found) else None


def _log_text(log: Path) -> str | None:
    """The content of a log of rows; None for anything else."""
    try:
        text = log.read_text()
    except (OSError, ValueError):
        return None
    return text if not text or text.startswith('{"checkpoint"') else None


def _kept(log: Path) -> dict[str, Row]:
    """The rows of a log by digest; the last line may have been written in part."""
    rows = {}
    for line in (_log_text(log) or "").splitlines():
        try:
            row = json.loads(line)
        except ValueError:
            break
        rows[row.pop("inputs")] = row
    return rows


def _line(digest: str, row: Row) -> str:
    return json.dumps({**row, "inputs": digest}, allow_nan=False) + "\n"


def _digests(test: Test, settings: Settings) -> list[str]:
    """SHA-256 of all that the row of each entry depends on: the model, windows and settings."""
    windows = test.windows
    common = hashlib.sha256(repr((settings, test.test_set, windows.reading)).encode())
    arrays = [windows.bounds, windows.identity, *windows.extras.values()]
    if any(how.file for how in windows.reading):
        arrays.append(windows.position)
    else:
        # Simulated: a program that is compiled and the same one out of the cache may differ in
        # the last digit.
        common.update(f"{windows.position.mean():.3f} {windows.position.std():.3f}".encode())
    for array in arrays:
        common.update(array.tobytes())
    found = []
    for path, model in test.entries:
        sha = common.copy()
        sha.update(repr((path, model.kind, model.config, model.dataset)).encode())
        for name, array in flat_parameters(model.params).items():
            sha.update(f"{name} {array.dtype} {array.shape}".encode())
            sha.update(array.tobytes())
        while sha.hexdigest() in found:  # The same model is tested twice.
            sha.update(b"again")
        found.append(sha.hexdigest())
    return found
