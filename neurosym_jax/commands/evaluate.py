"""Test models beside the baselines: tables, figures, JSON."""

import dataclasses
import time
from pathlib import Path
from typing import Annotated, Any

import tyro

from neurosym_jax.checks import refuse_below, refuse_seed
from neurosym_jax.data.inspection import describe_readings
from neurosym_jax.data.provenance import Reading
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.sources import open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.load import load_tests
from neurosym_jax.evaluation.metrics import metric_names
from neurosym_jax.evaluation.plan import BASELINES, make_plan
from neurosym_jax.evaluation.report import check_replaceable, format_table
from neurosym_jax.evaluation.rows import evaluate_into
from neurosym_jax.evaluation.run import Row, Settings
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import find_checkpoints, shipped_models
from neurosym_jax.plotting.evaluation import draw_figures
from neurosym_jax.runtime.processes import ALONE, Processes, is_first, join

__all__ = ["Options", "run"]


def _named(metavar: str, **more: Any) -> Any:
    """How `--help` shows an option whose text says what happens without it."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="", **more)


@dataclasses.dataclass(frozen=True)
class Options:
    """Evaluate checkpoints beside the constant-velocity baselines: tables, figures, JSON.

    With no arguments: what ships in checkpoints/, on the embedded simulations.
    """

    checkpoint: Annotated[tuple[str, ...], _named("PATH ...")] = ()
    """Models by folder, .pt file or name (see `neurosym models`), in one table; a folder of several
    stands for all of them. Default: those that ship."""
    data: Annotated[Path | None, _named("PATH")] = None
    """A recording of any format in docs/data.md, a folder of them, or ETH/UCY as SGAN arranges it;
    default: what was downloaded and has the dataset, else the embedded simulations."""
    dataset: Annotated[str | None, _named("NAME", aliases=["--scene"])] = None
    """One dataset (eth, hotel, ..., or a file's name); default: a checkpoint's own, else all."""
    test_on: Annotated[tuple[str, ...], _named("NAME ...")] = ()
    """Recordings by file name, taken as one test set, whatever a checkpoint was trained for."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""
    obs_len: Annotated[int | None, _named("INT")] = None
    """Observed steps; default: the checkpoint's, else 8."""
    pred_len: Annotated[int | None, _named("INT")] = None
    """Steps to forecast; default: the checkpoint's, else 8."""
    period: float = 0.4
    """Seconds between steps; recordings that have others are resampled."""
    samples: int = 20
    """Forecasts of each scene, k."""
    seed: int = 0
    """Determines, with the scene and the sample, the noise."""
    min_agents: int = 2
    """Scenes with fewer people are left out; SGAN's protocol keeps scenes of at least two."""
    baselines: tuple[str, ...] = BASELINES
    """Forecasters without parameters to test beside the checkpoints, also those of a plugin."""
    json: Path = Path("results/evaluation.json")
    """File for the rows, written as they come."""
    resume: bool = False
    """Keep the rows that an interrupted run left in --json, and evaluate what is missing."""
    plots: Path = Path("results/figures")
    """Folder for the figures."""
    figures: bool = True
    """Draw figures."""
    metrics: Annotated[tuple[str, ...], _named("NAME ...")] = ()
    """Metrics to compute and show beside those of every table, also those of a plugin: by name, see
    docs/evaluate.md, or `all`."""
    collisions: bool = True
    """Compute the collision rate, and what else is quadratic in people."""
    processes: Processes = ALONE
    """Several processes that share the work, on one machine or many; see docs/scaling.md."""


def run(options: Options) -> list[Row]:
    """Evaluate, print and write what `options` ask for; returns the rows of the JSON.

    Raises:
        InputError: for data, checkpoints or options that cannot be used.
    """
    join(options.processes)  # First, so that the others learn of what is refused.
    _validate(options)
    start = time.perf_counter()
    paths = find_checkpoints(options.checkpoint) or list(map(str, shipped_models()))
    models = [(path, load_model(path)) for path in paths]
    own = models[0][1].dataset if options.checkpoint else None
    source = open_source(options.data, options.dataset, own, options.read, options.period)
    plan = make_plan(
        source,
        models,
        dataset=options.dataset,
        test_on=options.test_on,
        obs_len=options.obs_len,
        pred_len=options.pred_len,
        baselines=options.baselines,
        as_far_as_they_fit=not options.checkpoint,
    )
    tests = load_tests(
        source, plan, test_on=options.test_on, min_agents=options.min_agents, start=start
    )
    metrics = metric_names(options.metrics, costly=options.collisions)
    settings = Settings(options.samples, options.seed, metrics)
    rows, results = evaluate_into(options.json, tests, settings, resume=options.resume)
    if not is_first():
        return rows
    print(format_table(rows))
    readings = (Reading(**how) for row in rows for how in row["recordings"])
    if text := describe_readings(readings):
        print(f"\n{text}")
    if not any(row["checkpoint"] for row in rows):
        print("\nNo checkpoint was given and none that ships fits: these are the baselines.")
    spent = {name: sum(row["seconds"][name] for row in rows) for name in rows[0]["seconds"]}
    print(
        f"\nseconds: {spent['loading']:.1f} loading, {spent['compiling']:.1f} compiling, "
        f"{spent['evaluating']:.1f} evaluating\nrows: {options.json}"
    )
    if options.figures and len(results) < len(rows):
        print("figures: none of the test sets whose rows an earlier run left, or some of them")
    if options.figures and results:
        before = set(options.plots.glob("*.png"))
        drawn = draw_figures(options.plots, results)
        replaced = len(before.intersection(drawn))
        note = f", {replaced} of them replaced" if replaced else ""
        print(f"figures: {len(drawn)} in {options.plots}{note}")
    return rows


def _validate(options: Options) -> None:
    """Refuse, before the work and not after it, what cannot be evaluated or written."""
    counts = ("samples", "min_agents", "obs_len", "pred_len")
    refuse_below(1, {f"--{name.replace('_', '-')}": getattr(options, name) for name in counts})
    refuse_seed(options.seed, "--seed")
    metric_names(options.metrics)
    if not (options.checkpoint or options.baselines):
        raise InputError("neither --checkpoint nor --baselines: there is nothing to evaluate")
    check_replaceable(options.json)
    if options.figures and options.plots.exists() and not options.plots.is_dir():
        raise InputError(f"{options.plots}: is not a folder, so no figures can be written into it")
