"""Many trainings, each a `neurosym train` in a process of one thread, then one test of all models.

A finished run is never trained again and an interrupted one continues, so a sweep that is called
again does what is left to do.
"""

import dataclasses
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Literal

from neurosym_jax.configuration import Count, refuse, to_json
from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.plan import load_tests, make_plan
from neurosym_jax.evaluation.report import write_report
from neurosym_jax.evaluation.results import Settings, evaluate_tests
from neurosym_jax.evaluation.summary import rows_frame
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.forecasting.model_folder import load_model, replace_card
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.plugins import loaded
from neurosym_jax.runtime.environment import cpu_cores, provenance
from neurosym_jax.runtime.files import refuse_unwritable, write_text
from neurosym_jax.runtime.process import progress_of
from neurosym_jax.training.card import model_card
from neurosym_jax.training.network import ANCHORS, POOLING_OF, model_name, named_network
from neurosym_jax.training.recipe import Recipe, make_recipe, usual_recipe
from neurosym_jax.training.sweep_report import write_errors

__all__ = ["Sweep", "SweepRun", "plan_runs", "run_sweep"]


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Every model on every data set with every seed."""

    models: tuple[str, ...] = ("sgan", "neurosym")
    """sgan, neurosym (as described), anchors, anchor_table, neurosym_ros, or any other pooling's
    name."""
    datasets: tuple[str, ...] = ()
    """Data sets to leave out of training and test on; default: all that the data has."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Random seeds, a training each."""
    obs_len: int = 8
    """Observed steps."""
    pred_lens: tuple[int, ...] = (8,)
    """Steps to forecast, a model each."""
    weightings: tuple[str, ...] = ("cnd",)
    """Weightings of NeuroSyM, a model each; see train's --weighting."""
    recipe: Literal["ours", "sgan", "anchors"] | None = None
    """How the models are trained, see docs/training.md; default: as `train` does each."""
    steps: int | None = None
    """Steps of training; default: the recipe's."""
    set: tuple[str, ...] = ()
    """Changes to the recipe, NAME=VALUE."""
    network: tuple[str, ...] = ()
    """Changes to the networks, NAME=VALUE."""
    data: Path | None = None
    """ETH/UCY as SGAN arranges it; default: the embedded simulations."""
    out: Path = Path("runs/sweep")
    """Folder of the runs, of sweep.json and of sweep.md."""


@dataclasses.dataclass(frozen=True)
class SweepRun:
    """One training of a sweep."""

    network: Any
    recipe: Recipe
    dataset: str
    folder: Path
    arguments: tuple[str, ...]
    """Of `neurosym train`."""

    @property
    def model(self) -> Path:
        """The folder of its model, which is there once the run is finished."""
        return self.folder / "model"

    def facts(self) -> dict[str, Any]:
        """The content of `run.json` of the finished run."""
        return json.loads((self.folder / "run.json").read_text())

    def finished(self) -> bool:
        """Whether the run has its model.

        Raises:
            InputError: where the model has another network or recipe than the sweep's.
        """
        if not self.model.is_dir() or not (self.folder / "run.json").is_file():
            return False
        facts = self.facts()
        for part, config in (("network", self.network), ("training", self.recipe)):
            if facts[part] != json.loads(json.dumps(to_json(config))):
                raise InputError(f"{self.folder}: its {part} differs: choose another --out")
        return True


