"""A sweep's models compared with a reference: paired by training seed and test scene."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.bootstrap import ErrorsByScene, mean_difference, paired_difference
from neurosym_jax.evaluation.markdown import markdown_table
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.report import read_report
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.runtime.files import new_file, refuse_unwritable, write_text

__all__ = ["write_errors", "write_report"]

ERRORS = "scenes.npz"
"""Beside `sweep.json`: each row's errors, scene by scene."""
FIELDS = ("metrics", "totals", "counts", "identity")
"""Of `ErrorsByScene`, in that file for each row."""
MEAN = "mean over test sets"
FEW = 3
"""Fewer seeds tell nothing of how much trainings differ."""
INTERVALS = """\
Differences are the model's metric less the reference's, on the same scenes with the same noise and
seed: for errors, below 0 is better. In brackets is the 95 % interval: test scenes resampled in
blocks of as many start frames as a window has steps, and the mean over seeds drawn from Student's
t. Bold where it leaves out 0. The mean weighs the test sets equally."""
TOO_FEW = """\
**{} nothing of how much trainings differ, so no difference below is a finding:** train three or
more."""

Runs = dict[tuple[str, str], dict[int, ErrorsByScene]]
"""By model and test set, then by training seed."""


def write_errors(folder: Path, errors: Sequence[ErrorsByScene]) -> None:
    """Write the errors of all rows of a sweep, scene by scene."""
    arrays: dict[str, Any] = {
        f"{name}_{at}": np.asarray(getattr(of_row, name))
        for at, of_row in enumerate(errors)
        for name in FIELDS
    }
    with new_file(folder / ERRORS) as beside:
        np.savez_compressed(beside, **arrays)


def write_report(
    sweep: Path,
    against: Sequence[str] = (),
    *,
    pred_len: int | None = None,
    out: Path | None = None,
) -> str:
    """Compare a sweep's models with references: Markdown, and all differences as CSV beside it.

    Args:
        sweep: folder of the sweep.
        against: the references, models by title or by weighting; default: the first of two models.
        pred_len: steps forecast, where the sweep has several.
        out: the Markdown's file; default: report.md in the sweep's folder.

    Returns:
        The Markdown, the table of errors, and a line of the files that were written.

    Raises:
        InputError: for a folder without a sweep, or one that lacks what is to be compared.
    """
    target = out or sweep / "report.md"
    if target.suffix != ".md":
        raise InputError(f"--out {target}: must end in .md")
    refuse_unwritable(target)
    rows = read_report(sweep / "sweep.json")
    runs = _read(sweep, rows, pred_len)
    models = list(dict.fromkeys(model for model, _ in runs))
    compared = pl.DataFrame(
        row
        for reference in _references(against, models)
        for model in models
        if model != reference
        for row in _compare(runs, model, reference)
    )
    seeds = len({seed for of in runs.values() for seed in of})
    trained = sum(map(len, runs.values()))
    parts = [f"# Models compared\n\n{trained} runs, {seeds} seed{'s' * (seeds > 1)}."]
    if seeds < FEW:
        parts.append(TOO_FEW.format(("One seed tells", "Two seeds tell")[seeds - 1]))
    table = target.with_suffix(".csv")
    parts += [*_tables(compared), INTERVALS, f"Differences on each test set are in `{table.name}`."]
    text = "\n\n".join(parts) + "\n"
    write_text(target, text)
    write_text(table, compared.write_csv())
    return f"{text}\n{format_table(rows, 'markdown')}\n\n{target}, {table}"


def _read(folder: Path, rows: pl.DataFrame, pred_len: int | None) -> Runs:
    """The errors of what was trained, of one horizon."""
    trained = rows.with_row_index("at").filter(pl.col("training_seed").is_not_null())
    if pred_len is not None:
        trained = trained.filter(pl.col("pred_len") == pred_len)
    horizons = sorted(trained.select("obs_len", "pred_len").unique().rows())
    if len(horizons) != 1:
        raise InputError(f"horizons in the sweep: {horizons or 'none'}; --pred-len chooses one")
    runs: Runs = {}
    columns = trained.select("at", "model", "dataset", "training_seed")
    try:
        with np.load(folder / ERRORS) as arrays:
            for at, model, dataset, seed in columns.iter_rows():
                metrics, *others = (arrays[f"{name}_{at}"] for name in FIELDS)
                errors = ErrorsByScene(tuple(metrics.tolist()), *others, steps=sum(horizons[0]))
                runs.setdefault((model, dataset), {})[seed] = errors
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{folder}: holds no whole sweep ({error}); run the sweep again") from None
    return runs


def _references(against: Sequence[str], models: Sequence[str]) -> list[str]:
    """The models of these titles, or whose titles end in `, NAME`; else the first of two."""
    there = f"there are {'; '.join(models)}"
    if len(models) < 2:
        raise InputError(f"a report compares two models or more: {there}")
    if not against and len(models) > 2:
        raise InputError(f"--against names the model to compare with: {there}")
    found = []
    for name in against or models[:1]:
        exactly = [each for each in models if each == name]
        called = exactly or [each for each in models if each.endswith(f", {name}")]
        if len(called) != 1:
            what = f"several models are {name!r}" if called else f"no {name!r} to compare with"
            raise InputError(f"--against: {what}: {there}")
        found += called
    return found


def _compare(runs: Runs, model: str, reference: str) -> Iterator[dict[str, Any]]:
    """The model less the reference on each test set and in the mean, a row for each metric.

    Seeds that either of the two has not finished on a test set are left out of it, and of the mean.
    """
    parts = {}
    for dataset in [dataset for of, dataset in runs if of == model]:
        ours, theirs = runs[model, dataset], runs.get((reference, dataset), {})
        seeds = sorted(ours.keys() & theirs.keys())
        if not seeds:
            raise InputError(f"{model} and {reference} have no seed in common on {dataset}")
        first, second = ([of[seed] for seed in seeds] for of in (ours, theirs))
        mean = np.mean([one.mean for one in second], axis=0)
        parts[dataset] = paired_difference(first, second, numbers=seeds), mean
    if len(parts) > 1:
        differences, means = zip(*parts.values())
        parts[MEAN] = mean_difference(differences), np.mean(means, axis=0)
    for dataset, (difference, mean) in parts.items():
        for metric, error, value in zip(difference.metrics, mean, difference.mean):
            low, high = difference.intervals(metric)["both"]
            row = {"reference": reference, "model": model, "test_set": dataset}
            row |= {"metric": metric, "error_of_reference": error, "difference": value}
            yield row | {"low_95": low, "high_95": high, "seeds": len(difference.seeds)}


def _tables(compared: pl.DataFrame) -> Iterator[str]:
    """A table for each reference, of the mean or the only test set."""
    metrics = compared["metric"].unique(maintain_order=True)
    whole = compared["test_set"][-1]
    shown = compared.filter(test_set=whole)
    for (reference,), of in shown.group_by("reference", maintain_order=True):
        head = [f"minus {reference}", *(known_metric(metric).label for metric in metrics)]
        lines = [
            [model, *map(_cell, rows.iter_rows(named=True))]
            for (model,), rows in of.group_by("model", maintain_order=True)
        ]
        yield f"Difference to {reference}, {whole}:\n\n{markdown_table(head, lines)}"


def _cell(row: dict[str, Any]) -> str:
    low, high = row["low_95"], row["high_95"]
    text = f"{row['difference']:+.3f} ({low:+.3f} to {high:+.3f})".replace("-", "−")
    return f"**{text}**" if row["seeds"] >= FEW and (low > 0 or high < 0) else text
