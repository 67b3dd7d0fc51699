"""Test models beside the baselines: tables, figures, JSON."""

import dataclasses
import functools
import json
import shutil
import sys
import textwrap
import time
from pathlib import Path
from typing import Annotated, Any

import tyro

from neurosym_jax.configuration import refuse_below, refuse_seed
from neurosym_jax.data.inspection import describe_readings
from neurosym_jax.data.provenance import Reading
from neurosym_jax.data.published import data_folder
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.sources import Source, open_source
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.cluster import evaluator
from neurosym_jax.evaluation.conclusion import conclusion
from neurosym_jax.evaluation.load import Test, files_read, load_tests
from neurosym_jax.evaluation.metrics import metric_names
from neurosym_jax.evaluation.plan import BASELINES, make_plan, one_of_each
from neurosym_jax.evaluation.protocols import PROTOCOLS, ProtocolName
from neurosym_jax.evaluation.report import check_replaceable, format_table, show_tables
from neurosym_jax.evaluation.rows import evaluate_into
from neurosym_jax.evaluation.run import Result, Row, Settings
from neurosym_jax.evaluation.saved_forecasts import check_forecasts_file, save_forecasts
from neurosym_jax.evaluation.summary import lines_of, means_of
from neurosym_jax.evaluation.symbol_tests import score_symbols
from neurosym_jax.evaluation.tables import Style, notes
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import find_checkpoints, find_model, shipped_models
from neurosym_jax.plotting.evaluation import check_figures, draw_figures, draw_overview
from neurosym_jax.runtime.files import write_json
from neurosym_jax.runtime.processes import ALONE, Processes, is_first, join
from neurosym_jax.runtime.progress import without_bars
from neurosym_jax.runtime.provenance import provenance
from neurosym_jax.symbolic.futures import SymbolSettings

__all__ = ["Options", "run"]


def _named(metavar: str, **more: Any) -> Any:  # Its text says what happens without it.
    return tyro.conf.arg(metavar=metavar, help_behavior_hint="", **more)


@dataclasses.dataclass(frozen=True)
class Options:
    """Evaluate checkpoints beside the constant-velocity baselines: tables, figures, JSON.

    With no arguments: one SGAN and one NeuroSyM that ship, on the embedded simulations.
    """

    checkpoint: Annotated[tuple[str, ...], _named("PATH ...")] = ()
    """Models by folder, .pt file or name (see `neurosym models`), in one table; a folder of several
    stands for those that fit. Default: one SGAN and one NeuroSyM that ship, where they belong."""
    all: bool = False
    """Every model that ships, as far as it fits what is asked for."""
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
    seeds: int = 1
    """Draw the noise anew for so many seeds, from --seed on: means, and how much they spread."""
    protocol: ProtocolName = "sgan"
    """sgan: scenes of two people or more, means over people. joint-metrics, of Joint Metrics
    Matter: 8 + 12 steps, scenes of one person or more, means over scenes."""
    min_agents: Annotated[int | None, _named("INT")] = None
    """Scenes with fewer people are left out; default: the protocol's."""
    baselines: Annotated[tuple[str, ...] | None, _named("NAME ...")] = None
    """Forecasters without parameters to test beside the models, also those of a plugin; default:
    constant velocity and, where models are chosen, its sampled sibling."""
    table: Style = "text"
    """How tables are printed; csv, markdown and latex go alone to the standard output."""
    json: Path = Path("results/evaluation.json")
    """File for the rows, written as they come."""
    resume: bool = False
    """Keep the rows that an interrupted run left in --json, and evaluate what is missing."""
    plots: Path = Path("results/figures")
    """Folder for the figures; or a name that ends in .png, .pdf or .svg, which they begin with."""
    save_forecasts: Annotated[Path | None, _named("FILE")] = None
    """Write all forecasts, too: .npz, .csv or .ndjson (TrajNet++), a file for each model."""
    figures: bool = True
    """Draw figures."""
    metrics: Annotated[tuple[str, ...], _named("NAME ...")] = ()
    """Metrics to compute and show beside those of every table, also those of a plugin: by name, see
    docs/evaluate.md, or `all`."""
    collisions: bool = True
    """Compute the collision rate, and what else is quadratic in people."""
    symbols: bool = False
    """Score forecasts of symbols and events, too; see docs/symbolic_forecast.md."""
    cluster: Annotated[str | None, _named("ADDRESS")] = None
    """A Dask scheduler whose workers take a test set each; see docs/scaling.md."""
    processes: Processes = ALONE
    """Several processes that share each test set; see docs/scaling.md."""


