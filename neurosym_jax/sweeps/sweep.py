"""Many trainings as independent single-threaded processes, then one test of all that they made.

A finished run is never trained again and an interrupted one goes on, so a sweep that is called once
more does what is left to do.
"""

import dataclasses
import functools
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal

from tqdm import tqdm

from neurosym_jax.checks import refuse_below
from neurosym_jax.config import to_json
from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.cases import make_cases
from neurosym_jax.evaluation.report import FORMAT, write_json
from neurosym_jax.evaluation.rows import Settings, evaluate_cases
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.sweeps.errors import write_errors
from neurosym_jax.sweeps.table import format_sweep
from neurosym_jax.training.card import write_card
from neurosym_jax.training.finish import RUN
from neurosym_jax.training.loop import record_of_today
from neurosym_jax.training.run import TrainOptions, generator_config, model_name, recipe

__all__ = ["SweepOptions", "sweep", "sweep_runs"]

LOG = "train.log"


@dataclasses.dataclass(frozen=True)
class SweepOptions:
    """Train every model on every scene with every seed, a process each; test them; one table."""

    models: tuple[Literal["sgan", "neurosym", "neurosym_ros"], ...] = ("sgan", "neurosym")
    """SGAN with pooling, NeuroSyM as described, NeuroSyM of the robot package."""
    scenes: tuple[str, ...] = ()
    """Scenes to leave out of training and test on; default: all that the data has."""
    seeds: int = 3
    """Seeds 0 to N-1."""
    obs_len: int = 8
    """Observed steps."""
    pred_lens: tuple[int, ...] = (8,)
    """Steps to forecast, a model each."""
    weightings: tuple[str, ...] = ("cnd",)
    """Of NeuroSyM, a model each; as train's --weighting."""
    recipe: Literal["ours", "sgan"] = "ours"
    """How they are trained, see docs/training.md."""
    steps: int | None = None
    """Generator steps; default: the recipe's."""
    set: tuple[str, ...] = ()
    """Changes to the recipe, NAME=VALUE."""
    data: Path | None = None
    """ETH/UCY as SGAN arranges it; default: the embedded simulations."""
    out: Path = Path("runs/sweep")
    """Folder of the runs, of sweep.json and of sweep.md."""
    jobs: int | None = None
    """Trainings at once; default: one for each core."""


def sweep(options: SweepOptions) -> int:
    """Train what is left, test all, write `sweep.json` and `sweep.md`; 1 if a training failed.

    Raises:
        InputError: for options that cannot be used, or a finished run of another recipe.
    """
    runs = sweep_runs(options)
    left = [run for run in runs if not _finished(run)]
    print(f"{len(runs)} runs, {len(runs) - len(left)} of them finished before")
    failed = _train_all(left, options.jobs or cpu_cores())
    for run, reason in failed:
        print(f"failed: {run.out}: {reason}", file=sys.stderr)
    done = [run for run in runs if _finished(run)]
    if not done:
        raise InputError(f"{options.out}: no run was finished, so there is nothing to test")
    rows = _test(options, done)
    table = format_sweep(rows)
    (options.out / "sweep.md").write_text(table)
    print(f"\n{table}\nrows: {options.out / 'sweep.json'}")
    return 1 if failed else 0


def sweep_runs(options: SweepOptions) -> list[TrainOptions]:
    """One training for each seed, model, weighting, scene and horizon, in that order.

    Raises:
        InputError: for nothing to train, a scene the data has not or a recipe that cannot be.
    """
    refuse_below(1, {"--seeds": options.seeds, "--jobs": options.jobs})
    source = open_source(options.data, options.scenes[0] if options.scenes else None)
    scenes = options.scenes or source.scenes
    if unknown := [scene for scene in scenes if scene not in source.scenes]:
        raise InputError(f"unknown scene {unknown[0]!r}: there are {', '.join(source.scenes)}")
    runs = [
        TrainOptions(
            **kind,
            scene=scene,
            obs_len=options.obs_len,
            pred_len=pred_len,
            recipe=options.recipe,
            seed=seed,
            steps=options.steps,
            set=options.set,
            data=options.data,
            resume=True,
        )
        # Seed by seed: whenever it is interrupted, all models have been trained as often; and
        # what one seed compiled the next one finds.
        for seed in range(options.seeds)
        for model in options.models
        for kind in _kinds(model, options.weightings)
        for scene in scenes
        for pred_len in options.pred_lens
    ]
    for run in runs[:1]:
        recipe(run)  # All have the same; refused here, it is refused once.
    return [
        dataclasses.replace(
            run,
            out=options.out
            / f"{model_name(run)}_{run.scene}_{run.obs_len}_{run.pred_len}_seed{run.seed}",
        )
        for run in dict.fromkeys(runs)
    ]


