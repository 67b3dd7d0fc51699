"""Evaluate models beside baselines: tables, figures, JSON."""

import contextlib
import dataclasses
import functools
import shutil
import sys
import textwrap
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from neurosym_jax.configuration import Count, Seed, refuse
from neurosym_jax.data.published import data_folder
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions, describe_readings
from neurosym_jax.data.sources import Source, open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import SYMBOLS, metric_names
from neurosym_jax.evaluation.plan import (
    PROTOCOLS,
    ProtocolName,
    load_models,
    load_tests,
    make_plan,
    one_of_each,
)
from neurosym_jax.evaluation.report import check_report, evaluate_into
from neurosym_jax.evaluation.results import Result, Row, Settings, rows_frame
from neurosym_jax.evaluation.saved_forecasts import check_forecasts_file, save_forecasts
from neurosym_jax.evaluation.summary import assumptions, conclusion, lines_of, means_of
from neurosym_jax.evaluation.tables import Style, format_table, notes, text_tables
from neurosym_jax.evaluation.test_sets import BASELINES, Test
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_places import find_model
from neurosym_jax.runtime.environment import provenance
from neurosym_jax.runtime.executor import executor

__all__ = ["Options", "run"]

_SECONDS = ("loading", "compiling", "evaluating")


def _named(metavar: str) -> Any:  # Its help says what the default does.
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="")


@dataclasses.dataclass(frozen=True)
class Options:
    """Evaluate models beside constant-velocity baselines: tables, figures, JSON.

    Without arguments: one SGAN and one NeuroSyM that ship, on the embedded simulations.
    """

    checkpoint: Annotated[tuple[str, ...], _named("PATH ...")] = ()
    """Models to evaluate: folder, .pt file or name (see `neurosym models`), or `recommended`; of a
    folder, those that match. Default: one shipped model without symbols and one with."""
    all: bool = False
    """Evaluate every shipped model that matches the data set and horizon."""
    data: Annotated[Path | None, _named("PATH")] = None
    """Recording of any format in docs/data.md, a folder of them, or ETH/UCY as SGAN arranges it;
    default: the downloaded collection that has the data set, else the embedded simulations."""
    dataset: Annotated[str | None, _named("NAME")] = None
    """Data set to test on (eth, hotel, ..., or a file's name); default: the one that was held out
    of a model's training, else all."""
    test_on: Annotated[tuple[str, ...], _named("NAME ...")] = ()
    """Recordings to test on, by file name, as one test set; models are not checked for having been
    trained on them."""
    read: Annotated[ReadOptions, tyro.conf.OmitArgPrefixes] = AS_IT_SAYS
    """How files are read."""
    obs_len: Annotated[int | None, _named("INT")] = None
    """Number of observed steps; default: the model's, else 8."""
    pred_len: Annotated[int | None, _named("INT")] = None
    """Number of steps to forecast; default: the model's, else 8."""
    period: float = 0.4
    """Seconds between steps; recordings with other steps are resampled."""
    samples: int = 20
    """Number of forecasts of each scene, k."""
    seed: int = 0
    """Random seed of the noise."""
    seeds: int = 1
    """Number of noise seeds, starting at --seed; metrics are averaged over them."""
    protocol: ProtocolName = "sgan"
    """sgan: scenes of two people or more, means over people. joint-metrics (Joint Metrics Matter):
    8 + 12 steps, scenes of one person or more, means over scenes."""
    min_agents: Annotated[int | None, _named("INT")] = None
    """Minimum number of people in a scene; default: the protocol's."""
    baselines: Annotated[tuple[str, ...] | None, _named("NAME ...")] = None
    """Forecasters to evaluate beside the models; default: constant velocity and, with --checkpoint
    or --all, its sampled form and the anchor table of the test set."""
    metrics: Annotated[tuple[str, ...], _named("NAME ...")] = ()
    """Further metrics by name, see docs/metrics.md, or `all` but those of --symbols."""
    symbols: bool = False
    """Add the scores of forecast symbols and events."""
    collisions: bool = True
    """Compute the collision rate, which takes time quadratic in people."""
    table: Style = "text"
    """Format of the printed tables; csv, markdown and latex go alone to the standard output."""
    json: Path = Path("results/evaluation.json")
    """File of the report; rows are kept beside it, in .jsonl, as they come."""
    resume: bool = False
    """Keep the rows that an interrupted run left in .jsonl, and evaluate the others."""
    figures: bool = True
    """Draw figures."""
    plots: Path = Path("results/figures")
    """Folder of the figures; or a prefix of their names that ends in .png, .pdf or .svg."""
    save_forecasts: Annotated[Path | None, _named("FILE")] = None
    """Also write all forecasts, as .npz or .ndjson (TrajNet++), a file for each model."""
    jobs: Annotated[int | None, _named("INT")] = None
    """Number of processes, each of one thread, that evaluate test sets in parallel; default: one
    process with a thread for each core."""
    cluster: Annotated[str | None, _named("ADDRESS")] = None
    """Address of a Dask scheduler whose workers evaluate test sets in parallel."""