def plan_runs(sweep: Sweep) -> list[SweepRun]:
    """One run for each seed, model, weighting, data set and horizon, in that order.

    Raises:
        InputError: for nothing to train, an unknown data set, model or weighting, or a change that
            does not fit.
    """
    if not sweep.seeds or not sweep.models:
        raise InputError("--seeds and --models: at least one of each is needed")
    source = open_source(sweep.data, sweep.datasets[0] if sweep.datasets else None)
    if unknown := [name for name in sweep.datasets if name not in source.scenes]:
        raise InputError(f"unknown dataset {unknown[0]!r}: there are {', '.join(source.scenes)}")
    common = {name: getattr(sweep, name) for name in ("recipe", "obs_len", "steps", "data")}
    arguments = [*_options(common), "--resume"]
    for option, changes in (("--set", sweep.set), ("--network", sweep.network)):
        arguments += [option, *changes] if changes else []
    arguments += [part for plugin in loaded() for part in ("--plugin", plugin)]
    datasets, lengths = sweep.datasets or source.scenes, sweep.pred_lens
    runs: dict[Path, SweepRun] = {}
    # Seed by seed: an interrupted sweep has trained all models as often.
    for seed, named, dataset, pred_len in itertools.product(
        sweep.seeds, list(_networks(sweep)), datasets, lengths
    ):
        network = named_network(
            **named, obs_len=sweep.obs_len, pred_len=pred_len, changes=sweep.network
        )
        how = sweep.recipe or usual_recipe(network)
        recipe = make_recipe(how, seed=seed, steps=sweep.steps, changes=sweep.set)
        name = f"{model_name(network)}_{dataset}_{sweep.obs_len}_{pred_len}_seed{seed}"
        folder = sweep.out / name
        own = {"dataset": dataset, "pred_len": pred_len, "seed": seed, **named, "out": folder}
        runs[folder] = SweepRun(network, recipe, dataset, folder, (*_options(own), *arguments))
    return list(runs.values())


def _options(values: Mapping[str, Any]) -> list[str]:
    """The options of a command line, of the values that are given."""
    given = {f"--{name.replace('_', '-')}": value for name, value in values.items()}
    return [str(p) for name, value in given.items() if value is not None for p in (name, value)]


def _networks(sweep: Sweep) -> Iterator[dict[str, Any]]:
    """The arguments of `named_network` that make the models."""
    for model in sweep.models:
        pooling = POOLING_OF.get(model, model)
        if model in ANCHORS:
            yield {"model": model}
        elif "alpha" not in POOLINGS[pooling].inputs:
            yield {"model": "sgan", "pooling": pooling}
        else:
            for weighting in sweep.weightings:
                yield {"model": "neurosym", "pooling": pooling, "weighting": weighting}


def run_sweep(sweep: Sweep, runs: Sequence[SweepRun], jobs: int | None = None) -> int:
    """Train what is left of `runs`, test all, write two files; 1 if a training failed.

    `jobs` is the number of trainings at once; None for one a core.

    Raises:
        InputError: for a finished run of another recipe, or where no run is finished.
    """
    refuse(Count, {"--jobs": jobs})
    out = sweep.out
    refuse_unwritable(out / "sweep.json")
    left = [run for run in runs if not run.finished()]
    print(f"{len(runs)} runs, {len(runs) - len(left)} of them finished before")
    step = progress_of(len(left))
    with ThreadPoolExecutor(jobs or cpu_cores()) as pool:
        tasks = {pool.submit(_train, run): run for run in left}
        for task in as_completed(tasks):
            step(tasks[task].folder.name)
            if reason := task.result():
                print(f"failed: {tasks[task].folder}: {reason}", file=sys.stderr)
    done = [run for run in runs if run.finished()]
    if not done:
        raise InputError(f"{out}: no run was finished, so there is nothing to test")
    table = format_table(rows_frame(_test(sweep, done)), "markdown")
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


def _test(sweep: Sweep, runs: Sequence[SweepRun]) -> list[dict[str, Any]]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `training_seed`."""
    of_path = {str(run.model): run for run in runs}
    models = [(path, load_model(path)) for path in of_path]
    source = open_source(sweep.data, model_scene=models[0][1].dataset)
    tests = load_tests(source, make_plan(source, models))
    results = list(evaluate_tests(tests, Settings()))
    rows = [result.row for result in results]
    for row in rows:
        run = of_path.get(row["checkpoint"])
        row["training_seed"] = run and run.recipe.seed
    files = [how.file for test in tests for how in test.windows.reading if how.file]
    recipe = {**to_json(runs[0].recipe), "seed": None}
    facts = {"recipe": recipe, "provenance": provenance(files, of_path)}
    write_report(sweep.out / "sweep.json", rows, facts)
    write_errors(sweep.out, [result.errors for result in results])
    for path, run in of_path.items():
        lengths = (run.dataset, run.network.obs_len, run.network.pred_len)
        tested = [r for r in rows if (r["dataset"], r["obs_len"], r["pred_len"]) == lengths]
        own = [row for row in tested if row["checkpoint"] in (None, path)]
        replace_card(run.model, model_card(run.facts(), own))
    return rows
