"""Evaluate models beside baselines: tables, figures, JSON."""

import contextlib
import dataclasses
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

from neurosym_jax.commands._options import (
    Reading,
    flag_names,
    given,
    open_data,
    refuse_unused,
)
from neurosym_jax.configuration import Count, Seed, refuse
from neurosym_jax.data.recordings import EthUcy, Source, Synthetic
from neurosym_jax.data.tables import AS_IT_SAYS
from neurosym_jax.data.tracks import Reading as DataReading
from neurosym_jax.data.tracks import describe_readings
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation import compare, metrics, saved_forecasts, tables
from neurosym_jax.evaluation.compare import (
    Row,
    Settings,
    add_forecasts,
    evaluate_tests,
    test_of_file,
    with_tests,
)
from neurosym_jax.evaluation.forecasts import ForecastFile, read_named
from neurosym_jax.evaluation.tables import rows_frame
from neurosym_jax.models.disk import (
    RECOMMENDED,
    find_model,
    find_models,
    load_model,
    shipped_models,
    shipped_name,
    state_of_run,
)
from neurosym_jax.models.forecast import Model
from neurosym_jax.runtime.process import provenance
from neurosym_jax.runtime.workers import map_for

__all__ = ["Options", "run"]


Models = Sequence[tuple[str, Model]]
"""Models by the paths that find them, see `models.disk.find_models`."""
Tests = Sequence[compare.Test]


class Protocol(NamedTuple):
    """What a published protocol of evaluation fixes."""

    min_agents: int  # scenes with fewer people are left out
    by_scene: bool  # whether means weigh each scene the same, instead of each person
    lengths: dict[str, int]  # observed and forecast steps, where it fixes them


PROTOCOLS = {
    "sgan": Protocol(2, False, {}),
    "joint-metrics": Protocol(1, True, {"obs_len": 8, "pred_len": 12}),
}
"""SGAN's (Gupta et al., CVPR 2018); and that of E. Weng, H. Hoshino, D. Ramanan and K. Kitani,
"Joint Metrics Matter", ICCV 2023."""


AFTER_THE_FIRST_RUN = """
ADE is the mean error of the positions in metres, FDE the error at the last
step. Constant velocity makes one guess, the networks make {}, and the best one
counts. These people are simulated, and so are those the networks learned from:
the numbers say nothing about real people. Next:

    neurosym evaluate --data my_tracks.csv --model recommended"""