def run(options: Options) -> list[Row]:
    """Evaluate, print and write as `options` say; returns the rows of the report.

    Raises:
        InputError: for data, checkpoints or options that cannot be used.
    """
    _validate(options)
    start = time.perf_counter()
    source, models = _models(options)
    chosen = bool(options.checkpoint) or options.all
    tests = _tests(options, source, models, start)
    further = (*options.metrics, *(SYMBOLS if options.symbols else ()))
    settings = Settings(
        options.samples,
        options.seed,
        metric_names(further, collisions=options.collisions),
        options.seeds,
        PROTOCOLS[options.protocol].by_scene,
    )
    about = "" if chosen else source.about
    show = functools.partial(_show, [about] if about else [], whole=chosen or bool(further))
    parallel = options.jobs is not None or options.cluster is not None
    with executor(options.jobs, options.cluster) if parallel else contextlib.nullcontext() as pool:
        rows, results = evaluate_into(
            options.json,
            tests,
            settings,
            resume=options.resume,
            pool=pool,
            facts={"protocol": options.protocol, "provenance": _provenance(tests)},
            show=show if options.table == "text" else None,
        )
    said = [*_print_rest(options, tests, rows, means=chosen), *assumptions(models)]
    if not any(row["checkpoint"] for row in rows):
        said += ["No model was given, or none matches: these are the baselines."]
    elif not chosen:
        text = conclusion(lines_of(rows), tests[0].windows.period, simulated=bool(source.name))
        width = min(100, shutil.get_terminal_size().columns)
        said += [textwrap.fill(text, width, break_on_hyphens=False)]
    said += ["", *_write_files(options, tests, rows, results, overview=not chosen)]
    said += [f"rows: {options.json}"]
    if chosen:
        spent = {name: sum(row[f"seconds_{name}"] for row in rows) for name in _SECONDS}
        said += [f"seconds: {', '.join(f'{spent[name]:.1f} {name}' for name in _SECONDS)}"]
    else:
        said += [f"next: {_next(source)}"]
    print("\n".join(said), file=sys.stdout if options.table == "text" else sys.stderr)
    return rows


def _models(options: Options) -> tuple[Source, list[tuple[str, Model]]]:
    """The source of recordings, and the models: as given, all that ship, or one of each kind."""

    def source_of(own: str | None) -> Source:
        return open_source(options.data, options.dataset, own, options.read, options.period)

    asked = _lengths(options)["pred_len"]
    models = load_models(options.checkpoint, source_of, options.dataset, asked)
    source = source_of(models[0][1].dataset if options.checkpoint else None)
    if options.checkpoint or options.all:
        return source, models
    return source, one_of_each(source, models, dataset=options.dataset, **_lengths(options))


def _lengths(options: Options) -> dict[str, int | None]:
    """`obs_len` and `pred_len` as asked for, or as the protocol fixes them."""
    protocol = PROTOCOLS[options.protocol]
    return {name: protocol.steps(name, getattr(options, name)) for name in ("obs_len", "pred_len")}


