"""Many trainings in single-threaded processes, here or on a cluster, then one test of all.

A finished run is never trained again and an interrupted one goes on, so a sweep that is called once
more does what is left to do.
"""

import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.configuration import refuse_below
from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.cluster import evaluator
from neurosym_jax.evaluation.load import files_read, load_tests
from neurosym_jax.evaluation.plan import make_plan
from neurosym_jax.evaluation.report import FORMAT, write_json
from neurosym_jax.evaluation.run import Settings
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.files import refuse_unwritable, write_text
from neurosym_jax.runtime.progress import Progress
from neurosym_jax.runtime.provenance import provenance
from neurosym_jax.sweeps.cluster import train_over_cluster
from neurosym_jax.sweeps.errors import write_errors
from neurosym_jax.sweeps.estimate import seconds_of_run
from neurosym_jax.sweeps.processes import last_line, train_runs
from neurosym_jax.sweeps.runs import SweepRun
from neurosym_jax.sweeps.table import format_sweep
from neurosym_jax.training.card import write_card

__all__ = ["plan_of", "run_sweep"]


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
        runs: see `runs.plan_runs`.
        out: folder of what is written.
        data: that of the runs.
        jobs: trainings at once; None for one a core.
        cluster: address of a Dask scheduler, whose workers train and test.

    Raises:
        InputError: for a finished run of another recipe, or where nothing was finished; as
            `over_cluster`.
    """
    refuse_below(1, {"--jobs": jobs})
    if jobs and cluster:
        raise InputError("--jobs: a cluster trains as many at once as its workers have threads")
    refuse_unwritable(out / "sweep.json")
    left = [run for run in runs if not run.finished()]
    print(f"{len(runs)} runs, {len(runs) - len(left)} of them finished before")
    if cluster:
        each = train_over_cluster(left, cluster) if left else iter(())
    else:
        each = train_runs(left, jobs or cpu_cores())
    failed = _failed(each, len(left))
    for run, reason in failed:
        print(f"failed: {run.folder}: {reason}", file=sys.stderr)
    done = [run for run in runs if run.finished()]
    if not done:
        raise InputError(f"{out}: no run was finished, so there is nothing to test")
    rows = _test(done, out, data, cluster)
    table = format_sweep(rows)
    write_text(out / "sweep.md", table)
    print(f"\n{table}\nrows: {out / 'sweep.json'}")
    return 1 if failed else 0


def plan_of(runs: Sequence[SweepRun], jobs: int | None = None) -> str:
    """The runs and about how long they will take, found by starting one of them for a few steps.

    Raises:
        InputError: for a finished run of another recipe, or one that fails.
    """
    refuse_below(1, {"--jobs": jobs})
    left = [run for run in runs if not run.finished()]
    lines = [f"{'left' if run in left else 'finished'}  {run.folder}" for run in runs]
    lines.append(f"{len(runs)} runs, {len(left)} of them left")
    if left:
        each, at_once = seconds_of_run(left[0]), jobs or cpu_cores()
        minutes = each * math.ceil(len(left) / at_once) / 60
        lines.append(
            f"{left[0].folder.name} alone takes about {each:.0f} s; all that is left, {at_once} at "
            f"once, {minutes:.0f} min or more: runs side by side slow each other down"
        )
    return "\n".join(lines)


def _failed(each: Iterator[tuple[SweepRun, bool]], count: int) -> list[tuple[SweepRun, str]]:
    """Train `count` runs; those that failed and why."""
    failed = []
    with Progress(count, "training", "run") as progress:
        for run, finished in each:
            progress.step(run.folder.name)
            if not finished:
                failed.append((run, last_line(run)))
    return failed


def _test(
    runs: Sequence[SweepRun], out: Path, data: Path | None, cluster: str | None
) -> list[dict[str, Any]]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `run`."""
    of_path = {str(run.model): run for run in runs}
    models = [(path, load_model(path)) for path in of_path]
    source = open_source(data, model_scene=models[0][1].dataset)
    tests = load_tests(source, make_plan(source, models))
    results = list(evaluator(cluster)(tests, Settings()))
    rows = [result.row for result in results]
    for row in rows:
        run = of_path.get(row["checkpoint"])
        row["run"] = run and run.to_json()
    of = provenance(files_read(tests), of_path)
    write_json(out / "sweep.json", {"format": FORMAT, "rows": rows, "provenance": of})
    write_errors(out, rows, [result.errors for result in results])
    for name, run in of_path.items():
        lengths = (run.dataset, run.generator.obs_len, run.generator.pred_len)
        own = [
            row
            for row in rows
            if (row["scene"], row["obs_len"], row["pred_len"]) == lengths
            and row["checkpoint"] in (None, name)
        ]
        write_card(run.model, run.facts(), own)
    return rows
