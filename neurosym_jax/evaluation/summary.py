"""Lines of tables: a model on a test set, by one training or several; and means over test sets.

The 95 % interval of a line is

- of one training: over the scenes of the test set, in blocks (see `bootstrap`);
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

from neurosym_jax.evaluation.bootstrap import Interval, student_half
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.test_sets import TestSet
from neurosym_jax.forecasting.model import Model

__all__ = [
    "Line",
    "Value",
    "assumptions",
    "conclusion",
    "family_of",
    "labels",
    "lines_of",
    "means_of",
    "metrics_of",
]

Row = Mapping[str, Any]
"""See `results.Row`."""

SEED = re.compile(r"[_\-.]?seed[_\-=]?(\d+)")
"""In a checkpoint's path, the seed of one of several trainings."""


class Value(NamedTuple):
    """The value of one metric in a line."""

    mean: float | None = None
    """None where nothing was counted."""
    interval: Interval | None = None
    """95 %."""
    spread: float | None = None
    """Standard deviation between trainings or, of one, between seeds of the noise."""
    best: bool = False
    """Whether its interval lies beyond those of all other models on the test set."""


@dataclasses.dataclass(frozen=True)
class Line:
    """A model on a test set, or on all of them."""

    test_set: TestSet
    model: str
    checkpoint: str | None
    """As given; of several trainings without the seed."""
    rows: tuple[Row, ...]
    """One for each training; of a mean, for each training and test set."""
    seeds: tuple[int | None, ...]
    """Of each training, where its path names it; of a mean, those of one test set."""
    values: dict[str, Value]
    """By the name of the metric."""
    datasets: int = 1
    """Number of datasets that it is the mean of."""

    @property
    def trainings(self) -> int:
        """Number of trainings."""
        return len(self.seeds)


def metrics_of(row: Row) -> list[str]:
    """Names of the metrics that a row has columns of."""
    return [name for name in row if f"{name}_low" in row]


def lines_of(rows: Iterable[Row]) -> list[Line]:
    """A line for each model on each test set, in order; trainings that differ in seed are one."""
    groups: dict[tuple[TestSet, str, str | None, int | None], list[tuple[int | None, Row]]] = {}
    for at, row in enumerate(rows):
        family, seed = family_of(row["checkpoint"])
        test_set = TestSet(row["dataset"], row["obs_len"], row["pred_len"])
        key = (test_set, row["model"], family, at if seed is None else None)
        groups.setdefault(key, []).append((seed, row))
    lines = []
    for (test_set, model, family, _), members in groups.items():
        seeds, of = zip(*members)
        path = family if len(members) > 1 else of[0]["checkpoint"]
        values = {name: _value(name, of) for name in metrics_of(of[0])}
        lines.append(Line(test_set, model, path, of, seeds, values))
    return _marked(lines, lambda line: line.test_set)


def means_of(lines: Sequence[Line]) -> list[Line]:
    """Means over test sets, at each horizon, of the models that were tested on all of several."""
    means = []
    for lengths in dict.fromkeys(map(_lengths, lines)):
        of = [line for line in lines if _lengths(line) == lengths]
        names = list(dict.fromkeys(line.test_set.dataset for line in of))
        families: dict[tuple, list[Line]] = {}
        for line in of:
            family = (line.checkpoint or "").replace(line.test_set.dataset, "*")
            families.setdefault((line.model, family), []).append(line)
        for (model, family), members in families.items():
            if len(names) > 1 and [line.test_set.dataset for line in members] == names:
                values = {name: _mean(name, members) for name in members[0].values}
                test_set = TestSet(f"mean of {', '.join(names)}", *lengths)
                rows = tuple(row for line in members for row in line.rows)
                given = (family or None, rows, _common(members), values, len(names))
                means.append(Line(test_set, model, *given))
    return _marked(means, _lengths)


def conclusion(lines: Sequence[Line], period: float, *, simulated: bool = False) -> str:
    """Sentences on mean errors and significant differences.

    Args:
        lines: of all models on the same test sets, at one horizon.
        period: seconds between steps.
        simulated: whether the people are.
    """
    errors: dict[str, list[float]] = {}
    best: dict[str, list[str]] = {}
    tests = list(dict.fromkeys(line.test_set.dataset for line in lines))
    for line in lines:
        ade = line.values["joint_ade"]
        errors.setdefault(line.model, []).append(ade.mean or 0.0)
        if ade.best:
            best.setdefault(line.model, []).append(line.test_set.dataset)
    samples = {line.model: line.rows[0]["samples"] for line in lines}
    ranked = sorted(errors, key=lambda name: float(np.mean(errors[name])))
    parts = [
        f"{np.mean(errors[name]):.2f} m for {name}{' (one forecast)' * (samples[name] == 1)}"
        for name in ranked
    ]
    seconds = f"{lines[0].test_set.pred_len * period:.1f} s"
    text = f"Mean error over the next {seconds}, best of {max(samples.values())} forecasts: "
    text += f"{_and(parts)}."
    rest = [name for name in tests if not any(name in of for of in best.values())]
    if best:
        told = [f"{name} is significantly better on {_and(of)}" for name, of in best.items()]
        text += f" {_and(told)} (95 % intervals do not overlap)"
        text += f"; on {_and(rest)} no model is significantly better." if rest else "."
    else:
        text += " No model is significantly better than all others (95 % intervals overlap)."
    return text + " Simulated people say nothing about real ones." * simulated


