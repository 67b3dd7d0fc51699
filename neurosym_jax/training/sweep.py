"""Many trainings, each a `neurosym train` in a process of one thread, then one test of all models.

A finished run is never trained again and an interrupted one continues, so a sweep that is called
again does what is left to do.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.sources import Source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.plan import load_tests, make_plan
from neurosym_jax.evaluation.report import write_report
from neurosym_jax.evaluation.results import Settings, evaluate_tests
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.model_folder import load_model, replace_card
from neurosym_jax.runtime.environment import cpu_cores, provenance
from neurosym_jax.runtime.files import refuse_unwritable, write_text
from neurosym_jax.runtime.process import progress_of
from neurosym_jax.training.card import model_card
from neurosym_jax.training.sweep_report import write_errors

__all__ = ["SweepRun", "run_sweep"]


class SweepRun(NamedTuple):
    """One training of a sweep."""

    folder: Path
    arguments: list[str]
    """Of `neurosym train`."""
    options: str
    """The `recipe.yaml` that they leave."""

    def finished(self) -> bool:
        """Whether the model was trained.

        Raises:
            InputError: where it was trained with other options.
        """
        if not (self.folder / "model" / "config.json").is_file():
            return False
        recipe = self.folder / "recipe.yaml"
        if not recipe.exists() or recipe.read_text() != self.options:
            raise InputError(f"{recipe}: the run had other options: choose another --out")
        return True


def run_sweep(
    runs: Sequence[SweepRun], source: Source, out: Path, options: str, jobs: int | None = None
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
    refuse(Count, {"--jobs": jobs})
    refuse_unwritable(out / "sweep.json")
    left = [run for run in runs if not run.finished()]
    print(f"{len(runs)} runs, {len(runs) - len(left)} of them finished before")
    write_text(out / "sweep.yaml", options)
    step = progress_of(len(left))
    with ThreadPoolExecutor(jobs or cpu_cores()) as pool:
        tasks = {pool.submit(_train, run): run for run in left}
        for task in as_completed(tasks):
            step(tasks[task].folder.name)
            if reason := task.result():
                print(f"failed: {tasks[task].folder}: {reason}", file=sys.stderr)
    done = [run.folder for run in runs if run.finished()]
    if not done:
        raise InputError(f"{out}: no run was finished, so there is nothing to test")
    table = format_table(rows_frame(_test(done, source, out)), "markdown")
    write_text(out / "sweep.md", table)
    print(f"\n{table}\nrows: {out / 'sweep.json'}")
    return 1 if len(done) < len(runs) else 0


def _train(run: SweepRun) -> str:
    """Train in a process with a log; why it failed, empty where it did not."""
    run.folder.mkdir(parents=True, exist_ok=True)
    log = run.folder / "train.log"
    command = [sys.executable, "-m", "neurosym_jax", "train", *run.arguments]
    # One thread is as fast at these sizes, and gives the same bits wherever it runs.
    environment = {**os.environ, "NPROC": "1"}
    with log.open("ab") as output:
        done = subprocess.run(command, stdout=output, stderr=output, env=environment, check=False)
    if done.returncode == 0:
        return ""
    lines = log.read_text().split("\n")
    return f"status {done.returncode}: {next(filter(str.strip, reversed(lines)), 'no output')}"


def _test(folders: Sequence[Path], source: Source, out: Path) -> list[dict[str, Any]]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `training_seed`."""
    facts = {str(of / "model"): json.loads((of / "run.json").read_text()) for of in folders}
    tests = load_tests(source, make_plan(source, [(path, load_model(path)) for path in facts]))
    results = list(evaluate_tests(tests, Settings()))
    rows = [result.row for result in results]
    for row in rows:
        path = row["checkpoint"]
        row["training_seed"] = path and facts[path]["training"]["seed"]
    files = [how.file for test in tests for how in test.windows.reading if how.file]
    write_report(out / "sweep.json", rows, {"provenance": provenance(files, facts)})
    write_errors(out, [result.errors for result in results])
    for test in tests:
        of_test = [result.row for result in results if result.test_set == test.test_set]
        for path in (path for path, _ in test.entries if path):
            own = [row for row in of_test if row["checkpoint"] in (None, path)]
            replace_card(Path(path), model_card(facts[path], own))
    return rows
