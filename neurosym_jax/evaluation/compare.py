"""Compare forecasters: the plan of tests, results of every forecaster on every test set,
reports, and `evaluate`.
"""

import contextlib
import dataclasses
import functools
import itertools
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import MappingProxyType
from typing import Any

import jax
import numpy as np
import polars as pl

from neurosym_jax.configuration import Count, refuse
from neurosym_jax.data.recordings import GENERAL, EthUcy, Source, recordings_in
from neurosym_jax.data.tables import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import PERIOD, Tracks, on_grid
from neurosym_jax.data.windows import (
    ALIKE,
    Batch,
    Windows,
    cut_windows,
    make_batches,
    seen_before,
    single_scene,
)
from neurosym_jax.errors import InputError, NoWindowsError, option, warn_caller
from neurosym_jax.evaluation.forecasts import (
    ForecastFile,
    Forecasts,
    match,
    matched,
    read_named,
    windows_of,
)
from neurosym_jax.evaluation.intervals import (
    Difference,
    ErrorsByScene,
    against_best,
    paired_difference,
)
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.online import recall_batches
from neurosym_jax.evaluation.scores import (
    Evaluation,
    Score,
    Scores,
    chosen,
    score_batch,
    score_forecaster,
    score_samples,
)
from neurosym_jax.evaluation.tables import Row, first_trainings, rows_frame
from neurosym_jax.models.disk import (
    find_model,
    load_model,
    shipped_name,
)
from neurosym_jax.models.forecast import Model, SceneForecaster, unpacked
from neurosym_jax.models.forecaster import FORECASTERS, Forecaster
from neurosym_jax.runtime import files
from neurosym_jax.runtime.foreign import read_json, reading
from neurosym_jax.runtime.process import cpu_cores, progress_of
from neurosym_jax.scene import Scene, make_scene, pad_scene

__all__ = [
    "BASELINES",
    "FORMAT",
    "TABLE",
    "Entries",
    "Predictor",
    "Result",
    "Row",
    "Settings",
    "Test",
    "TestSet",
    "add_forecasts",
    "baseline",
    "baselines_of",
    "check_report",
    "evaluate",
    "evaluate_tests",
    "load_tests",
    "logged",
    "make_plan",
    "make_test",
    "predict_windows",
    "read_report",
    "test_of_file",
    "with_tests",
    "write_report",
]


# What is tested on what: models, and baselines beside them, on the windows of a
# dataset.

BASELINES = ("constant_velocity", "constant_velocity_sampled")
"""Forecasters that every model is tested beside, by name."""
TABLE = "anchor_table"
"""The baseline that ships trained: offsets to constant velocity, without a network."""
LENGTH = 8
"""Steps observed, and forecast, where no model says how many."""
LEAST_PROBABILITY = -1e-6
"""That a function may return: 0, but for rounding."""

Entries = list[tuple[str | None, Model]]
"""(path as given, model) of what is tested on one test set; baselines, first, have no path."""


@dataclasses.dataclass(frozen=True)
class TestSet:
    """A dataset at a horizon."""

    dataset: str
    """Its name, or names of recordings joined by `+`."""
    obs_len: int
    pred_len: int

    @property
    def lengths(self) -> tuple[int, int]:
        """Steps observed and steps forecast."""
        return self.obs_len, self.pred_len


@dataclasses.dataclass(frozen=True, eq=False)
class Test:
    """A test set, read, and the models to test on it."""

    test_set: TestSet
    entries: Entries
    windows: Windows
    forecasts: Sequence[tuple[str | None, Forecasts]] = ()
    """(file, forecasts) to test beside the models; those of a function have no file."""
    recordings: Sequence[Tracks] = ()
    """That the windows are cut from, where they are known."""
    learned: frozenset[str] = frozenset()
    """Models that were trained on these people: paths, or names of those without one."""

    @functools.cached_property
    def batches(self) -> list[Batch]:
        """All scenes, padded."""
        return make_batches(self.windows)


def make_plan(
    source: Source,
    models: Sequence[tuple[str, Model]],
    *,
    dataset: str | None = None,
    test_on: Sequence[str] = (),
    obs_len: int | None = None,
    pred_len: int | None = None,
    baselines: Sequence[str] | None = None,
    samples: int = 20,
    only_matching: bool = False,
) -> dict[TestSet, Entries]:
    """Plan the entries of each test set, by the source's order of datasets, then by horizon.

    A model is tested on its held-out dataset where the source has it, else on all
    datasets.

    Args:
        source: of the recordings.
        models: (path, model).
        dataset: test on this one only.
        test_on: names of recordings to test on, as one test set.
        obs_len: steps that the models have to observe.
        pred_len: steps that they have to forecast.
        baselines: see `baselines_of`.
        samples: number of forecasts of each scene, k.
        only_matching: leave out models that would be refused.

    Raises:
        InputError: for a model that does not match, or an unknown dataset or baseline.
    """
    everywhere = _datasets(source, dataset, test_on)
    tested: dict[TestSet, Entries] = {}
    for path, model in models:
        reason = _contradiction(model, source, dataset, test_on, obs_len, pred_len)
        if reason and only_matching:
            continue
        if reason:
            raise InputError(f"{_name_in_messages(path, model)}: {reason}")
        names = everywhere
        if model.dataset in source.scenes and not test_on:
            names = (str(model.dataset),)
        for name in names:
            steps = obs_len or model.config.obs_len
            test_set = TestSet(name, steps, model.config.pred_len)
            tested.setdefault(test_set, []).append((path, model))
    if not tested:
        for name in everywhere:
            tested[TestSet(name, obs_len or LENGTH, pred_len or LENGTH)] = []

    return _ordered(tested, [*everywhere, *source.scenes], baselines, samples)


