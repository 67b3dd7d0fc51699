"""Trainings of several seeds and data sets, and the report of their tests."""

import itertools
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
import yaml

from neurosym_jax.data.recordings import Source
from neurosym_jax.errors import InputError, option
from neurosym_jax.evaluation import compare
from neurosym_jax.evaluation.intervals import (
    ErrorsByScene,
    mean_difference,
    paired_difference,
)
from neurosym_jax.evaluation.metrics import known_metric
from neurosym_jax.evaluation.scores import Score
from neurosym_jax.evaluation.tables import (
    Row,
    csv_text,
    format_table,
    markdown_table,
    markdown_text,
    rows_frame,
)
from neurosym_jax.models.disk import load_model, replace_card
from neurosym_jax.runtime.ending import when_ended
from neurosym_jax.runtime.files import new_file, refuse_unwritable, write_text
from neurosym_jax.runtime.foreign import read_arrays, read_json, reading
from neurosym_jax.runtime.process import cpu_cores, progress_of, provenance
from neurosym_jax.training.run import (
    LEAST,
    OLD_NAMES,
    differences_between,
    model_card,
)

__all__ = ["SweepRun", "compare_sweep", "run_sweep", "unfinished", "write_errors"]


# The comparison of a sweep's models: paired differences with intervals over scenes and
# seeds.

ERRORS = "scenes.npz"
"""Beside `sweep.json`, each row's errors by its number: `7/` are the scenes [S, 2], `7/joint_ade`
totals and counts [2, S]."""
MEAN = "mean over test sets"
ENOUGH = 3
"""Least number of seeds that tell how much trainings differ."""
TOO_FEW = """\
**Fewer than three seeds tell nothing of how much trainings differ, so no difference below is a
finding:** train three or more."""
INTERVALS = """\
Differences are the model's metric less the reference's, on the same scenes with the same noise and
seed: for errors, below 0 is better. In brackets is the 95 % interval: Student's t over blocks of
test scenes and over seeds. Bold where it leaves out 0. The mean weighs the test sets equally."""

BOUNDS = """\
Two numbers, in % of the reference's error: the least difference that these seeds and scenes can show
(half of the interval), and the largest that they leave possible (its farther end)."""
SHARE = "val_neighbour_near"
"""Column of `sweep.json`: of the people with somebody within 2 m in the validation, the share whom
neighbours change."""
HARDLY_LOOK = f"""\
Networks that hardly look at neighbours, who change less than {LEAST:.0%} of the forecasts of people
with somebody within 2 m:"""

Runs = dict[tuple[str, str], dict[int, ErrorsByScene]]
"""By model and test set, then by training seed."""


def write_errors(folder: Path, errors: Sequence[ErrorsByScene]) -> None:
    """Write the errors of all rows of a sweep, scene by scene."""
    arrays: dict[str, Any] = {}
    for at, row_errors in enumerate(errors):
        for name, score in row_errors.scores.items():
            arrays[f"{at}/{name}"] = np.array([*score])
        arrays[f"{at}/"] = row_errors.identity
    with new_file(folder / ERRORS) as beside:
        np.savez_compressed(beside, **arrays)


def compare_sweep(
    sweep: Path,
    against: str | Sequence[str] | None = None,
    *,
    pred_len: int | None = None,
    out: Path | None = None,
    errors: bool = True,
) -> str:
    """Compare a sweep's models with some of them: Markdown, and all differences as CSV beside it.

    Models are paired by training seed and test scene.

    Args:
        sweep: folder of the sweep.
        against: the reference or several, models by title or weighting; default: the
            first of two models.
        pred_len: steps forecast, where the sweep has several.
        out: the Markdown's file; default: report.md in the sweep's folder.
        errors: whether the table of errors is returned too.

    Returns:
        The Markdown, the table of errors, and a line of the files that were written.

    Raises:
        InputError: for a folder without a sweep, or one that lacks what is to be
            compared.
    """
    target = out or sweep / "report.md"
    if target.suffix != ".md":
        raise InputError(f"{option('out', str(target))}: must end in .md")
    report = sweep / "sweep.json"
    if not report.exists():
        raise InputError(
            f"{sweep}: no finished sweep is here; `neurosym sweep --out {sweep}` makes one"
        )
    refuse_unwritable(target)
    rows = compare.read_report(report)
    runs = _read(sweep, rows, pred_len)
    models = list(dict.fromkeys(model for model, _ in runs))
    names = [against] if isinstance(against, str | None) else against or [None]
    differences = []
    for reference in dict.fromkeys(_reference(name, models) for name in names):
        for model in models:
            if model != reference:
                differences += _compare(runs, model, reference)
    compared = pl.DataFrame(differences)
    table = target.with_suffix(".csv")
    near = _neighbour_shares(rows, pred_len)
    text = _report(runs, compared, table.name) + near
    write_text(target, text)
    write_text(table, csv_text(compared))
    parts = [text]
    if errors:
        parts.append(f"{format_table(rows, 'markdown')}\n")
    return "\n".join([*parts, f"{target}, {table}"])


