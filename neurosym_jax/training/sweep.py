"""Many trainings, each a `neurosym train` in a process of one thread, then one test of all models.

A finished run is never trained again and an interrupted one continues, so a sweep that is called
again does what is left to do.
"""

import os
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.configuration import to_json
from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.evaluation.plan import load_tests, make_plan
from neurosym_jax.evaluation.report import write_report
from neurosym_jax.evaluation.results import Settings, evaluate_tests, rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.runtime.executor import executor
from neurosym_jax.runtime.files import new_file, refuse_unwritable, write_text
from neurosym_jax.runtime.progress import Progress
from neurosym_jax.runtime.provenance import provenance
from neurosym_jax.training.card import write_card
from neurosym_jax.training.sweep_plan import SweepRun
from neurosym_jax.training.sweep_report import ARRAYS, ERRORS

__all__ = ["run_sweep", "write_errors"]

LOG = "train.log"
ATTEMPTS = 2
"""Of a run whose process died."""

_one_at_a_time = threading.Lock()
"""Of a worker with several threads: a training takes the process's folder and streams."""


def run_sweep(
    runs: Sequence[SweepRun],
    out: Path,
    *,
    data: Path | None = None,
    jobs: int | None = None,
    cluster: str | None = None,
) -> int:
    """Train what is left, test all, write `sweep.json` and `sweep.md`; 1 if a training failed.

    Args:
        runs: see `plan_runs`.
        out: folder of what is written.
        data: that of the runs.
        jobs: trainings at once; None for one a core.
        cluster: address of a Dask scheduler, whose workers train and see this folder.

    Raises:
        InputError: for a finished run of another recipe, or where no run is finished; see
            `runtime.executor`.
    """
    refuse_unwritable(out / "sweep.json")
    left = [run for run in runs if not run.finished()]
    print(f"{len(runs)} runs, {len(runs) - len(left)} of them finished before")
    failed = []
    with Progress(len(left), "training", "run") as progress:
        for run, reason in _train(left, jobs, cluster):
            progress.step(run.folder.name)
            if reason:
                failed.append(run)
                print(f"failed: {run.folder}: {reason}", file=sys.stderr)
    done = [run for run in runs if run.finished()]
    if not done:
        raise InputError(f"{out}: no run was finished, so there is nothing to test")
    table = format_table(rows_frame(_test(done, out, data)), "markdown")
    write_text(out / "sweep.md", table)
    print(f"\n{table}\nrows: {out / 'sweep.json'}")
    return 1 if failed else 0


def _train(
    runs: Sequence[SweepRun], jobs: int | None, cluster: str | None
) -> Iterator[tuple[SweepRun, str]]:
    """Each run when it ends, with why it failed; empty where it did not."""
    attempts = dict.fromkeys(range(len(runs)), 0)
    while attempts:
        before = {at: _size(runs[at]) for at in attempts}
        with executor(jobs, cluster) as pool:
            tasks = {
                pool.submit(_train_logged, Path.cwd(), runs[at].folder, runs[at].arguments): at
                for at in attempts
            }
            for task in as_completed(tasks):
                at = tasks[task]
                try:
                    finished = task.result()
                except BrokenProcessPool:
                    continue  # A process died, and with it the pool: another pool goes on.
                except CancelledError:
                    raise InputError(
                        f"--cluster {cluster}: the scheduler went away; what was finished is kept"
                    ) from None
                except Exception as error:  # What Dask says of a worker can be of any kind.
                    yield runs[at], f"{type(error).__name__}: {error}"
                else:
                    yield runs[at], "" if finished else _last_line(runs[at])
                del attempts[at]
        for at in list(attempts):
            # Which process died is not known; a run that had begun may be the one.
            attempts[at] += _size(runs[at]) != before[at]
            if attempts[at] == ATTEMPTS:
                del attempts[at]
                yield runs[at], f"its process died {ATTEMPTS} times: {_last_line(runs[at])}"


def _train_logged(cwd: Path, folder: Path, arguments: Sequence[str]) -> bool:
    """Train in this process, with its output in the run's log; whether it came to its end."""
    with _one_at_a_time:
        os.chdir(cwd)
        return _train_here(folder, arguments)


def _train_here(folder: Path, arguments: Sequence[str]) -> bool:
    from neurosym_jax.__main__ import main

    folder.mkdir(parents=True, exist_ok=True)
    # XLA writes from C++ to the numbers of the streams, so that these are redirected.
    kept = [os.dup(stream) for stream in (1, 2)]
    with (folder / LOG).open("a") as log:
        log.write("begins\n")
        log.flush()
        for stream in (1, 2):
            os.dup2(log.fileno(), stream)
    try:
        main(["train", *arguments])
    except SystemExit as end:
        return not end.code
    except Exception:
        traceback.print_exc()
        return False
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for stream, before in zip((1, 2), kept):
            os.dup2(before, stream)
            os.close(before)
    return True


def _size(run: SweepRun) -> int:
    log = run.folder / LOG
    return log.stat().st_size if log.exists() else 0


def _last_line(run: SweepRun) -> str:
    """The last line of the run's log: why it failed."""
    log = run.folder / LOG
    if not log.exists():
        return f"there is no {log}: do all workers see this folder?"
    return next((line for line in reversed(log.read_text().split("\n")) if line.strip()), "")


def _test(runs: Sequence[SweepRun], out: Path, data: Path | None) -> list[dict[str, Any]]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `run`."""
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
        own = [
            row
            for row in rows
            if (row["dataset"], row["obs_len"], row["pred_len"]) == lengths
            and row["checkpoint"] in (None, name)
        ]
        write_card(run.model, run.facts(), own)
    return rows


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