def run(options: Options) -> list[Row]:
    """Evaluate, print and write what `options` ask for; returns the rows of the JSON.

    Raises:
        InputError: for data, checkpoints or options that cannot be used.
    """
    join(options.processes)  # First, so that the others learn of what is refused.
    _validate(options)
    start = time.perf_counter()
    source, models = _models(options)
    chosen = bool(options.checkpoint) or options.all
    tests = _tests(options, source, models, start)
    settings = Settings(
        options.samples,
        options.seed,
        metric_names(options.metrics, costly=options.collisions),
        options.seeds,
        PROTOCOLS[options.protocol].scenes_alike,
    )
    whole = chosen or bool(options.metrics)
    rows, results = evaluate_into(
        options.json,
        tests,
        settings,
        resume=options.resume,
        each=evaluator(options.cluster),
        facts={"protocol": options.protocol, "provenance": _provenance(tests)},
        show=functools.partial(_show, about="" if chosen else source.about, whole=whole)
        if options.table == "text"
        else None,
    )
    if not is_first():
        return rows
    said = _print_rest(options, rows, means=chosen)
    if not any(row["checkpoint"] for row in rows):
        said += ["No model was named, or none fits: these are the baselines."]
    elif not chosen:
        text = conclusion(lines_of(rows), tests[0].windows.period, simulated=bool(source.name))
        said += [textwrap.fill(text, min(100, shutil.get_terminal_size().columns))]
    said += ["", *_write_files(options, tests, rows, results, overview=not chosen)]
    said += [f"rows: {options.json}"]
    if chosen:
        spent = {name: sum(row["seconds"][name] for row in rows) for name in rows[0]["seconds"]}
        parts = [f"{spent[name]:.1f} {name}" for name in ("loading", "compiling", "evaluating")]
        said += [f"seconds: {', '.join(parts)}"]
    else:
        said += [f"next: {_next(source)}"]
    print("\n".join(said), file=sys.stdout if options.table == "text" else sys.stderr)
    if options.symbols:
        _score_symbols(options, source, tests)
    return rows


def _score_symbols(options: Options, source: Source, tests: list[Test]) -> None:
    """Tell how good forecasts of symbols and events are, and add it to the JSON."""
    found = []
    for test in tests:
        # What was named goes before the baselines; of one name, the path tells them apart.
        entries = sorted(test.entries, key=lambda entry: entry[0] is None)
        names = [model.name for _, model in entries]
        models = {
            str(path) if names.count(model.name) > 1 else model.name: model
            for path, model in entries
        }
        how = SymbolSettings(test.windows.period)
        noise = {"samples": options.samples, "seed": options.seed}
        text, row = score_symbols(source, test.test_set, models, how, **noise)
        print(f"\n{text}", file=sys.stdout if options.table == "text" else sys.stderr)
        found.append({**row, "obs_len": test.test_set.obs_len, "pred_len": test.test_set.pred_len})
    write_json(options.json, json.loads(options.json.read_text()) | {"symbols": found})


def _models(options: Options) -> tuple[Source, list[tuple[str, Model]]]:
    """Where recordings come from, and what is tested: as given, all that ship, or one of each."""
    paths = find_checkpoints(options.checkpoint) or list(map(str, shipped_models()))
    models = [(path, load_model(path)) for path in paths]
    own = models[0][1].dataset if options.checkpoint else None
    source = open_source(options.data, options.dataset, own, options.read, options.period)
    if options.checkpoint or options.all:
        return source, models
    return source, one_of_each(source, models, dataset=options.dataset, **_lengths(options))