def _datasets(
    source: Source, dataset: str | None, test_on: Sequence[str]
) -> tuple[str, ...]:
    """The names of the test sets that are chosen, by default those of all data sets."""
    if dataset is not None and test_on:
        names = f"{option('dataset')} and {option('test_on')}"
        raise InputError(f"{names} name two test sets: give one of them")
    if dataset is not None and dataset not in source.scenes:
        raise InputError(
            f"unknown dataset {dataset!r}: there are {', '.join(source.scenes)}"
        )
    if test_on:
        return ("+".join(test_on),)
    if dataset:
        return (dataset,)
    return source.scenes


def _ordered(
    tested: Mapping[TestSet, Entries],
    datasets: Sequence[str],
    baselines: Sequence[str] | None,
    samples: int,
) -> dict[TestSet, Entries]:
    """The test sets by the order of `datasets`, then by horizon, baselines first."""

    def place(test_set: TestSet) -> tuple[int, int, int]:
        return datasets.index(test_set.dataset), test_set.obs_len, test_set.pred_len

    plan = {}
    for test_set in sorted(tested, key=place):
        lengths = test_set.lengths
        beside = baselines_of(baselines, *lengths, test_set.dataset, samples)
        plan[test_set] = [*beside, *tested[test_set]]
    return plan


def _contradiction(
    model: Model,
    source: Source,
    dataset: str | None,
    test_on: Sequence[str],
    obs_len: int | None,
    pred_len: int | None,
) -> str | None:
    """Why a model cannot be tested as asked; None where it can."""
    unfit = model.forecaster.unfit
    if unfit:
        return unfit
    for name, requested in (("obs_len", obs_len), ("pred_len", pred_len)):
        own = getattr(model.config, name)
        takes_any = name == "obs_len" and model.forecaster.shortest < own
        if requested not in (None, own) and not takes_any:
            return f"has {name} {own}, but {option(name, requested)} is asked for"
    held_out = model.dataset in source.scenes
    if model.dataset == GENERAL and isinstance(source, EthUcy) and not test_on:
        where = "learned from all of ETH/UCY, so it would be tested"
    elif held_out and dataset not in (None, model.dataset):
        tested = option("dataset", dataset)
        where = f"leaves {model.dataset} out of its training, so {tested} would test it"
    else:
        return None
    hint = f"{option('test_on')} with file names does so all the same"
    return f"{where} on what it was trained on ({hint})"


def baselines_of(
    names: Sequence[str] | None,
    obs_len: int,
    pred_len: int,
    dataset: str | None = None,
    samples: int = 20,
) -> Entries:
    """The baselines of a test set, by names of forecasters.

    None stands for `BASELINES` and, where one of this horizon ships with as many
    `samples`, the anchor table that has not learned from `dataset`.
    """
    if names is None:
        names = BASELINES
        table = _table(obs_len, pred_len, dataset)
        if table is not None and samples <= table.config.samples:
            names = (*BASELINES, TABLE)
    return [(None, baseline(name, obs_len, pred_len, dataset)) for name in names]


def baseline(
    name: str, obs_len: int, pred_len: int, dataset: str | None = None
) -> Model:
    """Make a registered forecaster without parameters, or load the shipped anchor table.

    Raises:
        InputError: for another forecaster with parameters, or a horizon without a
            table.
    """
    forecaster = FORECASTERS[name]
    config = forecaster.Config(obs_len=obs_len, pred_len=pred_len)
    if not forecaster(config).shapes():
        return Model(config, {}, family=name)
    if name != TABLE:
        raise InputError(
            f"forecaster {name}: cannot be a baseline, it has parameters to learn"
        )
    table = _table(obs_len, pred_len, dataset)
    if table is None:
        raise InputError(
            f"forecaster {name}: none of {obs_len} + {pred_len} steps ships"
        )
    return table


def _table(obs_len: int, pred_len: int, dataset: str | None) -> Model | None:
    place = find_model(shipped_name(TABLE, dataset, pred_len))
    if obs_len == LENGTH and place.is_dir():
        return load_model(place)
    return None


def load_tests(
    source: Source,
    plan: Mapping[TestSet, Entries],
    *,
    test_on: Sequence[str] = (),
    min_agents: int = 2,
) -> list[Test]:
    """Read the test sets of a plan (see `make_plan`), each recording once.

    Warns:
        InputWarning: of a test set without a window, which is left out where another of
            its steps has one.

    Raises:
        NoWindowsError: where no test set of some steps has a window.
    """
    names = list(dict.fromkeys(test_set.dataset for test_set in plan))
    read = (lambda _: source.files(test_on)) if test_on else source.recordings
    # Side by side, for simulations are programs that are compiled first.
    with ThreadPoolExecutor(cpu_cores()) as pool:
        recordings = dict(zip(names, pool.map(read, names)))
    tests = []
    empty = {}
    for test_set, entries in plan.items():
        try:
            test = make_test(
                test_set, entries, recordings[test_set.dataset], min_agents
            )
        except NoWindowsError as error:
            empty[test_set] = error
        else:
            tests.append(test)

    tested = {test.test_set.lengths for test in tests}
    for test_set, error in empty.items():
        if test_set.lengths not in tested:
            raise error
        warn_caller(f"{test_set.dataset} is left out: {error}")
    return tests


