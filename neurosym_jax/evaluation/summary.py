"""Lines of tables: a model on a test set, by one training or several; and means over test sets.

The 95 % interval of a line is

- of one training: over the scenes of the test set, in blocks (see `intervals`);
- of several that differ in their seed: Student's t of the trainings' mean;
- of a mean over test sets: Student's t of the means of each seed where there are
  several trainings, else of independent test sets.

A line is the best of its test set where the paired test against each other line,
adjusted for their number, is significant at 5 %; for means over test sets the test is
Student's of the sets' means.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePath
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.evaluation.intervals import against_best, student_half, student_p
from neurosym_jax.evaluation.metrics import known_metric

__all__ = ["labels", "rows_frame", "short_names", "summarise", "unique_suffixes"]

SEED = r"[_\-.]?seed[_\-=]?(\d+)"
"""In a checkpoint's path, the seed of one of several trainings."""
HORIZON = ("obs_len", "pred_len")
FACTS = ("dataset", *HORIZON, "model", "samples", "seeds", "scenes", "agents", "blocks")
"""Columns of a row that a line keeps."""


def rows_frame(rows: Sequence[dict[str, Any]]) -> pl.DataFrame:
    """The rows of an evaluation as a data frame."""
    return pl.DataFrame(rows, infer_schema_length=None)


def summarise(rows: pl.DataFrame) -> pl.DataFrame:
    """The values of all lines, those of means over test sets last.

    Args:
        rows: see `evaluate`.

    Returns:
        A row for each line and metric, with `line` (a number), the columns of `FACTS`,
        `checkpoint` (of several trainings without the seed), `trainings`, `sets`
        (number of test sets), `metric`, its `mean` (None where nothing was counted),
        the bounds `low` and `high` of its 95 % interval, `std` (between trainings or,
        of one, between seeds of the noise), `p` (of the test against the best,
        adjusted; None for the best itself) and `best`, whether `p` of all other lines
        of the test set is below 5 %.
    """
    lines = _lines(rows)
    means = pl.DataFrame(_tested(list(_means(lines))), schema=lines.schema)
    lines = pl.concat([lines, means]).drop("means", "trained")
    group, p = ("dataset", *HORIZON, "metric"), pl.col("p")
    first = pl.col("mean").is_not_null() & p.is_null()
    beyond = (first.sum().over(group) == 1) & (p.max().over(group) < 0.05)
    return lines.with_columns(best=(first & beyond).fill_null(False))


def labels(models: Sequence[tuple[str, str | None]]) -> list[str]:
    """Names of models on one test set, given (name, checkpoint); of equal ones, with the shortest
    unique end of the checkpoint."""
    paths = list(dict.fromkeys(path for _, path in models if path))
    short = dict(zip(paths, unique_suffixes([PurePath(path) for path in paths])))
    names = [name for name, _ in models]
    return [
        f"{name} {short[path]}" if path and names.count(name) > 1 else name
        for name, path in models
    ]


def unique_suffixes(paths: Sequence[PurePath]) -> list[str]:
    """The shortest ends of all paths that tell them apart, without the parts that all end with."""
    parts = [path.parts for path in dict.fromkeys(paths)]
    while (
        len(parts) > 1
        and len({path[-1:] for path in parts}) == 1
        and min(map(len, parts)) > 1
    ):
        parts = [path[:-1] for path in parts]
    longest = max(map(len, parts), default=0)
    ends = (
        ["/".join(path[-size:]) for path in parts] for size in range(1, longest + 1)
    )
    unique = next(
        (end for end in ends if len({*end}) == len(parts)), list(map(str, paths))
    )
    suffixes = dict(zip(dict.fromkeys(paths), unique))
    return [suffixes[path] for path in paths]


def short_names(names: Iterable[str]) -> dict[str, str]:
    """Labels by name for narrow tables: CV for constant velocity, and without options.

    Names that would be the same stay as they are.
    """
    short = {
        name: re.sub(r",\S+", "", name.replace("constant velocity", "CV"))
        for name in names
    }
    brief = list(short.values())
    return {
        name: label if brief.count(label) == 1 else name
        for name, label in short.items()
    }