@dataclasses.dataclass(frozen=True)
class Options:
    """Evaluate models beside constant-velocity baselines: tables, figures, JSON.

    Without arguments: one SGAN and one NeuroSyM that ship, on the embedded simulations.
    """

    RENAMED: ClassVar[dict[str, str]] = {"checkpoint": "model"}
    FIRST: ClassVar[str] = "data dataset model all pred_len samples metrics table"
    GROUPS: ClassVar[dict[str, str]] = {
        "data": "data dataset pred_len obs_len period test_on min_agents read",
        "model": "model all samples baselines forecasts partial label",
        "output": "metrics table intervals symbols json "
        "figures plots scene style save_forecasts",
    }
    model: tuple[str, ...] = ()
    """Models to evaluate: folder, .pt file or name (see `neurosym models`); of a folder of models,
    those that match. Default: `recommended` for recordings, SGAN and NeuroSyM for simulations."""
    forecasts: tuple[Path, ...] = ()
    """Files of forecasts to evaluate, .npz, .csv or TrajNet++'s .ndjson, see docs/evaluate.md; without
    --data on the windows that the first of them holds."""
    partial: bool = False
    """Leave out windows that not all files of --forecasts have."""
    label: tuple[str, ...] = ()
    """Names for tables, NAME=PATH, of models or forecasts."""
    all: bool = False
    """Every shipped model that matches the data set and horizon."""
    data: Path | None = None
    """Recording of any format in docs/data.md, a folder of them, or ETH/UCY as SGAN arranges it;
    default: the downloaded collection that has the data set, else the embedded simulations."""
    dataset: str | None = None
    """Data set to test on (eth, hotel, ..., or a file's name); default: the one that was held out
    of a model's training, else all."""
    test_on: tuple[str, ...] = ()
    """Recordings to test on, by file name, as one test set, whatever models were trained on."""
    read: Reading = AS_IT_SAYS
    """How files are read."""
    obs_len: int | None = None
    """Number of observed steps; default: the model's, else 8."""
    pred_len: int | None = None
    """Number of steps to forecast; default: the model's, else 8."""
    period: float = 0.4
    """Seconds between steps; recordings with other steps are resampled."""
    samples: int = 20
    """Number of forecasts of each scene, k."""
    seed: int = 0
    """Random seed of the noise."""
    seeds: int = 1
    """Number of noise seeds, starting at --seed; metrics are averaged over them."""
    protocol: Literal["sgan", "joint-metrics"] = "sgan"
    """sgan: scenes of two people or more, means over people. joint-metrics (Joint Metrics Matter):
    8 + 12 steps, scenes of one person or more, means over scenes."""
    min_agents: int | None = None
    """Minimum number of people in a scene; default: the protocol's."""
    baselines: tuple[str, ...] | None = None
    """Forecasters to evaluate beside the models; default: constant velocity, its sampled form and
    the anchor table that ships; without arguments constant velocity alone."""
    metrics: tuple[str, ...] = ()
    """Further metrics by name, see docs/evaluate.md, or `all` but those of --symbols."""
    symbols: bool = False
    """Add the scores of forecast symbols and events."""
    collisions: bool = True
    """Compute the collision rate, which takes time quadratic in people."""
    table: tables.Style = "text"
    """Format of the printed tables; csv, markdown and latex go alone to the standard output."""
    intervals: bool = False
    """Add intervals to the LaTeX table, which then needs more than one column of a paper."""
    json: Path = Path("results/evaluation.json")
    """File of the report; rows are kept beside it, in .jsonl, as they come."""
    figures: bool = True
    """Draw figures."""
    plots: Path = Path("results/figures")
    """Folder of the figures; or a prefix of their names that ends in .png, .pdf or .svg."""
    scene: int | None = None
    """Index of the scene that figures show; default: one that is harder than nine of ten."""
    style: Literal["paper", "talk"] = "paper"
    """Look of the figures; a talk's have larger letters and lines."""
    save_forecasts: Path | None = None
    """Also write forecasts, a file a model: .npz, .csv, .nc (xarray) or .ndjson (TrajNet++)."""
    cluster: str | None = None
    """Address of a Dask scheduler whose workers evaluate sets."""
    online: bool = False
    """Add a row for each model that learns the place meanwhile. It sees the past of the test place,
    scene by scene in the order of time: never compare it with other protocols."""
    place: Path | None = None
    """File of a place, see docs/place.md, with which each recording begins."""


def run(options: Options) -> list[Row]:
    """Evaluate, print and write as `options` say; returns the rows of the report."""
    _validate(options)
    default = not (options.model or options.forecasts or options.all)
    is_text = options.table == "text"
    files = read_named(options.forecasts)
    further = (*options.metrics, *(metrics.SYMBOLS if options.symbols else ()))
    models: Models = []
    source = run_tests = None
    with contextlib.ExitStack() as stack:
        recordings = options.data or options.dataset
        if files and not (recordings or options.model or options.all):
            name, file = next(iter(files.items()))
            windows = given(options)
            tests = [
                test_of_file(name, file, options.baselines, options.samples, windows)
            ]
        else:
            steps = [file.steps for file in files.values()]
            source, models, planned, least = _plan(options, steps)
            tasks = len(models) if len(planned) > 1 else 1
            # Processes start while we read.
            run_tests = stack.enter_context(map_for(tasks, options.cluster))
            tests = compare.load_tests(
                source,
                planned,
                test_on=options.test_on,
                min_agents=least,
            )
        tests = add_forecasts(tests, files, partial=options.partial)
        settings = Settings(
            options.samples,
            options.seed,
            metrics.metric_names(further, collisions=options.collisions),
            options.seeds,
            PROTOCOLS[options.protocol].by_scene,
            _labels(options, files, tests),
            options.online,
            options.place,
            options.scene,
        )
        _refuse_absent_scene(options.scene, tests)
        if is_text and default and source and source.about:
            print(f"{source.about}\n")
        tested = evaluate_tests(tests, settings, run_tests)
        results = list(compare.logged(options.json, tested))

    rows = with_tests(results)
    _write_report(options, rows, tests)
    style = {"intervals": options.intervals, "whole": not default or bool(further)}
    print(tables.format_table(rows_frame(rows), options.table, **style))
    networks = sorted(path for path, model in models if model.called)
    notes = [f"{RECOMMENDED}: {', '.join(networks)}"] if networks else []
    notes += _readings_and_models(tests, models)
    notes += _written(options, tests, results)
    if is_text and isinstance(source, Synthetic) and default:
        notes.append(AFTER_THE_FIRST_RUN.format(options.samples))
    print("\n".join(["", *notes]), file=sys.stdout if is_text else sys.stderr)
    return rows