def make_test(
    test_set: TestSet,
    entries: Entries,
    recordings: Sequence[Tracks],
    min_agents: int = 2,
) -> Test:
    """Cut `recordings` into windows; warn of models that were trained on them, or at other steps.

    The reading of the first recording keeps the warnings of training people, for
    reports.

    Raises:
        NoWindowsError: for recordings without a window.
    """
    lengths = test_set.lengths
    try:
        windows = cut_windows(recordings, *lengths, min_agents=min_agents)
    except NoWindowsError as error:
        with contextlib.suppress(NoWindowsError):
            cut_windows(recordings, *lengths, min_agents=1)
            hint = f"{option('min_agents', 1)} tests people alone, too"
            error = NoWindowsError(f"{error}; {hint}")
        raise error from None
    return _told(Test(test_set, entries, windows, recordings=recordings))


def _name_in_messages(path: str | None, model: Model) -> str:
    """A model's path; where it was asked for as `recommended`, that and the path."""
    if path and model.called:
        return f"{model.called} ({path})"
    return path or model.name


def _told(test: Test) -> Test:
    """`test` with what is to be known of its models, see `make_test`."""
    learned = set()
    windows = test.windows
    for path, model in test.entries:
        called = _name_in_messages(path, model)
        period = model.config.period
        hits, looked = seen_before(model.seen, windows)
        if hits > ALIKE * looked:
            learned.add(path or model.name)
            leak = (
                f"{called}: was trained on these people: {hits} of {looked} windows that "
                "were looked for are among its training windows, so its errors are too "
                "small"
            )
            warn_caller(leak)
            first, *others = windows.reading
            first = dataclasses.replace(first, warnings=(*first.warnings, leak))
            windows = dataclasses.replace(windows, reading=(first, *others))

        trained = path is not None or bool(model.params)
        if trained and abs(period - windows.period) > 0.01 * period:
            resample = option("period", round(period, 6))
            line = (
                f"{called}: was trained on steps of {period:g} s and is tested on steps "
                f"of {windows.period:g} s ({resample} resamples the recordings)"
            )
            warn_caller(line)
    return dataclasses.replace(test, windows=windows, learned=frozenset(learned))


# Results of an evaluation: every model of every test set, forecast, scored and timed.
#
# While one model is evaluated, the programs of those that follow are compiled, in
# threads.

EXAMPLE = 8
"""Number of people that a figure can show."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """How every test set is evaluated."""

    samples: int = 20
    """Number of forecasts of each scene, k."""
    seed: int = 0
    """Random seed of the noise."""
    metrics: tuple[str, ...] | None = None
    """Names; None for those of every table."""
    seeds: int = 1
    """Number of noise seeds, starting at `seed`; metrics are averaged over them."""
    by_scene: bool = False
    """Whether means weigh each scene the same, instead of each person."""
    labels: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Names for tables, by the path of a model or of forecasts."""
    online: bool = False
    """Whether models are tested a second time, with what they recall of the place."""
    place: Path | None = None
    """File of a place with which each recording begins, online."""
    scene: int | None = None
    """Index of the example; None for one that is harder than nine of ten, see `_example_scene`."""


@dataclasses.dataclass(frozen=True, eq=False)
class Result:
    """The result of one model on one test set."""

    test_set: TestSet
    row: Row
    errors: ErrorsByScene
    example: Scene
    """A scene of the test set, padded, with its truth, to draw; the same for all models."""
    forecast: np.ndarray
    """[k, N, pred_len, 2] world metres, of the example."""
    horizons: dict[str, np.ndarray]
    """[3, pred_len] mean over the test set and the bounds of its 95 % interval (NaN for too few
    blocks), of the metrics with a value for each step."""
    period: float
    """Seconds between steps."""

    @property
    def name(self) -> str:
        """The model's name."""
        return self.row["model"]


def evaluate_tests(
    tests: Sequence[Test],
    settings: Settings,
    run: Callable[..., Iterable[Any]] | None = None,
) -> Iterator[Result]:
    """Yield the results of all tests in their order, the entries of each in theirs.

    Each test set is a task of `run`, see `cluster_map`; default: all here, in threads.
    """
    total = sum(len([*_entries(test, settings)]) for test in tests)
    step = progress_of(total)
    results = _results(settings, tests)
    if run is not None:
        tasks = run(functools.partial(_task, settings), tests)
        results = itertools.chain.from_iterable(tasks)
    for result in results:
        step(f"{result.name} on {result.test_set.dataset}")
        yield result


def _task(settings: Settings, test: Test) -> list[Result]:
    return list(_results(settings, [test]))