def _lengths(options: Options) -> dict[str, int | None]:
    """The steps that are asked for, or that the protocol fixes."""
    protocol = PROTOCOLS[options.protocol]
    return {name: protocol.steps(name, getattr(options, name)) for name in ("obs_len", "pred_len")}


def _tests(
    options: Options, source: Source, models: list[tuple[str, Model]], start: float
) -> list[Test]:
    """What is tested, read; the first test set's seconds count from `start`."""
    baselines, least = options.baselines, options.min_agents
    if baselines is None:
        baselines = BASELINES if options.checkpoint or options.all else BASELINES[:1]
    plan = make_plan(
        source,
        models,
        dataset=options.dataset,
        test_on=options.test_on,
        **_lengths(options),
        baselines=baselines,
        # Of a folder, or of what ships, those that fit what is asked for.
        as_far_as_they_fit=len(models) != len(options.checkpoint),
    )
    least = PROTOCOLS[options.protocol].min_agents if least is None else least
    return load_tests(source, plan, test_on=options.test_on, min_agents=least, start=start)


def _provenance(tests: list[Test]) -> dict[str, Any]:
    models = [find_model(path) for test in tests for path, _ in test.entries if path]
    return provenance(files_read(tests), models)


def _show(rows: list[Row], first: bool, about: str, whole: bool) -> None:
    """Print the table of one test set as soon as it is there, before the first `about` it."""
    from rich.console import Console

    with without_bars():
        if about and first:
            print(f"{about}\n")
        show_tables(lines_of(rows), Console(), whole=whole)


def _print_rest(options: Options, rows: list[Row], *, means: bool) -> list[str]:
    """Print what the tables so far lack; returns what is to be said below."""
    if options.table != "text":
        print(format_table(rows, options.table))
        return []
    from rich.console import Console

    lines, console = lines_of(rows), Console()
    if means:
        show_tables(means_of(lines), console)
    readings = (Reading(**how) for row in rows for how in row["recordings"])
    read = describe_readings(readings)
    return [*notes(lines, bold=console.is_terminal), "", *([read, ""] if read else [])]


def _write_files(
    options: Options, tests: list[Test], rows: list[Row], results: list[Result], *, overview: bool
) -> list[str]:
    """Write figures and forecasts; returns a line for each kind of file."""
    said = []
    if options.figures and len(results) < len(rows):
        said += ["figures: none of the test sets whose rows an earlier run left, or some of them"]
    if options.figures and results:
        before = {*options.plots.glob("*"), *options.plots.parent.glob("*")}
        drawn = (draw_overview if overview else draw_figures)(options.plots, results)
        replaced = len(before.intersection(drawn))
        note = f", {replaced} of them replaced" if replaced else ""
        several = f"figures: {len(drawn)} in {drawn[0].parent}{note}"
        said += [f"figure: {drawn[0]}" if len(drawn) == 1 else several]
    if options.save_forecasts:
        for path in save_forecasts(options.save_forecasts, tests, options.samples, options.seed):
            said += [f"forecasts: {path}"]
    return said


def _next(source: Source) -> str:
    """The command to go on with."""
    if not source.name:
        return "neurosym evaluate --all, for every model that ships, or --help"
    real = "neurosym evaluate --data eth-ucy"
    return real if (data_folder() / "eth-ucy").is_dir() else f"neurosym download eth-ucy && {real}"


def _validate(options: Options) -> None:
    """Refuse, before the work and not after it, what cannot be evaluated or written."""
    counts = ("samples", "seeds", "min_agents", "obs_len", "pred_len")
    refuse_below(1, {f"--{name.replace('_', '-')}": getattr(options, name) for name in counts})
    for seed, of in ((0, "--seed"), (options.seeds - 1, "--seed and --seeds: the last seed")):
        refuse_seed(options.seed + seed, of)
    if not (options.checkpoint or options.baselines or options.baselines is None):
        raise InputError("neither --checkpoint nor --baselines: there is nothing to evaluate")
    if options.symbols and options.test_on:
        raise InputError("--symbols learns from a dataset's training scenes; --test-on has none")
    check_replaceable(options.json)
    if options.figures:
        check_figures(options.plots)
    if options.save_forecasts:
        check_forecasts_file(options.save_forecasts)
