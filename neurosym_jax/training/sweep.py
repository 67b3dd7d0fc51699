"""Many trainings, each a `neurosym train` in a process of one thread, then one test of all models.

A finished run is never trained again and an interrupted one continues, so a sweep that is called
again does what is left to do.
"""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.configuration import Count, refuse, to_json
from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.evaluation.plan import load_tests, make_plan
from neurosym_jax.evaluation.report import write_report
from neurosym_jax.evaluation.results import Settings, evaluate_tests, rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.model_folder import load_model, replace_card
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.files import new_file, refuse_unwritable, write_text
from neurosym_jax.runtime.progress import Progress
from neurosym_jax.runtime.provenance import provenance
from neurosym_jax.training.card import model_card
from neurosym_jax.training.sweep_plan import SweepRun
from neurosym_jax.training.sweep_report import ARRAYS, ERRORS

__all__ = ["run_sweep", "write_errors"]

LOG = "train.log"


def run_sweep(
    runs: Sequence[SweepRun], out: Path, *, data: Path | None = None, jobs: int | None = None
) -> int:
    """Train what is left, test all, write `sweep.json` and `sweep.md`; 1 if a training failed.

    Args:
        runs: see `plan_runs`.
        out: folder of what is written.
        data: that of the runs.
        jobs: trainings at once; None for one a core.

    Raises:
        InputError: for a finished run of another recipe, or where no run is finished.
    """
    if jobs is not None:
        refuse(Count, {"--jobs": jobs})
    refuse_unwritable(out / "sweep.json")
    left = [run for run in runs if not run.finished()]
    print(f"{len(runs)} runs, {len(runs) - len(left)} of them finished before")
    failed = 0
    with (
        Progress(len(left), "training", "run") as progress,
        ThreadPoolExecutor(jobs or cpu_cores()) as pool,
    ):
        tasks = {pool.submit(_train, run): run for run in left}
        for task in as_completed(tasks):
            progress.step(tasks[task].folder.name)
            if reason := task.result():
                failed += 1
                print(f"failed: {tasks[task].folder}: {reason}", file=sys.stderr)
    done = [run for run in runs if run.finished()]
    if not done:
        raise InputError(f"{out}: no run was finished, so there is nothing to test")
    table = format_table(rows_frame(_test(done, out, data)), "markdown")
    write_text(out / "sweep.md", table)
    print(f"\n{table}\nrows: {out / 'sweep.json'}")
    return 1 if failed else 0


def _train(run: SweepRun) -> str:
    """Train in a process with a log; why it failed, empty where it did not."""
    run.folder.mkdir(parents=True, exist_ok=True)
    log = run.folder / LOG
    command = [sys.executable, "-m", "neurosym_jax", "train", *run.arguments]
    # One thread is as fast at these sizes, and gives the same bits wherever it runs.
    environment = {**os.environ, "NPROC": "1"}
    with log.open("ab") as output:
        done = subprocess.run(command, stdout=output, stderr=output, env=environment, check=False)
    if done.returncode == 0:
        return ""
    lines = [line for line in log.read_text().split("\n") if line.strip()]
    return f"status {done.returncode}: {lines[-1] if lines else 'no output'}"


def _test(runs: Sequence[SweepRun], out: Path, data: Path | None) -> list[dict[str, Any]]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `training_seed`."""
    of_path = {str(run.model): run for run in runs}
    models = [(path, load_model(path)) for path in of_path]
    source = open_source(data, model_scene=models[0][1].dataset)
    tests = load_tests(source, make_plan(source, models))
    results = evaluate_tests(tests, Settings())
    rows = [result.row for result in results]
    for row in rows:
        run = of_path.get(row["checkpoint"])
        row["training_seed"] = run and run.recipe.seed
    files = [how.file for test in tests for how in test.windows.reading if how.file]
    recipe = {**to_json(runs[0].recipe), "seed": None}
    facts = {"recipe": recipe, "provenance": provenance(files, of_path)}
    write_report(out / "sweep.json", rows, facts)
    write_errors(out, rows, [result.errors for result in results])
    for name, run in of_path.items():
        lengths = (run.dataset, run.network.obs_len, run.network.pred_len)
        alike = [row for row in rows if lengths == tuple(row[part] for part in _TEST)]
        own = [row for row in alike if row["checkpoint"] in (None, name)]
        replace_card(run.model, model_card(run.facts(), own))
    return rows


_TEST = ("dataset", "obs_len", "pred_len")


def write_errors(
    folder: Path, rows: Sequence[Mapping[str, Any]], errors: Sequence[ErrorsByScene]
) -> None:
    """Write the trained rows' errors, scene by scene, in the order of the rows."""
    arrays: dict[str, Any] = {
        f"{name}_{index}": np.asarray(getattr(of_row, name))
        for index, (row, of_row) in enumerate(zip(rows, errors))
        if row["training_seed"] is not None
        for name in ARRAYS
    }
    with new_file(folder / ERRORS) as beside:
        np.savez_compressed(beside, **arrays)