def _results(settings: Settings, tests: Sequence[Test]) -> Iterator[Result]:
    """Compile in threads what the tests need, and evaluate them in order meanwhile."""
    needed: dict[Forecaster, tuple[Model, dict[Any, Scene]]] = {}
    for test in tests:
        scenes = {batch.scene.observed.shape: batch.scene for batch in test.batches}
        for _, model in test.entries:
            _, shapes = needed.setdefault(model.forecaster, (model, {}))
            shapes.update(scenes)
    pool = ThreadPoolExecutor(cpu_cores())
    try:
        programs = {
            forecaster: pool.submit(_compile, model, scenes.values(), settings)
            for forecaster, (model, scenes) in needed.items()
        }
        for test in tests:
            yield from _evaluate_test(programs, test, settings)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _compile(model: Model, scenes: Iterable[Scene], settings: Settings) -> None:
    """Compile the programs for batches like `scenes`: by running on empty ones; JAX keeps them."""
    forecaster = model.forecaster
    metrics = chosen(settings.metrics)
    # One after the other, for all shapes share a program that the first one compiles.
    for scene in scenes:
        empty: Any = jax.tree.map(np.zeros_like, scene)
        empty.valid[0, 0] = True
        score_batch(
            forecaster,
            model.params,
            empty,
            forecaster.count(settings.samples),
            0,
            metrics,
        )
    alone = make_scene(np.zeros((1, model.config.obs_len, 2)))
    example = pad_scene(alone, EXAMPLE)
    SceneForecaster(forecaster, model.params, samples=settings.samples, seed=0)(example)


def _evaluate_test(
    programs: Mapping[Forecaster, Future], test: Test, settings: Settings
) -> Iterator[Result]:
    number, example = settings.scene, None
    for path, entry, online in _entries(test, settings):
        compiling = 0.0
        if isinstance(entry, Forecasts):
            scenes = test.windows, test.batches
            samples, probability = entry.samples, entry.probability
            runs = [score_samples(samples, probability, *scenes, settings.metrics)]
        else:
            start = time.perf_counter()
            programs[entry.forecaster].result()
            compiling = time.perf_counter() - start
            runs = _runs(entry, test, settings, online)
        evaluation, spread = _averaged(runs, settings)
        if number is None:
            number = _example_scene(test, evaluation)
        if example is None:
            example = single_scene(test.windows, number)
            # One size for most test sets, because each costs a program for every model.
            example = pad_scene(example, max(EXAMPLE, len(example.valid)))
        if isinstance(entry, Forecasts):
            rows = test.windows.rows(np.array([number]))
            valid = np.asarray(example.valid)[None]
            forecast = unpacked(entry.samples[:, rows], valid)[:, 0]
            latency, rate = entry.latency, None
        else:
            latency, forecast = _latency(entry, example, settings)
            rate = evaluation.agents * evaluation.samples / evaluation.seconds
        name = settings.labels.get(path or "", entry.name)
        if online:
            name = f"{name}, online"
        facts = {"checkpoint": path, "model": name, **_identity(entry)}
        facts["learned"] = (path or entry.name) in test.learned
        facts["online"] = online
        result = _result(test, settings, facts, evaluation, spread, example, forecast)
        result.row["seconds_compiling"] = compiling
        result.row["seconds_evaluating"] = evaluation.seconds
        result.row["latency"] = latency
        result.row["forecasts_per_second"] = rate
        yield result


def _result(
    test: Test,
    settings: Settings,
    facts: Row,
    evaluation: Evaluation,
    spread: dict[str, float],
    example: Scene,
    forecast: np.ndarray,
) -> Result:
    """The row of one model, its errors by scene, and its errors by horizon."""
    windows = test.windows
    single, curves = {}, {}
    for name, score in evaluation.scores.items():
        if score.total.ndim == 1:
            single[name] = score
        else:
            curves[name] = score
    errors = ErrorsByScene(single, windows.identity, windows.position.shape[1])
    row = {
        **facts,
        **dataclasses.asdict(test.test_set),
        "samples": evaluation.samples,
        "draws": evaluation.draws,
        "seed": settings.seed,
        "seeds": settings.seeds,
        "scenes": windows.scenes,
        "agents": evaluation.agents,
        "blocks": len(errors.block_sums[0]),
        **_columns(errors, spread, f"{facts['model']} on {test.test_set.dataset}"),
    }
    horizons = {name: _band(score, errors) for name, score in curves.items()}
    return Result(
        test.test_set, row, errors, example, forecast, horizons, windows.period
    )


def _identity(entry: Model | Forecasts) -> Row:
    """See `Model.identity`; nothing is known of saved forecasts and of baselines."""
    if isinstance(entry, Forecasts) or not entry.params:
        columns = ("configuration", "training_data", "training_seed", "parameters")
        return dict.fromkeys(columns)
    return entry.identity


def _entries(
    test: Test, settings: Settings
) -> Iterator[tuple[str | None, Model | Forecasts, bool]]:
    """(path, what is tested, whether online): models that were named, a second time."""
    for path, entry in [*test.entries, *test.forecasts]:
        yield path, entry, False
        if settings.online and path and isinstance(entry, Model):
            yield path, entry, True


def _runs(
    model: Model, test: Test, settings: Settings, online: bool
) -> list[Evaluation]:
    """Scores of a model by each seed of the noise."""
    seeds = range(settings.seed, settings.seed + settings.seeds)
    options: Any = {"samples": settings.samples, "metrics": settings.metrics}
    if online:
        parts = test.windows, test.batches, test.recordings
        options["memories"] = recall_batches(model, *parts, settings.place)
    forecaster = model.forecaster
    if not forecaster.noise.dim:
        seeds = seeds[:1]
    score = functools.partial(score_forecaster, forecaster, model.params, test.batches)
    return [score(seed=seed, **options) for seed in seeds]