def _report(runs: Runs, compared: pl.DataFrame, table: str) -> str:
    """The Markdown of the differences to each reference on the last test set, or in the mean."""
    last_rows = compared.filter(test_set=compared["test_set"][-1])
    seeds = set(itertools.chain.from_iterable(runs.values()))
    count = sum(map(len, runs.values()))
    parts = [f"# Models compared\n\nRuns: {count}. Seeds: {len(seeds)}."]
    if len(seeds) < ENOUGH:
        parts.append(TOO_FEW)
    test_set = markdown_text(last_rows["test_set"][0])
    for (name,), frame in last_rows.group_by("reference", maintain_order=True):
        reference = markdown_text(str(name))
        parts += [
            f"Difference to {reference}, {test_set}:",
            _table_of(frame, f"minus {reference}", _cell),
        ]
        if len(seeds) >= ENOUGH:
            parts += [BOUNDS, _table_of(frame, f"% of {reference}", _bounds)]
    parts.append(f"{INTERVALS} Differences on each test set are in `{table}`.")
    return "\n\n".join(parts) + "\n"


def _table_of(frame: pl.DataFrame, title: str, cell: Callable[[Row], str]) -> str:
    """A Markdown table of differences to one reference: a line each model, a column each metric."""
    metrics = frame["metric"].unique(maintain_order=True)
    lines = []
    for (model,), rows in frame.group_by("model", maintain_order=True):
        cells = map(cell, rows.iter_rows(named=True))
        lines.append([markdown_text(str(model)), *cells])
    labels = [known_metric(metric).label for metric in metrics]
    return markdown_table([title, *labels], lines)


def _bounds(row: Row) -> str:
    """Half of the interval and its farther end, in % of the error of the reference."""
    low, high = row["low_95"], row["high_95"]
    error = abs(row["error_of_reference"])
    if not np.isfinite(low) or not error:
        return "-"
    half = (high - low) / 2
    largest = max(abs(low), abs(high))
    return f"{100 * half / error:.1f}, {100 * largest / error:.1f}"


def _neighbour_shares(rows: pl.DataFrame, pred_len: int | None) -> str:
    """A paragraph on networks that hardly look at neighbours; nothing where shares are missing."""
    if SHARE not in rows.columns:
        return ""
    validated = rows.filter(pl.col(SHARE).is_not_null())
    if pred_len is not None:
        validated = validated.filter(pl.col("pred_len") == pred_len)
    counts = []
    for (model,), frame in validated.group_by("model", maintain_order=True):
        few = int((frame[SHARE] < LEAST).sum())
        counts.append(f"{few} of {len(frame)} of {markdown_text(str(model))}")
    return f"\n{HARDLY_LOOK} {'; '.join(counts)}.\n" if counts else ""


def _read(folder: Path, rows: pl.DataFrame, pred_len: int | None) -> Runs:
    """The errors of what was trained, of one horizon."""
    is_trained = pl.col("training_seed").is_not_null()
    trained = rows.with_row_index("at").filter(is_trained)
    horizons = sorted(trained.select("obs_len", "pred_len").unique().rows())
    if pred_len is not None:
        trained = trained.filter(pl.col("pred_len") == pred_len)
    chosen = trained.select("obs_len", "pred_len").unique().rows()
    if len(chosen) != 1:
        among = ", ".join(f"{seen} + {ahead}" for seen, ahead in horizons) or "none"
        raise InputError(
            f"horizons in the sweep: {among}; {option('pred_len')} chooses one"
        )
    runs: Runs = {}
    columns = trained.select("at", "model", "dataset", "training_seed")
    try:
        with reading(folder / ERRORS, "the errors of a sweep"):
            arrays = read_arrays(folder / ERRORS)
            for at, model, dataset, seed in columns.iter_rows():
                scores = {}
                for key, values in arrays.items():
                    row, _, name = key.partition("/")
                    if name and row == str(at):
                        scores[name] = Score(*values)
                errors = ErrorsByScene(scores, arrays[f"{at}/"], steps=sum(chosen[0]))
                runs.setdefault((model, dataset), {})[seed] = errors
    except InputError as error:
        raise InputError(
            f"{folder}: holds no whole sweep ({error}); run the sweep again"
        ) from None
    return runs