def _readings(tests: Tests) -> list[DataReading]:
    """How each recording was read, once."""
    readings = {}
    for test in tests:
        for reading in test.windows.reading:
            readings[reading.recording] = reading
    return list(readings.values())


def _paths(tests: Tests) -> list[str]:
    """The models' paths, as given."""
    paths = []
    for test in tests:
        paths += [path for path, _ in test.entries if path]
    return paths


def _load(path: str, options: Options) -> Model:
    """A model; one that `recommended` stands for, or that is the default, is called so."""
    model = load_model(path)
    is_recommended = not options.model or RECOMMENDED in options.model
    is_named = options.all or path in options.model
    ships = path.startswith("anchors_") and not Path(path).exists()
    if is_recommended and ships and not is_named:
        return dataclasses.replace(model, called=RECOMMENDED)
    return model


def _write_report(options: Options, rows: list[Row], tests: Tests) -> None:
    readings = _readings(tests)
    recordings = [reading.file for reading in readings if reading.file]
    models = [*map(find_model, _paths(tests)), *options.forecasts]
    facts = {
        "protocol": options.protocol,
        "provenance": provenance(recordings, models),
        "recordings": [dataclasses.asdict(reading) for reading in readings],
    }
    compare.write_report(options.json, rows, facts)


def _readings_and_models(tests: Tests, models: Models) -> Iterator[str]:
    """What is said of recordings and models, a line each."""
    text = describe_readings(_readings(tests))
    if text:
        yield text
    # What torch checkpoints do not say is said once for those that agree.
    for assumed in dict.fromkeys(model.assumed for _, model in models if model.assumed):
        named = [path for path, model in models if model.assumed == assumed]
        subject = named[0] if len(named) == 1 else f"{len(named)} torch checkpoints"
        yield f"assumed of {subject}: {'; '.join(assumed)}"
    for path, model in models:
        if model.step is not None:
            yield state_of_run(path, model.step)
    if not _paths(tests) and not any(test.forecasts for test in tests):
        yield "No model was given, or none matches: these are the baselines."


def _written(
    options: Options, tests: Tests, results: Sequence[compare.Result]
) -> Iterator[str]:
    """Write figures and forecasts as `options` say, and yield a line on each file."""
    if options.figures:
        from neurosym_jax.plotting import use_style
        from neurosym_jax.plotting.evaluation import draw_figures

        use_style(options.style)
        default = not (options.model or options.forecasts or options.all)
        first, *others = draw_figures(options.plots, results, together=default)
        if others:
            yield f"figures: {1 + len(others)} in {first.parent}"
        else:
            yield f"figure: {first}"
    if options.save_forecasts:
        for path in saved_forecasts.save_forecasts(
            options.save_forecasts, tests, options.samples, options.seed
        ):
            yield f"forecasts: {path}"
    yield f"rows: {options.json}"


def prepare_arguments(arguments: Sequence[str]) -> list[str]:
    """`neurosym evaluate my_tracks.csv`: a recording in front of all options is `--data`.

    Raises:
        InputError: where `--data` names another one, of which only the last would count.
    """
    words = list(arguments)
    is_recording = bool(words) and not words[0].startswith("-")
    if not is_recording or words[0].endswith((".yaml", ".yml")):
        return words
    if "--data" in flag_names(words):
        raise InputError(f"{words[0]}: --data names a recording, too: name one of them")
    return ["--data", *words]


def _refuse_absent_scene(scene: int | None, tests: Tests) -> None:
    """Refuse a scene to show that a test set does not have.

    Raises:
        InputError: naming the first such set.
    """
    for test in tests:
        scenes = test.windows.scenes
        if scene is not None and not 0 <= scene < scenes:
            name = test.test_set.dataset
            raise InputError(
                f"--scene must lie in [0, {scenes}) for {name}, not {scene}"
            )


def _labels(
    options: Options, files: Mapping[str, ForecastFile], tests: Tests
) -> dict[str, str]:
    """Names by path: those of files of forecasts, and the ones that --label says."""
    labels = {str(file.path): name for name, file in files.items()}
    paths = {*_paths(tests), *labels}
    for label in options.label:
        name, _, path = label.partition("=")
        if not name or path not in paths:
            choices = ", ".join(sorted(paths)[:12]) or "none"
            raise InputError(
                f"--label {label}: NAME=PATH, of one of these paths: {choices}"
            )
        labels[path] = name
    return labels