def _and(parts: Sequence[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _lengths(line: Line) -> tuple[int, int]:
    return line.test_set.obs_len, line.test_set.pred_len


def family_of(checkpoint: str | None) -> tuple[str | None, int | None]:
    """A checkpoint's path without its seed, and the seed; None where it has none."""
    found = SEED.search(checkpoint or "")
    if checkpoint is None or found is None:
        return checkpoint, None
    return checkpoint[: found.start()] + checkpoint[found.end() :], int(found[1])


def labels(models: Sequence[tuple[str, str | None]]) -> list[str]:
    """Names of models on one test set, given (name, checkpoint); of equal ones, with the last part
    of the checkpoint in which all differ."""
    parts = {path: PurePath(path).parts for _, path in models if path}
    short = {path: path for path in parts}
    for back in range(1, min(map(len, parts.values()), default=0) + 1):
        if len({part[-back] for part in parts.values()}) == len(parts):
            short = {path: part[-back] for path, part in parts.items()}
            break
    names = [name for name, _ in models]
    return [
        f"{name} {short[path]}" if path and names.count(name) > 1 else name for name, path in models
    ]


def _value(name: str, rows: Sequence[Row]) -> Value:
    if len(rows) > 1:
        return _student([row.get(name) for row in rows])
    (row,) = rows
    low, high = row[f"{name}_low"], row[f"{name}_high"]
    interval = None if low is None or row[name] is None else Interval(low, high)
    return Value(row[name], interval, row.get(f"{name}_std"))


def _student(of: Sequence[float | None]) -> Value:
    """The mean of trainings, and Student's interval of it."""
    known = [value for value in of if value is not None]
    if len(known) < len(of):
        return Value()
    about = _about(float(np.mean(known)), student_half(known))
    return about._replace(spread=float(np.std(known, ddof=1)))


def _about(mean: float, half: float) -> Value:
    return Value(mean, Interval(mean - half, mean + half))


def _common(members: Sequence[Line]) -> tuple[int | None, ...]:
    """The seeds of a mean: those of its test sets, which are the same where there are several."""
    return members[0].seeds if len({line.seeds for line in members}) == 1 else (None,)


def _mean(name: str, members: Sequence[Line]) -> Value:
    values = [line.values.get(name, Value()) for line in members]
    means = [value.mean for value in values if value.mean is not None]
    intervals = [value.interval for value in values if value.interval is not None]
    if len(means) < len(members):
        return Value()
    if len(_common(members)) > 1:
        # Trainings of one seed are not independent of each other, so they are averaged first.
        of_seeds = [[row[name] for row in line.rows] for line in members]
        return _student(np.mean(of_seeds, axis=0).tolist())
    if len(intervals) < len(members):
        return Value(float(np.mean(means)))
    half = float(np.linalg.norm([(high - low) / 2 for low, high in intervals])) / len(members)
    return _about(float(np.mean(means)), half)


def _marked(lines: list[Line], group: Callable[[Line], object]) -> list[Line]:
    """`lines`, with the best values among the lines of each group marked."""
    marked = []
    for line in lines:
        others = [other for other in lines if other is not line and group(other) == group(line)]
        values = {
            name: value._replace(best=_beyond(name, value, others))
            for name, value in line.values.items()
        }
        marked.append(dataclasses.replace(line, values=values))
    return marked


def _beyond(name: str, value: Value, others: Sequence[Line]) -> bool:
    bounds = [other.values.get(name, Value()).interval for other in others]
    known = [interval for interval in bounds if interval is not None]
    if value.interval is None or not known or len(known) < len(bounds):
        return False
    if known_metric(name).higher_is_better:
        return value.interval.low > max(interval.high for interval in known)
    return value.interval.high < min(interval.low for interval in known)


def assumptions(models: Sequence[tuple[str, Model]]) -> list[str]:
    """What the torch checkpoints among the models do not say, a line for those that agree."""
    said: dict[tuple[str, ...], list[str]] = {}
    for path, model in models:
        if model.assumed:
            said.setdefault(model.assumed, []).append(path)
    return [
        f"assumed of {paths[0] if len(paths) == 1 else f'{len(paths)} torch checkpoints'}: "
        + "; ".join(words)
        for words, paths in said.items()
    ]