def _tests(
    options: Options, source: Source, models: list[tuple[str, Model]], start: float
) -> list[Test]:
    """The test sets, read; the first one's seconds count from `start`."""
    baselines, least = options.baselines, options.min_agents
    if baselines is None and not (options.checkpoint or options.all):
        baselines = BASELINES[:1]
    plan = make_plan(
        source,
        models,
        dataset=options.dataset,
        test_on=options.test_on,
        **_lengths(options),
        baselines=baselines,
        samples=options.samples,
        # A folder of models, or what ships, is not named model by model.
        only_matching=len(models) != len(options.checkpoint),
    )
    least = PROTOCOLS[options.protocol].min_agents if least is None else least
    return load_tests(source, plan, test_on=options.test_on, min_agents=least, start=start)


def _provenance(tests: list[Test]) -> dict[str, Any]:
    models = [find_model(path) for test in tests for path, _ in test.entries if path]
    files = [how.file for test in tests for how in test.windows.reading if how.file]
    return provenance(files, models)


def _show(before: list[str], rows: Sequence[Row], *, whole: bool) -> None:
    """Print the table of a test set as soon as it is there, and `before` the first one."""
    while before:
        print(f"{before.pop()}\n")
    print(text_tables(lines_of(rows), whole=whole))


def _print_rest(options: Options, tests: list[Test], rows: list[Row], *, means: bool) -> list[str]:
    """Print the tables that are not printed yet; returns the lines to print below."""
    if options.table != "text":
        print(format_table(rows_frame(rows), options.table))
        return []
    lines = lines_of(rows)
    if means and (over_sets := means_of(lines)):
        print(text_tables(over_sets))
    read = describe_readings(how for test in tests for how in test.windows.reading)
    return [*notes(lines), "", *([read, ""] if read else [])]


def _write_files(
    options: Options, tests: list[Test], rows: list[Row], results: list[Result], *, overview: bool
) -> list[str]:
    """Write figures and forecasts; returns a line for each kind of file."""
    said = []
    if options.figures and len(results) < len(rows):
        said += ["figures: none of test sets with rows of an earlier run"]
    if options.figures and results:
        from neurosym_jax.plotting.evaluation import draw_figures

        before = {*options.plots.glob("*"), *options.plots.parent.glob("*")}
        drawn = draw_figures(options.plots, results, together=overview)
        replaced = len(before.intersection(drawn))
        note = f", {replaced} of them replaced" if replaced else ""
        several = f"figures: {len(drawn)} in {drawn[0].parent}{note}"
        said += [f"figure: {drawn[0]}" if len(drawn) == 1 else several]
    if options.save_forecasts:
        for path in save_forecasts(options.save_forecasts, tests, options.samples, options.seed):
            said += [f"forecasts: {path}"]
    return said


def _next(source: Source) -> str:
    """The next command to try."""
    if not source.name:
        return "neurosym evaluate --all, for every model that ships, or --help"
    real = "neurosym evaluate --data eth-ucy"
    return real if (data_folder() / "eth-ucy").is_dir() else f"neurosym download eth-ucy && {real}"


def _validate(options: Options) -> None:
    """Refuse, before any work, options that cannot be used and files that cannot be written."""
    counts = ("samples", "seeds", "min_agents", "obs_len", "pred_len", "jobs")
    refuse(Count, {f"--{name.replace('_', '-')}": getattr(options, name) for name in counts})
    for seed, of in ((0, "--seed"), (options.seeds - 1, "--seed and --seeds: the last seed")):
        refuse(Seed, {of: options.seed + seed})
    if not (options.checkpoint or options.baselines or options.baselines is None):
        raise InputError("neither --checkpoint nor --baselines: there is nothing to evaluate")
    check_report(options.json)
    if options.figures:
        from neurosym_jax.plotting.evaluation import check_figures

        check_figures(options.plots)
    if options.save_forecasts:
        check_forecasts_file(options.save_forecasts)