def _reference(against: str | None, models: Sequence[str]) -> str:
    """The model of this title, or whose title ends in `, NAME`; else the first of two."""
    name = models[0] if against is None and len(models) == 2 else against
    matches = [model for model in models if model == name]
    if not matches:
        matches = [model for model in models if model.endswith(f", {name}")]
    if len(models) < 2 or len(matches) != 1:
        hint = "names the one that others are compared with, by its title or weighting"
        hint = f"{option('against')} {hint}"
        problem = hint if len(models) > 1 else "a report compares two models or more"
        raise InputError(f"{problem}: there are {'; '.join(models)}")
    return matches[0]


def _compare(runs: Runs, model: str, reference: str) -> Iterator[Row]:
    """The model less the reference on each test set and in the mean, a row for each metric.

    Seeds that either of the two has not finished on a test set are left out of it, and
    of the mean.
    """
    parts = {}
    for dataset in [dataset for name, dataset in runs if name == model]:
        model_runs = runs[model, dataset]
        reference_runs = runs.get((reference, dataset), {})
        seeds = sorted(model_runs.keys() & reference_runs.keys())
        if not seeds:
            raise InputError(
                f"{model} and {reference} have no seed in common on {dataset}"
            )
        first = [model_runs[seed] for seed in seeds]
        second = [reference_runs[seed] for seed in seeds]
        mean = np.mean([errors.mean for errors in second], axis=0)
        parts[dataset] = paired_difference(first, second, numbers=seeds), mean
    if len(parts) > 1:
        differences, means = zip(*parts.values())
        parts[MEAN] = mean_difference(differences), np.mean(means, axis=0)
    for dataset, (difference, mean) in parts.items():
        for metric, error, value in zip(difference.metrics, mean, difference.mean):
            low, high = difference.intervals(metric)["both"]
            yield {
                "reference": reference,
                "model": model,
                "test_set": dataset,
                "metric": metric,
                "error_of_reference": error,
                "difference": value,
                "low_95": low,
                "high_95": high,
                "seeds": len(difference.seeds),
            }


def _cell(row: Row) -> str:
    low, high = row["low_95"], row["high_95"]
    text = f"{row['difference']:+.3f}"
    if not np.isfinite(low):
        return f"{text} (too few blocks of scenes)".replace("-", "−")
    text = f"{text} ({low:+.3f} to {high:+.3f})".replace("-", "−")
    if row["seeds"] >= ENOUGH and (low > 0 or high < 0):
        return f"**{text}**"
    return text


# Sweeps: many trainings, one test of all models, and a report that compares them.
#
# Each training is a `neurosym train` in a process of one thread. A finished run is never
# trained again and an interrupted one continues, so a sweep that is called again does
# what is left to do.

RECIPE = "recipe.yaml"
FREE = {"log", "quiet", "resume", "out"}
"""Options that change no result."""


class SweepRun(NamedTuple):
    """One training of a sweep."""

    folder: Path
    options: str
    """The content of `recipe.yaml` in the folder, which `neurosym train` reads."""
    label: str = ""
    """What tells the model apart from others of the sweep, such as `learning_rate=0.01`."""
    title: str = ""
    """What tables call the model, with its label."""

    @property
    def command(self) -> list[str]:
        """Arguments of `neurosym` that begin or continue the training."""
        return ["train", str(self.folder / RECIPE), "--resume"]

    def finished(self) -> bool:
        """Whether the model was trained.

        Raises:
            InputError: where the training was begun with other options.
        """
        finished = (self.folder / "run.json").is_file()
        if finished or (self.folder / "checkpoints").exists():
            recipe = self.folder / RECIPE
            text = recipe.read_text() if recipe.exists() else ""
            before = _results_options(text)
            now = _results_options(self.options)
            changes = "; ".join(differences_between(before, now))
            if changes:
                raise InputError(
                    f"{recipe}: the run had other options: {changes}: choose another "
                    f"{option('out')}"
                )
        return finished