def _averaged(
    runs: Sequence[Evaluation], settings: Settings
) -> tuple[Evaluation, dict[str, float]]:
    """Mean scores over noise seeds, and the standard deviation between the seeds' means."""
    scores: Scores = {}
    spread = {}
    for name, first in runs[0].scores.items():
        seeds = [run.scores[name] for run in runs]
        if settings.by_scene:
            seeds = [score.of_each_scene() for score in seeds]
        totals, counts = zip(*seeds)
        scores[name] = Score(np.mean(totals, axis=0), np.mean(counts, axis=0))
        means = [score.mean for score in seeds]
        has_spread = len(runs) > 1 and first.total.ndim == 1
        if has_spread and np.isfinite(means).all():
            spread[name] = float(np.std(means, ddof=1))
    seconds = float(np.mean([run.seconds for run in runs]))
    return runs[0]._replace(scores=scores, seconds=seconds), spread


def _columns(errors: ErrorsByScene, spread: dict[str, float], source: str) -> Row:
    """Mean, bounds and deviation of each metric with one value, None where nothing was counted."""
    columns: Row = {}
    for name, score in errors.scores.items():
        if not np.isfinite(score.total).all():
            raise InputError(f"metric {name}: is not finite for {source}")
    for name, (low, high) in errors.intervals().items():
        mean = float(errors.scores[name].mean)
        has_interval = np.isfinite([mean, low, high]).all()
        columns[name] = None if np.isnan(mean) else mean
        columns[f"{name}_low"] = low if has_interval else None
        columns[f"{name}_high"] = high if has_interval else None
        columns[f"{name}_std"] = spread.get(name)
    return columns


def _band(score: Score, errors: ErrorsByScene) -> np.ndarray:
    """[3, T] mean, low and high of a score with a value for each step, on the same scenes."""
    step_scores = {}
    for step, total in enumerate(score.total.T):
        step_scores[str(step)] = Score(total, score.count)
    bounds = dataclasses.replace(errors, scores=step_scores).intervals().values()
    low, high = zip(*bounds)
    curves = np.vstack([score.mean, low, high])
    return np.where(np.isfinite(curves), curves, np.nan)


