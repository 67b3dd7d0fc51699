"""An evaluation into a JSON file: rows are written as they come, and an interrupted run goes on.

What is in a row is `evaluation.run`'s; how rows look to people is `evaluation.report`'s.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.load import Test
from neurosym_jax.evaluation.plan import TestSet
from neurosym_jax.evaluation.report import FORMAT, check_replaceable
from neurosym_jax.evaluation.run import Result, Row, Settings, each_result
from neurosym_jax.forecasting.parameters import flat_parameters
from neurosym_jax.runtime import files
from neurosym_jax.runtime.processes import is_first, sum_over_processes

__all__ = ["evaluate_into"]


def evaluate_into(
    path: Path,
    tests: Sequence[Test],
    settings: Settings,
    *,
    resume: bool = False,
    each: Callable[[Sequence[Test], Settings], Iterable[Result]] = each_result,
    facts: Mapping[str, Any] | None = None,
    show: Callable[[list[Row], bool], None] | None = None,
) -> tuple[list[Row], list[Result]]:
    """Evaluate all `tests`; the first process writes the rows to `path`, each as it comes.

    The file says whether it is complete. With `resume`, rows that are there are kept, once it is
    known that they are of the same models, windows and settings.

    Args:
        path: of the file.
        tests: what is evaluated.
        settings: how.
        resume: whether rows that are there are kept.
        each: what evaluates.
        facts: what else the file is to say; JSON-able.
        show: is given the rows of a test set as soon as all are there, in the first process, and
            whether it is the first one.

    Returns:
        All rows in the order of the tests (in the first process), and the results of the test sets
        of which no row was kept.

    Raises:
        InputError: for a file that is no report of ours, is another evaluation's or cannot be
            written; and as `evaluate_tests`.
    """
    inputs = _digest(tests, settings)
    rows = _begun(path, inputs, resume=resume) if is_first() else []
    # Where there are other processes, they may not see the file.
    kept = int(sum_over_processes(np.array([len(rows)]))[0])
    total = sum(len(test.entries) for test in tests)
    todo, whole = _after(tests, kept)
    results = []
    shown: set[TestSet] = set()

    def tell() -> None:
        for test in tests:
            of = [row for row in rows if _test_set(row) == test.test_set]
            if show and len(of) == len(test.entries) and test.test_set not in shown:
                show(of, not shown)
                shown.add(test.test_set)

    if is_first():
        tell()
    for result in each(todo, settings):
        rows.append(result.row)
        if result.test_set in whole:
            results.append(result)
        if is_first():
            report = {"format": FORMAT, "complete": len(rows) == total, "inputs": inputs}
            files.write_json(path, report | dict(facts or {}) | {"rows": rows})
            tell()
    return rows, results


def _test_set(row: Row) -> TestSet:
    return TestSet(row["scene"], row["obs_len"], row["pred_len"])


def _begun(path: Path, inputs: str, *, resume: bool) -> list[Row]:
    """The rows that are kept of a file that is there.

    Raises:
        InputError: for a file that is no report, or is to be resumed and another evaluation's.
    """
    if not check_replaceable(path):
        return []
    if not resume:
        print(f"replacing the report in {path}")
        return []
    data = json.loads(path.read_text())
    if data.get("inputs") != inputs:
        raise InputError(
            f"{path}: was begun with other models, data or options, or by an earlier version "
            "(without --resume it is replaced)"
        )
    return data["rows"]


def _after(tests: Sequence[Test], kept: int) -> tuple[list[Test], set]:
    """What is left of `tests` after the first `kept` entries; the test sets that are left whole."""
    todo, whole = [], set()
    for test in tests:
        left = test.entries[kept:]
        kept = max(0, kept - len(test.entries))
        if left:
            todo.append(dataclasses.replace(test, entries=left))
        if len(left) == len(test.entries):
            whole.add(test.test_set)
    return todo, whole


def _digest(tests: Sequence[Test], settings: Settings) -> str:
    """SHA-256 of all that the rows depend on: models, windows and settings."""
    sha = hashlib.sha256(repr(settings).encode())
    for test in tests:
        windows = test.windows
        sha.update(repr((test.test_set, windows.obs_len, windows.reading)).encode())
        for array in (windows.bounds, windows.identity):
            sha.update(array.tobytes())
        if any(how.file for how in windows.reading):
            sha.update(windows.position.tobytes())
        else:
            # Simulated: a program that is compiled and the same one out of the cache may differ in
            # the last digit.
            sha.update(f"{windows.position.mean():.3f} {windows.position.std():.3f}".encode())
        for path, model in test.entries:
            sha.update(repr((path, model.kind, model.config, model.dataset)).encode())
            for name, array in flat_parameters(model.params).items():
                sha.update(f"{name} {array.dtype} {array.shape}".encode())
                sha.update(array.tobytes())
    return sha.hexdigest()
