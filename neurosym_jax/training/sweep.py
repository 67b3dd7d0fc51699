"""Sweeps: many trainings, one test of all models, and a report that compares them.

Each training is a `neurosym train` in a process of one thread. A finished run is never
trained again and an interrupted one continues, so a sweep that is called again does
what is left to do.
"""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from neurosym_jax.data.recordings import Source
from neurosym_jax.errors import InputError, option
from neurosym_jax.evaluation import plan, report, results
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.model_folder import load_model, replace_card
from neurosym_jax.runtime.ending import when_ended
from neurosym_jax.runtime.files import refuse_unwritable, write_text
from neurosym_jax.runtime.process import cpu_cores, progress_of, provenance
from neurosym_jax.training.run import differences_between, model_card
from neurosym_jax.training.sweep_report import write_errors

__all__ = ["SweepRun", "run_sweep", "unfinished"]

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
            before, now = (
                {
                    name: value
                    for name, value in (yaml.safe_load(x) or {}).items()
                    if name not in FREE
                }
                for x in (text, self.options)
            )
            if changes := "; ".join(differences_between(before, now)):
                raise InputError(
                    f"{recipe}: the run had other options: {changes}: choose another "
                    f"{option('out')}"
                )
        return finished


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
    last = ["no output", *filter(str.strip, log.read_text().splitlines())][-1]
    return f"status {status}: {last}" if status else ""


def _test(
    labels: Mapping[Path, str], source: Source, out: Path
) -> list[dict[str, Any]]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `training_seed`.

    `labels` has the folder of each run, and what its model is called beside its title.
    """
    facts = {
        str(folder / "model"): json.loads((folder / "run.json").read_text())
        for folder in labels
    }
    models = [(path, load_model(path)) for path in facts]
    tests = plan.load_tests(source, plan.make_plan(source, models))
    tested = list(results.evaluate_tests(tests, results.Settings()))
    rows = [result.row for result in tested]
    for row in rows:
        path = row["checkpoint"]
        row["training_seed"] = path and facts[path]["training"]["seed"]
        label = path and labels[Path(path).parent]
        row["model"] += f", {label}" if label else ""
    files = [
        reading.file
        for test in tests
        for reading in test.windows.reading
        if reading.file
    ]
    report.write_report(
        out / "sweep.json", rows, {"provenance": provenance(files, facts)}
    )
    write_errors(out, [result.errors for result in tested])
    for path, run_facts in facts.items():
        sets = [
            result.test_set for result in tested if result.row["checkpoint"] == path
        ]
        beside = [result.row for result in tested if result.test_set in sets]
        own = [row for row in beside if row["checkpoint"] in (None, path)]
        replace_card(Path(path), model_card(run_facts, own))
    return rows