def _plan(
    options: Options, steps: Sequence[int]
) -> tuple[Source, Models, dict[compare.TestSet, compare.Entries], int]:
    """The source of recordings, the models (as given, all that ship, or one or two),
    what is tested on which test set, and the least number of people of a scene.

    `steps` are those of files of forecasts, which need no model beside them.
    """
    protocol = PROTOCOLS[options.protocol]
    baselines = options.baselines
    least = options.min_agents
    lengths = {"obs_len": options.obs_len, "pred_len": options.pred_len}
    for name, has in protocol.lengths.items():
        if lengths[name] not in (None, has):
            option = f"--{name.replace('_', '-')} {lengths[name]}"
            raise InputError(
                f"{option}: the protocol has {has} (--protocol sgan has any)"
            )
    lengths |= protocol.lengths
    arguments = options.data, options.read, options.dataset, options.test_on
    source = open_data(*arguments, period=options.period)
    names = options.model
    if options.all:
        # Baselines are tested beside every model.
        shipped = (path.name for path in shipped_models())
        names = [name for name in shipped if not name.startswith(compare.TABLE)]
    if steps and not names:
        lengths["pred_len"] = lengths["pred_len"] or steps[0]
    if not steps and not names:
        names = default_models(source, options.dataset, lengths["pred_len"])
    # On ETH/UCY, `recommended` is the model of each data set.
    every_set = options.dataset is None and isinstance(source, EthUcy)
    datasets = source.scenes if every_set else (options.dataset,)
    paths = find_models(names, datasets, lengths["pred_len"])
    models = [(path, _load(path, options)) for path in paths]
    if options.model:
        source = open_data(
            *arguments, model_scene=models[0][1].dataset, period=options.period
        )
    elif baselines is None and isinstance(source, Synthetic) and not options.all:
        baselines = compare.BASELINES[:1]
    entries = compare.make_plan(
        source,
        models,
        dataset=options.dataset,
        test_on=options.test_on,
        **lengths,
        baselines=baselines,
        samples=options.samples,
        # A folder of models, or what ships, is not named model by model.
        only_matching=len(models) != len(options.model),
    )
    return source, models, entries, protocol.min_agents if least is None else least


def default_models(
    source: Source, dataset: str | None, pred_len: int | None
) -> list[str]:
    """Names of the shipped models to test where none is named: for these people, and with symbols.

    Those are SGAN and NeuroSyM on simulations, else `recommended` and, where it ships,
    NeuroSyM.
    """
    pred_len = pred_len or 8
    if isinstance(source, Synthetic):
        names = [f"{kind}_{source.name}_{pred_len}" for kind in ("sgan", "neurosym")]
    else:
        names = []
        for scene in (dataset,) if dataset else source.scenes:
            names.append(shipped_name("anchors", scene, pred_len))
            names.append(shipped_name("neurosym", scene, pred_len))
    return [name for name in dict.fromkeys(names) if find_model(name).is_dir()]


def _validate(options: Options) -> None:
    """Refuse, before any work, options that cannot be used and files that cannot be written."""
    counts = ("samples", "seeds", "min_agents", "obs_len", "pred_len")
    numbers = {f"--{name.replace('_', '-')}": getattr(options, name) for name in counts}
    refuse(Count, numbers, optional=True)
    for seed, option in (
        (0, "--seed"),
        (options.seeds - 1, "--seed and --seeds: the last seed"),
    ):
        refuse(Seed, {option: options.seed + seed})
    if not (options.model or options.forecasts or options.baselines != ()):
        raise InputError(
            "neither --model nor --baselines: there is nothing to evaluate"
        )
    if not options.forecasts:
        refuse_unused(options, ["partial"], "without --forecasts")
    if options.all:
        refuse_unused(options, ["model"], "with --all")
    if not options.online:
        refuse_unused(options, ["place"], "without --online")
    elif not options.data and options.forecasts:
        raise InputError(
            "--online: needs the recordings (--data), of which the time is known"
        )
    if options.table != "latex":
        refuse_unused(
            options, ["intervals"], "without --table latex: other tables have intervals"
        )
    compare.check_report(options.json)
    if options.figures:
        from neurosym_jax.plotting.evaluation import check_figures

        check_figures(options.plots)
    else:
        refuse_unused(options, ["plots", "style", "scene"], "with --no-figures")
    if options.save_forecasts:
        saved_forecasts.check_forecasts_file(options.save_forecasts)
