"""A real cluster of two workers: nothing is lost when one is killed, and the bits are the same."""

import json
import os
import pickle
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation import plan
from neurosym_jax.evaluation.cluster import evaluator
from neurosym_jax.evaluation.load import load_tests
from neurosym_jax.evaluation.plan import baseline
from neurosym_jax.evaluation.run import Settings
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.parameters import flat_parameters
from neurosym_jax.runtime.cluster import over_cluster
from neurosym_jax.sweeps.processes import last_line
from neurosym_jax.sweeps.runs import plan_runs
from neurosym_jax.sweeps.sweep import run_sweep

pytest.importorskip("distributed", reason="a cluster needs the extra cluster")

ROOT = Path(__file__).parents[2]
ENV = {**os.environ, "NPROC": "1", "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"}


def dask(*arguments, at):
    command = [sys.executable, "-m", *arguments, "--no-dashboard", "--scheduler-file", at]
    with (at.parent / "dask.log").open("a") as log:
        return subprocess.Popen(list(map(str, command)), env=ENV, stdout=log, stderr=log)


@contextmanager
def cluster(folder, workers=2):
    """Its address, and the processes of its workers; the scheduler says where it is in a file."""
    at = folder / "scheduler.json"
    running = [dask("distributed.cli.dask_scheduler", "--port", 0, at=at)]
    try:
        until(at.exists)
        running += [
            dask("distributed.cli.dask_worker", "--no-nanny", "--nthreads", 1, at=at)
            for _ in range(workers)
        ]
        yield json.loads(at.read_text())["address"], running[1:]
    finally:
        for process in running:
            process.kill()
            process.wait()


def until(there, seconds=120):
    end = time.monotonic() + seconds
    while not there():
        assert time.monotonic() < end
        time.sleep(0.05)


def children(process):
    """Of a process, by number."""
    tasks = Path(f"/proc/{process.pid}/task").glob("*/children")
    return [int(child) for task in tasks for child in task.read_text().split()]


def parameters(run):
    return flat_parameters(load_model(run.model).params)


def trains(process, run):
    """Whether one of the processes of `process` has the log of `run` open."""
    log = (run.folder / "train.log").resolve()
    files = (file for child in children(process) for file in Path(f"/proc/{child}/fd").iterdir())
    return any(file.resolve() == log for file in files)


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chosen = {
        "models": ("none",),  # The least to compile.
        "weightings": ("cnd",),
        "datasets": ("cross-path",),
        "seeds": 2,
        "changes": ("batch_scenes=4", "best_k=2", "max_agents=4", "validate_every=20"),
        "steps": 100,
    }
    runs = plan_runs(Path("sweep"), **chosen)
    with cluster(tmp_path) as (address, workers):
        sweep = "-m neurosym_jax sweep --models none --datasets cross-path --seeds 2 --steps 100"
        sweep = [sys.executable, *sweep.split(), "--out", "sweep", "--cluster", address]
        with Path("sweep.log").open("w") as log:
            client = subprocess.Popen(
                [*sweep, "--set", *chosen["changes"]], env=ENV, stdout=log, stderr=log
            )
        begun = runs[0].folder / "metrics.jsonl"
        until(lambda: begun.exists() and begun.read_text())
        began = [child for worker in workers for child in children(worker)]
        killed = next(worker for worker in workers if trains(worker, runs[0]))
        killed.kill()
        assert client.wait(timeout=300) == 0, Path("sweep.log").read_text()
        # What a worker began ends with it, or with the sweep.
        until(lambda: not any(Path(f"/proc/{child}").exists() for child in began))
    starts = [(run.folder / "train.log").read_text().count("to train on") for run in runs]
    assert starts == [2, 1]

    assert run_sweep(plan_runs(Path("alone"), **chosen | {"seeds": 1}), Path("alone")) == 0
    mine, alone = (
        flat_parameters(load_model(Path(at, runs[0].folder.name, "model")).params)
        for at in ("sweep", "alone")
    )
    assert all(np.array_equal(value, alone[name]) for name, value in mine.items())
    mine, alone = (
        [row["metrics"] for row in json.loads(Path(at, "sweep.json").read_text())["rows"]]
        for at in ("sweep", "alone")
    )
    assert mine[: len(alone)] == alone


def constant_velocity_on(*datasets):
    """Constant velocity on simulations."""
    entries = [(None, baseline("constant_velocity", 8, 8))]
    return load_tests(open_source(None), {plan.TestSet(name, 8, 8): entries for name in datasets})


def test_results_come_in_the_order_of_the_tests(monkeypatch):
    def backwards(address, work, items):
        """A worker does the last item first."""
        assert address == "tcp://there"
        for place in reversed(range(len(items))):
            yield place, work(pickle.loads(pickle.dumps(items[place]))), ""

    monkeypatch.setattr("neurosym_jax.evaluation.cluster.over_cluster", backwards)
    tests = constant_velocity_on("cross-path", "all-forward")
    found, alone = (list(evaluator(at)(tests, Settings(samples=2))) for at in ("tcp://there", None))
    assert [each.test_set.dataset for each in found] == ["cross-path", "all-forward"]
    assert [each.row["metrics"] for each in found] == [each.row["metrics"] for each in alone]


def test_a_test_set_that_failed_is_named(monkeypatch):
    def failing(address, work, items):
        yield 0, None, "the workers that were at it died, one after another"

    monkeypatch.setattr("neurosym_jax.evaluation.cluster.over_cluster", failing)
    with pytest.raises(InputError, match="cross-path: the workers that were at it died"):
        list(evaluator("tcp://there")(constant_velocity_on("cross-path"), Settings()))


def test_what_is_not_there_is_said(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="--cluster nowhere://x: no Dask scheduler answers"):
        list(over_cluster("nowhere://x", len, [()]))
    (run,) = plan_runs(tmp_path, models=("none",), weightings=(), datasets=("cross-path",))
    assert "do all that train see this folder?" in last_line(run)
    with pytest.raises(InputError, match="--jobs: a cluster trains as many at once"):
        run_sweep([run], tmp_path, jobs=2, cluster="tcp://there")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match="--cluster needs Dask: pip install"):
        list(over_cluster("tcp://there", len, [()]))