def _results_options(text: str) -> dict[str, Any]:
    """The options in a `recipe.yaml` on which results depend."""
    options = {}
    for name, value in (yaml.safe_load(text) or {}).items():
        if name not in FREE:
            options[OLD_NAMES.get(name, name)] = value
    return options


def unfinished(runs: Sequence[SweepRun]) -> list[SweepRun]:
    """The runs that are not finished; writes their `recipe.yaml`."""
    left = [run for run in runs if not run.finished()]
    for run in left:
        write_text(run.folder / RECIPE, run.options)
    return left


def run_sweep(
    runs: Sequence[SweepRun],
    source: Source,
    out: Path,
    options: str,
    jobs: int | None = None,
) -> int:
    """Train what is left of `runs`, test all, write the table and the report.

    Args:
        runs: the trainings.
        source: recordings that the models are tested on.
        out: folder of `sweep.json`, `sweep.md` and `sweep.yaml`.
        options: content of `sweep.yaml`.
        jobs: number of trainings at once; None for one a core.

    Returns:
        1 if a training failed, else 0.

    Raises:
        InputError: for a finished run with other options, or where no run is finished.
    """
    refuse_unwritable(out / "sweep.json")
    left = unfinished(runs)
    print(f"{len(runs)} runs, {len(runs) - len(left)} of them finished before")
    write_text(out / "sweep.yaml", options)
    step = progress_of(len(left))
    with ThreadPoolExecutor(jobs or cpu_cores()) as pool:
        for run, reason in zip(left, pool.map(_train, left)):
            step(run.folder.name)
            if reason:
                print(f"failed: {run.folder}: {reason}", file=sys.stderr)
    done = {run.folder: run.label for run in runs if run.finished()}
    if not done:
        raise InputError(f"{out}: no run was finished, so there is nothing to test")
    table = format_table(rows_frame(_test(done, source, out)), "markdown")
    write_text(out / "sweep.md", table)
    print(f"\n{table}\nrows: {out / 'sweep.json'}")
    return 1 if len(done) < len(runs) else 0


def _train(run: SweepRun) -> str:
    """Train in a process with a log; why it failed, empty where it did not."""
    log = run.folder / "train.log"
    command = [sys.executable, "-m", "neurosym_jax", *run.command]
    # One thread is as fast at these sizes, and gives the same bits wherever it runs;
    # unbuffered, the last line of the log is the error and not what was printed before
    # it.
    environment = {**os.environ, "NPROC": "1", "PYTHONUNBUFFERED": "1"}
    with log.open("ab") as output:
        training = subprocess.Popen(
            command, stdout=output, stderr=output, env=environment
        )
        with training, when_ended(training.terminate):
            status = training.wait()
    if not status:
        return ""
    lines = [line for line in log.read_text().splitlines() if line.strip()]
    last = lines[-1] if lines else "no output"
    return f"status {status}: {last}"


def _test(labels: Mapping[Path, str], source: Source, out: Path) -> list[Row]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `training_seed`.

    `labels` has the folder of each run, and what its model is called beside its title.
    """
    facts = {}
    for folder in labels:
        facts_of_run = read_json(folder / "run.json", "the facts of a run")
        facts[str(folder / "model")] = facts_of_run
    models = [(path, load_model(path)) for path in facts]
    tests = compare.load_tests(source, compare.make_plan(source, models))
    tested = list(compare.evaluate_tests(tests, compare.Settings()))
    rows = [result.row for result in tested]
    for row in rows:
        path = row["checkpoint"]
        label = path and labels[Path(path).parent]
        if label:
            row["model"] += f", {label}"
        if path:
            row[SHARE] = facts[path]["validation"].get(SHARE)
    files = []
    for test in tests:
        files += [reading.file for reading in test.windows.reading if reading.file]
    origin = {"provenance": provenance(files, facts)}
    compare.write_report(out / "sweep.json", rows, origin)
    write_errors(out, [result.errors for result in tested])
    for path, run_facts in facts.items():
        own_results = [result for result in tested if result.row["checkpoint"] == path]
        sets = [result.test_set for result in own_results]
        beside = [result.row for result in tested if result.test_set in sets]
        own = [row for row in beside if row["checkpoint"] in (None, path)]
        replace_card(Path(path), model_card(run_facts, own))
    return rows