def _example_scene(test: Test, evaluation: Evaluation) -> int:
    """Choose the scene to show: of those with at most `EXAMPLE` people the one that is harder for
    the first entry than nine of ten, so people turn, and neither luck nor taste chooses it."""
    sizes = test.windows.sizes
    error = next(iter(evaluation.scores.values())).total / sizes
    small = np.flatnonzero(sizes <= max(EXAMPLE, sizes.min()))
    easiest_first = small[np.argsort(error[small], kind="stable")]
    return int(easiest_first[9 * len(small) // 10])


def _latency(
    model: Model, scene: Scene, settings: Settings
) -> tuple[float, np.ndarray]:
    """Median seconds to forecast one scene, and its forecast [k, N, pred_len, 2], world metres."""
    forecast = SceneForecaster(
        model.forecaster, model.params, samples=settings.samples, seed=settings.seed
    )
    futures = forecast(scene)
    moments = [time.perf_counter()]
    for _ in range(10):
        forecast(scene)
        moments.append(time.perf_counter())
    return float(np.median(np.diff(moments))), futures


# Predictors that are functions of numpy or torch, called for every scene of a test set.

Predictor = Callable[[np.ndarray], Any]
"""`predictor(observed [N, obs_len, 2])` returns [N, T, 2] or [k, N, T, 2], of one scene, metres;
or a pair of the latter and probabilities [k]."""


def predict_windows(predictor: Predictor, name: str, windows: Windows) -> Forecasts:
    """Call a predictor for every scene of `windows`.

    Raises:
        InputError: naming the predictor, for what is no forecast of the scene.
    """
    pred_len = windows.position.shape[1] - windows.obs_len
    parts: list[np.ndarray] = []
    weights: list[np.ndarray | None] = []
    seconds = []
    for begin, end in itertools.pairwise(windows.bounds):
        observed = windows.position[begin:end, : windows.obs_len]
        start = time.perf_counter()
        answer = predictor(observed.copy())
        seconds.append(time.perf_counter() - start)

        samples, probability = answer if isinstance(answer, tuple) else (answer, None)
        samples = np.asarray(_on_host(samples), np.float64)
        if samples.ndim == 3:
            samples = samples[None]
        first = parts[0] if parts else samples
        people = end - begin
        fits = samples.shape == (*first.shape[:1], people, pred_len, 2)
        if not fits or not np.isfinite(samples).all():
            raise InputError(
                f"{name}: must return finite [{people}, {pred_len}, 2] or "
                f"[k, {people}, {pred_len}, 2], k the same for all scenes, not "
                f"{list(samples.shape)}"
            )
        if probability is not None:
            probability = np.asarray(_on_host(probability), np.float64)
            count = len(samples)
            fits = (
                probability.shape == (count,)
                and (probability > LEAST_PROBABILITY).all()
            )
            if not fits or not np.isclose(probability.sum(), 1, atol=1e-3):
                raise InputError(
                    f"{name}: probabilities must be [{count}], not negative, with a "
                    "sum of 1"
                )
        parts.append(samples)
        weights.append(probability)
    known = [probability for probability in weights if probability is not None]
    if known and len(known) < len(weights):
        raise InputError(
            f"{name}: returns probabilities of {len(known)} of {len(weights)} scenes: "
            "return them of all, or of none"
        )
    probabilities = np.stack(known, axis=1) if known else None
    together = np.concatenate(parts, axis=1)
    return Forecasts(name, together, probabilities, float(np.median(seconds)))


def _on_host(array: Any) -> Any:
    """A torch tensor without its gradient, for numpy."""
    if hasattr(array, "detach"):
        return array.detach().cpu()
    return array


# The report of an evaluation: its rows and facts as JSON, replaced when whole.
#
# Beside `evaluation.json`, `evaluation.jsonl` has the rows as they come.

FORMAT = 2


def write_report(
    path: Path, rows: Sequence[dict[str, Any]], facts: Mapping[str, Any]
) -> None:
    """Write a report of `rows` with further `facts`; say so where it replaces another."""
    if check_report(path):
        print(f"replacing the report in {path}", file=sys.stderr)
    files.write_json(path, {"format": FORMAT, **facts, "rows": list(rows)})


def logged(path: Path, results: Iterable[Result]) -> Iterator[Result]:
    """Yield `results`, and append the row of each to the log beside the report at `path`."""
    log = path.with_suffix(".jsonl")
    files.write_text(log, "")
    for result in results:
        files.append_text(log, json.dumps(result.row, allow_nan=False) + "\n")
        yield result


def read_report(path: Path) -> pl.DataFrame:
    """Read the rows of a report.

    Raises:
        InputError: for a file that is missing or no report of this version.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file")
    report = _report(path)
    if report.get("format") != FORMAT:
        raise InputError(f"{path}: is not a report of ours of format {FORMAT}")
    with reading(path, "a report"):
        return rows_frame(report["rows"])


def check_report(path: Path) -> bool:
    """Whether a report is at `path` already.

    Raises:
        InputError: when `path`, or the log of rows beside it, holds anything else or
            cannot be written.
    """
    if path.suffix == ".jsonl":
        raise InputError(
            f"{path}: rows are kept in a .jsonl beside the report: name it .json"
        )
    log = path.with_suffix(".jsonl")
    for target in (path, log):
        files.refuse_unwritable(target)
    own_log = not log.exists() or log.read_bytes()[:13] in (b"", b'{"checkpoint"')
    own_report = not path.exists() or _report(path)
    for target, own in ((log, own_log), (path, own_report)):
        if not own:
            raise InputError(
                f"{target}: is not a report of ours, so it is not overwritten"
            )
    return path.exists()


def _report(path: Path) -> dict[str, Any]:
    """The content of a report; nothing for anything else."""
    try:
        content = read_json(path)
    except InputError:
        return {}
    if isinstance(content, dict) and {"format", "rows"} <= set(content):
        return content
    return {}


# Compare models, functions and saved forecasts on recordings, and test their
# differences.

OF_WINDOWS = ("obs_len", "pred_len", "period", "min_agents", "test_on", "cluster")
"""Options, beside those of reading, without effect where a file of forecasts has the windows."""


Models = (
    Model | Predictor | Sequence[Model | Predictor] | Mapping[str, Model | Predictor]
)


def evaluate(
    models: Models = (),
    recordings: Any = None,
    *,
    forecasts: Path | str | Sequence[Path | str] | Mapping[str, Path | str] = (),
    samples: int = 20,
    seed: int = 0,
    min_agents: int = 2,
    metrics: str | Sequence[str] | None = None,
    baselines: str | Sequence[str] | None = None,
    obs_len: int | None = None,
    pred_len: int | None = None,
    period: float | None = None,
    partial: bool = False,
    **read: Any,
) -> pl.DataFrame:
    """Test models on recordings: a row for each model, beside the baselines; see `format_table`.

    Recordings are resampled to the steps that a model was trained on.

    Args:
        models: one or several (see `load_model`), or functions (see `Predictor`); a
            mapping has their names in tables.
        recordings: a file, folder, dataframe, `Tracks`, or several of these; None for
            those that the first file of forecasts holds.
        forecasts: files, see `read_forecasts`, one or several or by name.
        samples: number of forecasts of each scene, k.
        seed: random seed of the noise.
        min_agents: scenes with fewer people are left out.
        metrics: names; default: those of every table, see `metric_names`.
        baselines: forecasters by name, see `baselines_of`.
        obs_len: steps observed where no model says how many; default: 8.
        pred_len: steps to forecast, likewise; default: those of the files, else 8.
        period: seconds between steps, likewise; default: 0.4.
        partial: leave out windows that not all files of forecasts have.
        read: fields of `ReadOptions`, such as `unit="cm"`.

    Returns:
        Columns `model`, `dataset`, ...; each metric's mean under its name, its 95 %
        interval under `NAME_low` and `NAME_high`, and the p value of its paired test
        against the best model under `NAME_p`, see `with_tests`.

    Raises:
        InputError: for what cannot be read or does not match.
    """
    refuse(Count, {"samples": samples, "min_agents": min_agents})
    loaded, functions = _apart(models)
    files = read_named(forecasts) if forecasts else {}
    lengths = {"obs_len": obs_len, "pred_len": pred_len, "period": period}
    options: dict[str, Any] = {"samples": samples, "min_agents": min_agents}
    options["baselines"] = _names(baselines)
    entries: Entries = list(loaded.items())
    if not isinstance(models, Mapping):
        entries = [(None, model) for model in loaded.values()]
    tests = _tests_of(recordings, files, entries, lengths, read, options)
    tests = add_forecasts(tests, files, functions, partial=partial)
    labels = {str(file.path): name for name, file in files.items()}
    labels |= {name: name for name in loaded}
    settings = Settings(samples, seed, _names(metrics), labels=labels)
    return rows_frame(with_tests(list(evaluate_tests(tests, settings))))


def _names(names: str | Sequence[str] | None) -> tuple[str, ...] | None:
    """Names as a tuple; a text is one name."""
    if names is None:
        return None
    return (names,) if isinstance(names, str) else tuple(names)


def _tests_of(
    recordings: Any,
    files: Mapping[str, ForecastFile],
    entries: Entries,
    lengths: Mapping[str, Any],
    read: Mapping[str, Any],
    options: Mapping[str, Any],
) -> list[Test]:
    """Tests on recordings or, without any, on the windows of the first file of forecasts."""
    _refuse_other_lengths([model for _, model in entries], lengths)
    if recordings is not None:
        steps = [file.steps for file in files.values()]
        default = (
            lengths["obs_len"] or LENGTH,
            next(filter(None, [lengths["pred_len"], *steps, LENGTH])),
            lengths["period"] or PERIOD,
        )
        reading = ReadOptions(**read)
        tracks = recordings_in(recordings, reading)
        return _tests_on(tracks, entries, default, reading.max_gap, **options)
    if entries or not files:
        raise InputError("recordings: there are none to test on")
    options_of_windows = {**lengths, "min_agents": options["min_agents"] != 2, **read}
    name, file = next(iter(files.items()))
    baselines, samples = options["baselines"], options["samples"]
    return [test_of_file(name, file, baselines, samples, options_of_windows)]


def _refuse_other_lengths(models: Sequence[Model], lengths: Mapping[str, Any]) -> None:
    for name, value in lengths.items():
        for model in models:
            own = getattr(model.config, name)
            if value not in (None, own):
                raise InputError(f"{name} {value}: {model.name} has {own}")


def _tests_on(
    recordings: Sequence[Tracks],
    entries: Entries,
    default: tuple[int, int, float],
    max_gap: float,
    *,
    baselines: Sequence[str] | None,
    samples: int,
    min_agents: int,
) -> list[Test]:
    """A test on all recordings for each (obs_len, pred_len, period) of the models.

    Without models it is the `default` one, of baselines alone.
    """
    tested: dict[tuple[int, int, float], Entries] = {}
    for path, model in entries:
        config = model.config
        key = (config.obs_len, config.pred_len, config.period)
        tested.setdefault(key, []).append((path, model))
    if not tested:
        tested[default] = []
    dataset = "+".join(dict.fromkeys(tracks.recording for tracks in recordings))
    tests = []
    for (obs_len, pred_len, period), own in tested.items():
        beside = baselines_of(baselines, obs_len, pred_len, samples=samples)
        on_clock = [on_grid(tracks, period, max_gap) for tracks in recordings]
        test_set = TestSet(dataset, obs_len, pred_len)
        tests.append(make_test(test_set, [*beside, *own], on_clock, min_agents))
    return tests


def _apart(models: Any) -> tuple[dict[str, Model], dict[str, Predictor]]:
    """Models and functions by name or, where they have none, their number."""
    if isinstance(models, Model) or callable(models):
        models = [models]
    if not isinstance(models, Mapping):
        models = dict(map(_numbered, itertools.count(), models))
    for name, model in models.items():
        if not (isinstance(model, Model) or callable(model)):
            raise InputError(f"{name}: is no model or function: {type(model).__name__}")
    loaded = {name: model for name, model in models.items() if isinstance(model, Model)}
    functions = {name: model for name, model in models.items() if name not in loaded}
    return loaded, functions


def _numbered(number: int, model: Any) -> tuple[str, Any]:
    """A model by its name, and its number where that is not 0."""
    name = getattr(model, "__name__", "").strip("<>")
    if not name:
        return str(number), model
    return f"{name} {number}" if number else name, model


def test_of_file(
    name: str,
    file: ForecastFile,
    baselines: Sequence[str] | None,
    samples: int,
    options: Mapping[str, Any],
) -> Test:
    """The test set that a file holds itself, with what happened, and its baselines.

    Raises:
        InputError: for `options` that would choose other windows.
    """
    for key in (*OF_WINDOWS, *vars(AS_IT_SAYS)):
        if options.get(key):
            raise InputError(
                f"{option(key)}: has no effect on windows of a file of forecasts"
            )
    windows = windows_of(file)
    obs_len = windows.obs_len
    pred_len = windows.position.shape[1] - windows.obs_len
    recordings = sorted({reading.recording for reading in windows.reading} - {""})
    test_set = TestSet("+".join(recordings) or name, obs_len, pred_len)
    entries = baselines_of(baselines, obs_len, pred_len, samples=samples)
    return _told(Test(test_set, entries, windows))


def add_forecasts(
    tests: Sequence[Test],
    files: Mapping[str, ForecastFile],
    predictors: Mapping[str, Predictor] = MappingProxyType({}),
    *,
    partial: bool = False,
) -> list[Test]:
    """Add forecasts of files and functions, by name, to the test sets that they are of.

    Args:
        tests: see `make_test`.
        files: see `read_forecasts`; each is of the test sets of its recordings and
            length.
        predictors: functions, which forecast all test sets.
        partial: test on the windows that all files have, see `match`; else all must
            match.

    Raises:
        InputError: for a file that is of no test set, or that could be of several, and
            for `partial` without a file.
    """
    if partial and not files:
        raise InputError(f"{option('partial', True)}: there are no files of forecasts")
    chosen: list[dict[str, ForecastFile]] = [{} for _ in tests]
    for name, file in files.items():
        own = set[str]()
        if file.recordings is not None:
            own.update(map(str, file.recordings))
        numbers = []
        foreign = set(own)
        for number, test in enumerate(tests):
            recordings = _recordings(test)
            same_length = test.test_set.pred_len == file.steps
            if same_length and (not own or own & recordings):
                numbers.append(number)
                foreign -= recordings
        ambiguous = not own and len(numbers) > 1
        if not numbers or ambiguous or (foreign and not partial):
            raise InputError(_no_test_set(file, foreign, tests))
        for number in numbers:
            chosen[number][name] = file
    tests_with_forecasts = []
    for test, own_files in zip(tests, chosen):
        test = _with_forecasts(test, own_files, predictors, partial)
        tests_with_forecasts.append(test)
    return tests_with_forecasts


def _no_test_set(file: ForecastFile, foreign: set[str], tests: Sequence[Test]) -> str:
    """Why a file of forecasts belongs to none of the tests, or to several."""
    datasets = ", ".join(dict.fromkeys(test.test_set.dataset for test in tests))
    lengths = sorted({test.test_set.pred_len for test in tests})
    recordings = "one recording"
    if foreign:
        recordings = f"recordings {', '.join(sorted(foreign)[:6])}"
    return (
        f"{file.path}: forecasts of {file.steps} steps of {recordings}; tested are "
        f"{datasets}, {', '.join(map(str, lengths))} steps: choose the data set and "
        "the steps that were forecast"
    )


def _recordings(test: Test) -> set[str]:
    return {reading.recording for reading in test.windows.reading}


def _with_forecasts(
    test: Test,
    files: Mapping[str, ForecastFile],
    predictors: Mapping[str, Predictor],
    partial: bool,
) -> Test:
    windows = test.windows
    rows = {}
    complete = np.ones(windows.scenes, bool)
    for name, file in files.items():
        covered, rows[name] = match(file, windows, partial=partial)
        complete &= covered
    if not complete.any():
        raise InputError(f"{', '.join(files)}: no window is in all of these files")
    people = np.repeat(complete, windows.sizes)
    windows = windows.take(complete)
    forecasts = []
    for name, file in files.items():
        own = matched(file, name, windows, rows[name][people])
        forecasts.append((str(file.path), own))
    for name, function in predictors.items():
        forecasts.append((None, predict_windows(function, name, windows)))
    return dataclasses.replace(test, windows=windows, forecasts=forecasts)


def with_tests(results: Sequence[Result]) -> list[Row]:
    """The rows of `results`, with the p value of each metric's paired test under `NAME_p`.

    The test is against the model of best mean on the same test set, which has None, and
    p is adjusted by Holm's method for the number of models. Scenes are paired. Models
    that were trained on these people (`learned`), or that saw who was there before
    (`online`), are not compared and have None, too.
    Trainings that differ in their seed alone count as one model and are paired, too; a
    single run with each of them.
    """
    rows = [dict(result.row) for result in results]
    first = first_trainings(rows)
    lines: dict[Any, dict[int, list[int]]] = {}
    for number, result in enumerate(results):
        # Of another period the windows are others.
        members = lines.setdefault((result.test_set, result.period), {})
        members.setdefault(first[number], []).append(number)
    for members in lines.values():
        runs = []
        for numbers in members.values():
            runs.append([results[number] for number in numbers])
        for metric, p_values in _p_values(runs).items():
            for numbers, p in zip(members.values(), p_values):
                for number in numbers:
                    rows[number][f"{metric}_p"] = p
    return rows


def _p_values(lines: list[list[Result]]) -> dict[str, list[float | None]]:
    """By metric, for each line of one test set, which has one training or several."""

    @functools.cache
    def difference(best: int, other: int) -> Difference:
        runs = [run.errors for run in lines[best]]
        other_runs = [run.errors for run in lines[other]]
        # A single training is compared with each of several.
        if len(runs) == 1:
            runs = runs * len(other_runs)
        if len(other_runs) == 1:
            other_runs = other_runs * len(runs)
        return paired_difference(runs, other_runs)

    p_by_metric = {}
    for column, metric in enumerate(lines[0][0].errors.scores):
        means: list[float | None] = []
        for line in lines:
            trainings = [run.row[metric] for run in line]
            favoured = any(run.row["learned"] or run.row["online"] for run in line)
            is_compared = None not in trainings and not favoured
            means.append(float(np.mean(trainings)) if is_compared else None)

        def p_value(best: int, other: int, column: int = column) -> float:
            return difference(best, other).over_both.p_value(column)

        p_by_metric[metric] = against_best(
            means, METRICS[metric].higher_is_better, p_value
        )
    return p_by_metric