def _kinds(model: str, weightings: Sequence[str]) -> Iterator[dict[str, Any]]:
    """The options that make `model`."""
    if model == "sgan":
        yield {"model": "sgan"}
        return
    variant = "as_described" if model == "neurosym" else model
    for weighting in weightings:
        yield {"model": "neurosym", "variant": variant, "weighting": weighting}


def _finished(run: TrainOptions) -> bool:
    """Whether the run has its model.

    Raises:
        InputError: where it is that of another network or recipe than the sweep's.
    """
    folder = Path(str(run.out))
    if not (folder / "model").is_dir() or not (folder / RUN).is_file():
        return False
    facts = record_of_today(json.loads((folder / RUN).read_text()), folder / RUN)
    wanted = {"generator": to_json(generator_config(run)), "training": to_json(recipe(run))}
    for part, fields in json.loads(json.dumps(wanted)).items():
        for name, value in fields.items():
            if facts[part].get(name) != value:
                raise InputError(
                    f"{folder}: was trained with {name} = {facts[part].get(name)}, "
                    f"not {value}: choose another --out"
                )
    return True


def _train_all(runs: Sequence[TrainOptions], at_once: int) -> list[tuple[TrainOptions, str]]:
    """Train `runs`, `at_once` at a time; returns those that failed and why."""
    waiting, failed = list(reversed(runs)), []
    running: dict[subprocess.Popen, TrainOptions] = {}
    try:
        with tqdm(total=len(runs), desc="training", unit="run", disable=None) as bar:
            while waiting or running:
                while waiting and len(running) < at_once:
                    run = waiting.pop()
                    running[_start(run)] = run
                time.sleep(0.1)
                for process in [process for process in running if process.poll() is not None]:
                    run = running.pop(process)
                    bar.update()
                    if process.returncode:
                        failed.append((run, _last_line(Path(str(run.out)) / LOG)))
    finally:
        for process in running:
            process.terminate()
    return failed


def _arguments(options: Any) -> list[str]:
    """The command line that gives these options."""
    arguments = []
    for field in dataclasses.fields(options):
        value = getattr(options, field.name)
        name = f"--{field.name.replace('_', '-')}"
        if dataclasses.is_dataclass(value):
            arguments += _arguments(value)
        elif value is True:
            arguments.append(name)
        elif isinstance(value, tuple):
            arguments += [name, *value] if value else []
        elif value not in (None, False):
            arguments += [name, str(value)]
    return arguments


def _start(run: TrainOptions) -> subprocess.Popen:
    folder = Path(str(run.out))
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / LOG).open("a") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "neurosym_jax", "train", *_arguments(run)],
            stdout=log,
            stderr=subprocess.STDOUT,
            # One thread each: as fast at these sizes, and the same bits wherever it runs.
            env={**os.environ, "NPROC": "1"},
        )


def _last_line(log: Path) -> str:
    lines = log.read_text().split("\n")
    return next((line for line in reversed(lines) if line.strip()), "no word of why")


def _test(options: SweepOptions, runs: Sequence[TrainOptions]) -> list[dict[str, Any]]:
    """Evaluate the models on their own test splits; rows as evaluate's, with `run`."""
    path = options.out / "sweep.json"
    of_path = {str(Path(str(run.out)) / "model"): run for run in runs}
    cases = make_cases(functools.partial(open_source, options.data), list(of_path))
    rows, _, errors = evaluate_cases(cases, Settings())
    for row in rows:
        run = of_path.get(row["checkpoint"])
        row["run"] = run and {
            "model": "sgan" if run.model == "sgan" else run.variant,
            "weighting": None if run.model == "sgan" else run.weighting,
            "recipe": run.recipe,
            "training": to_json(recipe(run)),
            "seed": run.seed,
            "validation": _facts(run)["validation"],
        }
    write_json(path, {"format": FORMAT, "rows": rows})
    write_errors(options.out, rows, errors)
    for name, run in of_path.items():
        lengths = (run.scene, run.obs_len, run.pred_len)
        own = [
            row
            for row in rows
            if (row["scene"], row["obs_len"], row["pred_len"]) == lengths
            and row["checkpoint"] in (None, name)
        ]
        write_card(Path(name), _facts(run), own)
    return rows


def _facts(run: TrainOptions) -> dict[str, Any]:
    return json.loads((Path(str(run.out)) / RUN).read_text())
