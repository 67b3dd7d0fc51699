"""What a table has a line for: a model on a test set, by one training or several; and means.

Made of rows alone, as the JSON has them. The 95 % interval of a line is

- of one training: over the scenes of the test set, in blocks (see `paired`);
- of several that differ in their seed: Student's t of the trainings' mean;
- of a mean over test sets: Student's t of the means of each seed where there are several trainings,
  else of independent test sets.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.paired import Interval, student_half
from neurosym_jax.evaluation.plan import TestSet

__all__ = ["Line", "Value", "family_of", "lines_of", "means_of", "told_apart"]

Row = Mapping[str, Any]
"""Of the JSON."""

SEED = re.compile(r"[_\-.]?seed[_\-=]?(\d+)")
"""In a checkpoint's path: which of several trainings it is."""


class Value(NamedTuple):
    """What a line says of one metric."""

    mean: float | None
    """None where nothing was counted."""
    interval: Interval | None = None
    """95 %, where there is one."""
    spread: float | None = None
    """Standard deviation between trainings or, of one, between seeds of the noise."""
    best: bool = False
    """Whether its interval lies beyond those of all others on the test set."""


@dataclasses.dataclass(frozen=True)
class Line:
    """A model on a test set, or on all of them."""

    test_set: TestSet
    model: str
    checkpoint: str | None
    """As given, without the seed where there are several."""
    rows: tuple[Row, ...]
    """One for each training; of a mean, for each training and test set."""
    seeds: tuple[int | None, ...]
    """Of each training, where its path says it; a mean has those of one test set."""
    values: dict[str, Value]
    """By the name of the metric."""
    datasets: int = 1
    """That it is the mean of."""

    @property
    def trainings(self) -> int:
        """How many runs of one model it is of."""
        return len(self.seeds)


def lines_of(rows: Iterable[Row]) -> list[Line]:
    """A line for each model on each test set, in order; runs that differ in their seed are one."""
    groups: dict[tuple[TestSet, str, str | None, int | None], list[tuple[int | None, Row]]] = {}
    for at, row in enumerate(rows):
        family, seed = family_of(row["checkpoint"])
        test_set = TestSet(row["scene"], row["obs_len"], row["pred_len"])
        key = (test_set, row["model"], family, at if seed is None else None)
        groups.setdefault(key, []).append((seed, row))
    lines = []
    for (test_set, model, family, _), members in groups.items():
        seeds = tuple(seed for seed, _ in members)
        of = tuple(row for _, row in members)
        path = family if len(members) > 1 else members[0][1]["checkpoint"]
        lines.append(Line(test_set, model, path, of, seeds, _values(of)))
    return _marked(lines, lambda line: line.test_set)


def means_of(lines: Sequence[Line]) -> list[Line]:
    """Means over test sets, at each horizon, of the models that were tested on all of several."""
    means = []
    for lengths in dict.fromkeys(_lengths(line) for line in lines):
        of = [line for line in lines if _lengths(line) == lengths]
        names = list(dict.fromkeys(line.test_set.dataset for line in of))
        families: dict[tuple, list[Line]] = {}
        for line in of:
            family = (line.checkpoint or "").replace(line.test_set.dataset, "*")
            families.setdefault((line.model, family), []).append(line)
        for (model, family), members in families.items():
            if len(names) > 1 and [line.test_set.dataset for line in members] == names:
                rows = tuple(row for line in members for row in line.rows)
                means.append(
                    Line(
                        TestSet(f"mean of {', '.join(names)}", *lengths),
                        model,
                        family or None,
                        rows,
                        _common(members),
                        {name: _mean(name, members) for name in members[0].values},
                        len(names),
                    )
                )
    return _marked(means, _lengths)


def _lengths(line: Line) -> tuple[int, int]:
    return line.test_set.obs_len, line.test_set.pred_len


def family_of(checkpoint: str | None) -> tuple[str | None, int | None]:
    """A checkpoint's path without its seed, and that; None for which it has not."""
    found = SEED.search(checkpoint or "")
    if checkpoint is None or found is None:
        return checkpoint, None
    return checkpoint[: found.start()] + checkpoint[found.end() :], int(found[1])


def told_apart(checkpoints: Iterable[str]) -> dict[str, str]:
    """By path, the last part in which all of them differ; the path itself where there is none."""
    parts = {path: PurePath(path).parts for path in checkpoints}
    for back in range(1, min(map(len, parts.values()), default=0) + 1):
        if len({part[-back] for part in parts.values()}) == len(parts):
            return {path: part[-back] for path, part in parts.items()}
    return {path: path for path in parts}


def _values(rows: Sequence[Row]) -> dict[str, Value]:
    names = rows[0]["metrics"]
    if len(rows) > 1:
        return {name: _student([row["metrics"].get(name) for row in rows]) for name in names}
    (row,) = rows
    # Rows of an earlier version have no more than their means.
    intervals, spread = row.get("intervals") or {}, row.get("spread") or {}
    return {
        name: Value(
            mean,
            Interval(*intervals[name]) if name in intervals and mean is not None else None,
            spread.get(name),
        )
        for name, mean in row["metrics"].items()
    }


def _student(of: Sequence[float | None]) -> Value:
    """The mean of trainings, and Student's interval of it."""
    known = [value for value in of if value is not None]
    if len(known) < len(of):
        return Value(None)
    about = _about(float(np.mean(known)), student_half(known))
    return about._replace(spread=float(np.std(known, ddof=1)))


def _about(mean: float, half: float) -> Value:
    return Value(mean, Interval(mean - half, mean + half))


def _common(members: Sequence[Line]) -> tuple[int | None, ...]:
    """The seeds of a mean: those of its test sets, which are the same where there are several."""
    return members[0].seeds if len({line.seeds for line in members}) == 1 else (None,)


def _mean(name: str, members: Sequence[Line]) -> Value:
    values = [line.values.get(name, Value(None)) for line in members]
    means = [value.mean for value in values if value.mean is not None]
    intervals = [value.interval for value in values if value.interval is not None]
    if len(means) < len(members):
        return Value(None)
    if len(_common(members)) > 1:
        # Runs of one seed are not independent of each other, so they are averaged first.
        of_seeds = [[row["metrics"][name] for row in line.rows] for line in members]
        return _student(np.mean(of_seeds, axis=0).tolist())
    if len(intervals) < len(members):
        return Value(float(np.mean(means)))
    half = float(np.linalg.norm([(high - low) / 2 for low, high in intervals])) / len(members)
    return _about(float(np.mean(means)), half)


def _marked(lines: list[Line], group: Callable[[Line], object]) -> list[Line]:
    """`lines`, with what is best among those of each group."""
    groups: dict[object, list[Line]] = {}
    for line in lines:
        groups.setdefault(group(line), []).append(line)
    marked = []
    for line in lines:
        others = [other for other in groups[group(line)] if other is not line]
        values = {
            name: value._replace(best=_beyond(name, value, others))
            for name, value in line.values.items()
        }
        marked.append(dataclasses.replace(line, values=values))
    return marked


def _beyond(name: str, value: Value, others: Sequence[Line]) -> bool:
    bounds = [other.values.get(name, Value(None)).interval for other in others]
    known = [interval for interval in bounds if interval is not None]
    if value.interval is None or not known or len(known) < len(bounds):
        return False
    if known_metric(name).higher_is_better:
        return value.interval.low > max(interval.high for interval in known)
    return value.interval.high < min(interval.low for interval in known)