def _lines(rows: pl.DataFrame) -> pl.DataFrame:
    """Lines of one test set; `means` and `trained` are means and seeds of the trainings."""
    path = pl.col("checkpoint").cast(pl.String)
    seed = path.str.extract(SEED, 1).cast(pl.Int64)
    rows = rows.with_row_index("row").with_columns(seed=seed)
    family = path.str.replace(SEED, "")
    # Without a seed in its path each is a model of its own.
    alone = pl.when(pl.col("seed").is_null()).then(pl.col("row"))
    line = pl.col("row").first().over("dataset", *HORIZON, "model", family, alone)
    ends = {"mean": "", "low": "_low", "high": "_high", "std": "_std", "p": "_p"}
    long = pl.concat(
        rows.select(
            pl.col("seed", "checkpoint", "latency", "forecasts_per_second", *FACTS),
            family=family,
            line=line,
            metric=pl.lit(name),
            **{value: _column(rows, f"{name}{end}") for value, end in ends.items()},
        )
        for name in rows.columns
        if f"{name}_low" in rows.columns
    )
    lines = long.group_by("line", "metric", maintain_order=True).agg(
        pl.col(*FACTS, *ends).first(),
        pl.col("latency").max(),
        pl.col("forecasts_per_second").min(),
        checkpoint=pl.when(pl.len() > 1)
        .then(pl.first("family"))
        .otherwise(pl.first("checkpoint")),
        trainings=pl.len().cast(pl.Int64),
        sets=pl.lit(1),
        means=pl.col("mean"),
        trained=pl.col("seed"),
    )
    values = [
        _over_trainings(line) if line["trainings"] > 1 else line
        for line in lines.to_dicts()
    ]
    return pl.DataFrame(values, schema=lines.schema).sort("line", maintain_order=True)


def _column(rows: pl.DataFrame, name: str) -> pl.Expr:
    """The numbers of a column; nulls for one that an older report does not have."""
    return (pl.col(name) if name in rows.columns else pl.lit(None)).cast(pl.Float64)


def _over_trainings(line: dict[str, Any]) -> dict[str, Any]:
    """A line of several trainings with Student's interval of their mean."""
    means = line["means"]
    if not means or None in means:
        return line | dict.fromkeys(("mean", "low", "high", "std"))
    mean, half = float(np.mean(means)), student_half(means)
    std = float(np.std(means, ddof=1))
    return line | {"mean": mean, "low": mean - half, "high": mean + half, "std": std}


def _means(lines: pl.DataFrame) -> Iterator[dict[str, Any]]:
    """Means over test sets, at each horizon, of the models that were tested on all of several."""
    pairs = lines["checkpoint", "dataset"].rows()
    family = [(path or "").replace(dataset, "*") for path, dataset in pairs]
    lines = lines.with_columns(family=pl.Series(family))
    for _, peers in lines.group_by(HORIZON, maintain_order=True):
        names = peers["dataset"].unique(maintain_order=True).to_list()
        for _, sets in peers.group_by("model", "family", "metric", maintain_order=True):
            if len(names) > 1 and sets["dataset"].to_list() == names:
                number = len(lines) + sets["line"][0]
                yield _mean(sets) | {
                    "line": number,
                    "dataset": f"mean of {', '.join(names)}",
                }


def _mean(sets: pl.DataFrame) -> dict[str, Any]:
    """The mean of one metric over test sets, a line each."""
    line = sets.row(0, named=True)
    path, trainings, means = (
        line.pop("family") or None,
        line["trainings"],
        sets["mean"].to_list(),
    )
    line |= dict.fromkeys(
        ("mean", "low", "high", "std", "p", "scenes", "agents", "blocks")
    )
    line |= {"sets": len(sets), "checkpoint": path, "trainings": 1}
    line |= {"latency": sets["latency"].max()}
    line["forecasts_per_second"] = sets["forecasts_per_second"].min()
    if trainings > 1 and all(
        seeds == line["trained"] for seeds in sets["trained"].to_list()
    ):
        # Trainings of one seed are not independent of each other, so they are averaged
        # first.
        averages = (
            [] if None in means else np.mean(sets["means"].to_list(), axis=0).tolist()
        )
        line = _over_trainings(line | {"means": averages, "trainings": trainings})
        return line | {"means": means}
    line["means"] = means
    if None not in means:
        line["mean"] = mean = float(np.mean(means))
        if sets["low"].null_count() == 0:
            half = float(np.linalg.norm((sets["high"] - sets["low"]) / 2)) / len(sets)
            line |= {"low": mean - half, "high": mean + half}
    return line


def _tested(means: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Lines of means over test sets, with the p values of their paired tests over the sets."""
    groups: dict[Any, list[dict[str, Any]]] = {}
    for line in means:
        groups.setdefault(
            (line["dataset"], *map(line.get, HORIZON), line["metric"]), []
        ).append(line)
    for (*_, metric), group in groups.items():

        def p_value(best: int, other: int, group: Any = group) -> float:
            return student_p(np.subtract(group[best]["means"], group[other]["means"]))

        higher = known_metric(metric).higher_is_better
        p_values = against_best([line["mean"] for line in group], higher, p_value)
        for line, p in zip(group, p_values):
            line["p"] = p
    return means
