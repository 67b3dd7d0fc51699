"""Compare forecasters: the plan of tests, results of every forecaster on every test set,
reports, and `evaluate`.
"""

import dataclasses
import functools
import itertools
import json
import sys
import time
import warnings
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
from neurosym_jax.data.tracks import PERIOD, Tracks
from neurosym_jax.data.windows import (
    Batch,
    Windows,
    cut_windows,
    make_batches,
    on_grid,
    seen_before,
    single_scene,
)
from neurosym_jax.errors import InputError, InputWarning, option
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
from neurosym_jax.evaluation.scores import (
    Evaluation,
    Score,
    Scores,
    chosen,
    score_batch,
    score_forecaster,
    score_samples,
)
from neurosym_jax.evaluation.tables import first_trainings, rows_frame
from neurosym_jax.forecasting.batched import unpacked
from neurosym_jax.forecasting.forecaster import FORECASTERS, Forecaster
from neurosym_jax.forecasting.model import Model, SceneForecaster
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.forecasting.model_places import find_model, shipped_name
from neurosym_jax.runtime import files
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

Entries = list[tuple[str | None, Model]]
"""(path as given, model) of what is tested on one test set; baselines, first, have no path."""


@dataclasses.dataclass(frozen=True)
class TestSet:
    """A dataset at a horizon."""

    dataset: str
    """Its name, or names of recordings joined by `+`."""
    obs_len: int
    pred_len: int


@dataclasses.dataclass(frozen=True, eq=False)
class Test:
    """A test set, read, and the models to test on it."""

    test_set: TestSet
    entries: Entries
    windows: Windows
    forecasts: Sequence[tuple[str | None, Forecasts]] = ()
    """(file, forecasts) to test beside the models; those of a function have no file."""

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
    if dataset is not None and test_on:
        names = f"{option('dataset')} and {option('test_on')}"
        raise InputError(f"{names} name two test sets: give one of them")
    if dataset is not None and dataset not in source.scenes:
        raise InputError(
            f"unknown dataset {dataset!r}: there are {', '.join(source.scenes)}"
        )
    everywhere = (
        ("+".join(test_on),) if test_on else (dataset,) if dataset else source.scenes
    )
    tested: dict[TestSet, Entries] = {}
    for path, model in models:
        if reason := _contradiction(model, source, dataset, test_on, obs_len, pred_len):
            if only_matching:
                continue
            raise InputError(f"{path}: {reason}")
        own = model.dataset in source.scenes and not test_on
        for name in (str(model.dataset),) if own else everywhere:
            test_set = TestSet(name, model.config.obs_len, model.config.pred_len)
            tested.setdefault(test_set, []).append((path, model))
    if not tested:
        tested = {
            TestSet(name, obs_len or LENGTH, pred_len or LENGTH): []
            for name in everywhere
        }
    order = [*everywhere, *source.scenes]
    sets = sorted(
        tested,
        key=lambda test_set: (
            order.index(test_set.dataset),
            test_set.obs_len,
            test_set.pred_len,
        ),
    )
    return {
        test_set: [
            *baselines_of(
                baselines,
                test_set.obs_len,
                test_set.pred_len,
                test_set.dataset,
                samples,
            ),
            *tested[test_set],
        ]
        for test_set in sets
    }


def _contradiction(
    model: Model,
    source: Source,
    dataset: str | None,
    test_on: Sequence[str],
    obs_len: int | None,
    pred_len: int | None,
) -> str | None:
    """Why a model cannot be tested as asked; None where it can."""
    config = model.config
    if reason := model.forecaster.unfit:
        return reason
    for name, requested in (("obs_len", obs_len), ("pred_len", pred_len)):
        if requested not in (None, own := getattr(config, name)):
            return f"has {name} {own}, but {option(name, requested)} is asked for"
    if model.dataset == GENERAL and isinstance(source, EthUcy) and not test_on:
        where = "learned from all of ETH/UCY, so it would be tested"
    elif (
        dataset is not None
        and model.dataset in source.scenes
        and dataset != model.dataset
    ):
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
        table = _table(obs_len, pred_len, dataset)
        names = (
            [*BASELINES, TABLE]
            if table and samples <= table.config.samples
            else BASELINES
        )
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
    if (table := _table(obs_len, pred_len, dataset)) is None:
        raise InputError(
            f"forecaster {name}: none of {obs_len} + {pred_len} steps ships"
        )
    return table


def _table(obs_len: int, pred_len: int, dataset: str | None) -> Model | None:
    place = find_model(shipped_name(TABLE, dataset, pred_len))
    return load_model(place) if obs_len == LENGTH and place.is_dir() else None


def load_tests(
    source: Source,
    plan: Mapping[TestSet, Entries],
    *,
    test_on: Sequence[str] = (),
    min_agents: int = 2,
) -> list[Test]:
    """Read the test sets of a plan (see `make_plan`), each recording once."""
    names = list(dict.fromkeys(test_set.dataset for test_set in plan))
    read = (lambda _: source.files(test_on)) if test_on else source.recordings
    # Side by side, for simulations are programs that are compiled first.
    with ThreadPoolExecutor(cpu_cores()) as pool:
        recordings = dict(zip(names, pool.map(read, names)))
    return [
        make_test(test_set, entries, recordings[test_set.dataset], min_agents)
        for test_set, entries in plan.items()
    ]


def make_test(
    test_set: TestSet,
    entries: Entries,
    recordings: Sequence[Tracks],
    min_agents: int = 2,
) -> Test:
    """Cut `recordings` into windows; warn of models that were trained on them, or at other steps.

    The reading of the first recording keeps the warnings of training people, for
    reports.
    """
    windows = cut_windows(
        recordings, test_set.obs_len, test_set.pred_len, min_agents=min_agents
    )
    for path, model in entries:
        name, period = path or model.name, model.config.period
        hits, looked = seen_before(model.seen, windows)
        if hits:
            line = (
                f"{name}: was trained on these people: {hits} of {looked} windows that were "
                "looked for are among its training windows, so its errors are too small"
            )
            warnings.warn(line, InputWarning, stacklevel=2)
            first, *others = windows.reading
            first = dataclasses.replace(first, warnings=(*first.warnings, line))
            windows = dataclasses.replace(windows, reading=(first, *others))
        if (path or model.params) and abs(period - windows.period) > 0.01 * period:
            resample = option("period", round(period, 6))
            line = (
                f"{name}: was trained on steps of {period:g} s and is tested on steps of "
                f"{windows.period:g} s ({resample} resamples the recordings)"
            )
            warnings.warn(line, InputWarning, stacklevel=2)
    return Test(test_set, entries, windows)


# Results of an evaluation: every model of every test set, forecast, scored and timed.
#
# While one model is evaluated, the programs of those that follow are compiled, in
# threads.

EXAMPLE = 8
"""Number of people that a figure can show."""

Row = dict[str, Any]
"""Plain numbers and texts of a model on a test set, by column.

A metric has its mean under its name, the bounds of the 95 % interval under `NAME_low` and
`NAME_high` (None for too few blocks), and under `NAME_std` the standard deviation between seeds of
the noise. `comparison.with_tests` adds `NAME_p`. None where there is none."""


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
    step = progress_of(sum(len(test.entries) + len(test.forecasts) for test in tests))
    results: Iterable[Result] = _results(settings, tests)
    if run is not None:
        results = itertools.chain.from_iterable(
            run(functools.partial(_task, settings), tests)
        )
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
            needed.setdefault(model.forecaster, (model, {}))[1].update(scenes)
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
    forecaster, metrics = model.forecaster, chosen(settings.metrics)
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
    example = pad_scene(make_scene(np.zeros((1, model.config.obs_len, 2))), EXAMPLE)
    SceneForecaster(forecaster, model.params, samples=settings.samples, seed=0)(example)


def _evaluate_test(
    programs: Mapping[Forecaster, Future], test: Test, settings: Settings
) -> Iterator[Result]:
    windows, example, number = test.windows, None, 0
    for path, entry in [*test.entries, *test.forecasts]:
        compiling = 0.0
        if isinstance(entry, Forecasts):
            arguments = (
                entry.samples,
                entry.probability,
                windows,
                test.batches,
                settings.metrics,
            )
            runs = [score_samples(*arguments)]
        else:
            start = time.perf_counter()
            programs[entry.forecaster].result()
            compiling = time.perf_counter() - start
            runs = _runs(entry, test, settings)
        evaluation, spread = _averaged(runs, settings)
        if example is None:
            number = _telling(test, evaluation)
            example = single_scene(windows, number)
            # One size for most test sets, because each costs a program for every model.
            example = pad_scene(example, max(EXAMPLE, len(example.valid)))
        speed: dict[str, float | None] = dict.fromkeys(
            ("latency", "forecasts_per_second")
        )
        if isinstance(entry, Forecasts):
            rows = windows.rows(np.array([number]))
            futures = unpacked(entry.samples[:, rows], np.asarray(example.valid)[None])[
                :, 0
            ]
            speed["latency"] = entry.latency
        else:
            speed["latency"], futures = _latency(entry, example, settings)
            speed["forecasts_per_second"] = (
                evaluation.agents * evaluation.samples / evaluation.seconds
            )
        single = {
            name: score
            for name, score in evaluation.scores.items()
            if score.total.ndim == 1
        }
        errors = ErrorsByScene(single, windows.identity, windows.position.shape[1])
        name = settings.labels.get(path or "", entry.name)
        row = {
            "checkpoint": path,
            "model": name,
            **_identity(entry),
            **dataclasses.asdict(test.test_set),
            "samples": evaluation.samples,
            "seed": settings.seed,
            "seeds": settings.seeds,
            "scenes": windows.scenes,
            "agents": evaluation.agents,
            "blocks": len(errors.block_sums[0]),
            **_columns(errors, spread, f"{name} on {test.test_set.dataset}"),
            "seconds_compiling": compiling,
            "seconds_evaluating": evaluation.seconds,
            **speed,
        }
        horizons = {
            name: _band(score, errors)
            for name, score in evaluation.scores.items()
            if name not in single
        }
        yield Result(
            test.test_set, row, errors, example, futures, horizons, windows.period
        )


def _identity(entry: Model | Forecasts) -> Row:
    """See `Model.identity`; nothing is known of saved forecasts and of baselines."""
    if isinstance(entry, Forecasts) or not entry.params:
        columns = ("configuration", "training_data", "training_seed", "parameters")
        return dict.fromkeys(columns)
    return entry.identity


def _runs(model: Model, test: Test, settings: Settings) -> list[Evaluation]:
    """Scores of a model by each seed of the noise."""
    seeds = range(settings.seed, settings.seed + settings.seeds)
    options: Any = {"samples": settings.samples, "metrics": settings.metrics}
    return [
        score_forecaster(
            model.forecaster, model.params, test.batches, seed=seed, **options
        )
        for seed in (seeds if model.forecaster.noise.dim else seeds[:1])
    ]


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
        scores[name] = Score(*(np.mean(parts, axis=0) for parts in zip(*seeds)))
        means = [score.mean for score in seeds]
        if len(runs) > 1 and first.total.ndim == 1 and np.isfinite(means).all():
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
        bounds = (low, high) if np.isfinite([mean, low, high]).all() else (None, None)
        columns[name] = None if np.isnan(mean) else mean
        columns[f"{name}_low"], columns[f"{name}_high"] = bounds
        columns[f"{name}_std"] = spread.get(name)
    return columns


def _band(score: Score, errors: ErrorsByScene) -> np.ndarray:
    """[3, T] mean, low and high of a score with a value for each step, on the same scenes."""
    step_scores = {
        str(step): Score(total, score.count) for step, total in enumerate(score.total.T)
    }
    bounds = dataclasses.replace(errors, scores=step_scores).intervals().values()
    return np.where(
        np.isfinite(curves := np.vstack([score.mean, *zip(*bounds)])), curves, np.nan
    )


def _telling(test: Test, evaluation: Evaluation) -> int:
    """Choose the scene to show: of those with at most `EXAMPLE` people the one that is harder for
    the first entry than nine of ten, so people turn, and neither luck nor taste chooses it."""
    sizes = test.windows.sizes
    error = next(iter(evaluation.scores.values())).total / sizes
    small = np.flatnonzero(sizes <= max(EXAMPLE, sizes.min()))
    return int(small[np.argsort(error[small], kind="stable")[9 * len(small) // 10]])


def _latency(
    model: Model, scene: Scene, settings: Settings
) -> tuple[float, np.ndarray]:
    """Median seconds to forecast one scene, and its forecast [k, N, pred_len, 2], world metres."""
    forecast = SceneForecaster(
        model.forecaster, model.params, samples=settings.samples, seed=settings.seed
    )
    futures, moments = forecast(scene), [time.perf_counter()]
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
    pred_len, parts, seconds = windows.position.shape[1] - windows.obs_len, [], []
    for at, people in enumerate(windows.sizes):
        scene = windows.position[slice(*windows.bounds[at : at + 2]), : windows.obs_len]
        start = time.perf_counter()
        answer = predictor(scene.copy())
        seconds.append(time.perf_counter() - start)
        samples, likely = answer if isinstance(answer, tuple) else (answer, None)
        samples = np.asarray(_on_host(samples), np.float64)
        samples = samples[None] if samples.ndim == 3 else samples
        count = len(parts[0][0]) if parts else len(samples)
        if (
            samples.shape != (count, people, pred_len, 2)
            or not np.isfinite(samples).all()
        ):
            raise InputError(
                f"{name}: must return finite [{people}, {pred_len}, 2] or "
                f"[k, {people}, {pred_len}, 2], k the same for all scenes, not "
                f"{list(samples.shape)}"
            )
        if likely is not None:
            likely = np.asarray(_on_host(likely), np.float64)
            if likely.shape != (count,) or not np.isclose(likely.sum(), 1, atol=1e-3):
                raise InputError(
                    f"{name}: probabilities must be [{count}] with a sum of 1"
                )
        parts.append((samples, likely))
    samples, likely = zip(*parts)
    probability = (
        None if any(weights is None for weights in likely) else np.stack(likely, axis=1)
    )
    return Forecasts(
        name, np.concatenate(samples, axis=1), probability, float(np.median(seconds))
    )


def _on_host(array: Any) -> Any:
    """A torch tensor without its gradient, for numpy."""
    return array.detach().cpu() if hasattr(array, "detach") else array


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
    report = _report(path)
    if not path.exists():
        raise InputError(f"{path}: no such file")
    if report.get("format") != FORMAT:
        raise InputError(f"{path}: is not a report of ours of format {FORMAT}")
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
    foreign = [log] * (
        log.exists() and log.read_bytes()[:13] not in (b"", b'{"checkpoint"')
    )
    foreign += [path] * (path.exists() and not _report(path))
    if foreign:
        raise InputError(
            f"{foreign[0]}: is not a report of ours, so it is not overwritten"
        )
    return path.exists()


def _report(path: Path) -> dict[str, Any]:
    """The content of a report; nothing for anything else."""
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError, RecursionError):
        return {}
    return (
        content
        if isinstance(content, dict) and {"format", "rows"} <= set(content)
        else {}
    )


# Compare models, functions and saved forecasts on recordings, and test their
# differences.

OF_WINDOWS = ("obs_len", "pred_len", "period", "min_agents", "test_on", "cluster")
"""Options, beside those of reading, without effect where a file of forecasts has the windows."""


def evaluate(
    models: Model
    | Predictor
    | Sequence[Model | Predictor]
    | Mapping[str, Model | Predictor] = (),
    recordings: Any = None,
    *,
    forecasts: Path | str | Sequence[Path | str] | Mapping[str, Path | str] = (),
    samples: int = 20,
    seed: int = 0,
    min_agents: int = 2,
    metrics: Sequence[str] | None = None,
    baselines: Sequence[str] | None = None,
    obs_len: int | None = None,
    pred_len: int | None = None,
    period: float | None = None,
    partial: bool = False,
    **read: Any,
) -> pl.DataFrame:
    """Test models on recordings: a row for each model, beside the baselines; see `format_table`.

    Recordings are resampled to the steps that a model was trained on.

    Args:
        models: one or several, see `load_model`; also functions of numpy or torch, see
            `functions.Predictor`: `lambda observed: ...`. A mapping has their names in
            tables.
        recordings: a file, folder, dataframe of pandas or polars, `Tracks`, or several
            of these; None for those that the first file of forecasts holds.
        forecasts: files of forecasts, see `read_forecasts`, one or several or by name.
        samples: number of forecasts of each scene, k.
        seed: random seed of the noise.
        min_agents: scenes with fewer people are left out.
        metrics: names; default: those of every table, see `metric_names`.
        baselines: forecasters by name, see `baselines_of`.
        obs_len: steps observed where no model says how many; default: 8.
        pred_len: steps to forecast where no model says; default: those of the files,
            else 8.
        period: seconds between steps where no model says; default: 0.4.
        partial: test on the windows that all files of forecasts have, and leave out the
            rest.
        read: how files and dataframes are read, by the fields of `ReadOptions`:
            `unit="cm"`, ...

    Returns:
        Columns `model`, `dataset`, `scenes`, ...; for each metric its mean under its
        name, and the bounds of its 95 % interval under `NAME_low` and `NAME_high`;
        under `NAME_p` the p value of the paired test against the best model, see
        `with_tests`.

    Raises:
        InputError: for what cannot be read or does not match, and where nothing is to
            be tested.
    """
    refuse(Count, {"samples": samples, "min_agents": min_agents})
    loaded, functions = _apart(models)
    files = read_named(forecasts) if forecasts else {}
    lengths = {"obs_len": obs_len, "pred_len": pred_len, "period": period}
    for name, value in lengths.items():
        for model in loaded.values():
            if value not in (None, own := getattr(model.config, name)):
                raise InputError(f"{name} {value}: {model.name} has {own}")
    if partial and not files:
        raise InputError("partial: there are no files of forecasts")
    options = ReadOptions(**read)
    if recordings is None:
        if loaded or not files:
            raise InputError("recordings: there are none to test on")
        chosen = {**lengths, "min_agents": min_agents != 2, **read}
        tests = [test_of_file(*next(iter(files.items())), baselines, samples, chosen)]
    else:
        tracks = recordings_in(recordings, options)
        tested: dict[tuple[int, int, float], Entries] = {}
        for name, model in loaded.items():
            config = model.config
            key = (config.obs_len, config.pred_len, config.period)
            path = name if isinstance(models, Mapping) else None
            tested.setdefault(key, []).append((path, model))
        if not tested:
            steps = pred_len or next((file.steps for file in files.values()), LENGTH)
            tested[obs_len or LENGTH, steps, period or PERIOD] = []
        dataset = "+".join(dict.fromkeys(recording.recording for recording in tracks))
        tests = [
            make_test(
                TestSet(dataset, seen, ahead),
                [*baselines_of(baselines, seen, ahead, samples=samples), *entries],
                [on_grid(recording, step, options.max_gap) for recording in tracks],
                min_agents,
            )
            for (seen, ahead, step), entries in tested.items()
        ]
    if files or functions:
        tests = add_forecasts(tests, files, functions, partial=partial)
    labels = {name: name for name in loaded} | {
        str(file.path): name for name, file in files.items()
    }
    settings = Settings(
        samples, seed, None if metrics is None else tuple(metrics), labels=labels
    )
    return rows_frame(with_tests(list(evaluate_tests(tests, settings))))


def _apart(models: Any) -> tuple[dict[str, Model], dict[str, Predictor]]:
    """Models and functions by name or, where they have none, their number."""
    if isinstance(models, Model) or callable(models):
        models = [models]
    if not isinstance(models, Mapping):
        names = (getattr(model, "__name__", "").strip("<>") for model in models)
        models = {
            f"{name} {number}" if number and name else name or str(number): model
            for number, (name, model) in enumerate(zip(names, models))
        }
    for name, model in models.items():
        if not (isinstance(model, Model) or callable(model)):
            raise InputError(f"{name}: is no model or function: {type(model).__name__}")
    loaded = {name: model for name, model in models.items() if isinstance(model, Model)}
    return loaded, {name: model for name, model in models.items() if name not in loaded}


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
    if unused := [key for key in (*OF_WINDOWS, *vars(AS_IT_SAYS)) if options.get(key)]:
        raise InputError(
            f"{option(unused[0])}: has no effect on windows of a file of forecasts"
        )
    windows = windows_of(file)
    obs_len, pred_len = windows.obs_len, windows.position.shape[1] - windows.obs_len
    recordings = sorted({reading.recording for reading in windows.reading} - {""})
    test_set = TestSet("+".join(recordings) or name, obs_len, pred_len)
    entries = baselines_of(baselines, obs_len, pred_len, samples=samples)
    return Test(test_set, entries, windows)


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
        InputError: for a file that is of no test set, or that could be of several.
    """
    chosen: dict[int, dict[str, ForecastFile]] = {
        number: {} for number in range(len(tests))
    }
    for name, file in files.items():
        steps, own = (
            file.steps,
            set(map(str, [] if file.recordings is None else file.recordings)),
        )
        likely = [
            at for at, test in enumerate(tests) if test.test_set.pred_len == steps
        ]
        numbers = [at for at in likely if not own or own & _recordings(tests[at])]
        foreign = own - {
            recording for at in numbers for recording in _recordings(tests[at])
        }
        if not numbers or (foreign and not partial) or (not own and len(numbers) > 1):
            sets = ", ".join(dict.fromkeys(test.test_set.dataset for test in tests))
            lengths = ", ".join(
                map(str, sorted({test.test_set.pred_len for test in tests}))
            )
            kind = (
                f"recordings {', '.join(sorted(foreign)[:6])}"
                if foreign
                else "one recording"
            )
            raise InputError(
                f"{file.path}: forecasts of {steps} steps of {kind}; tested are {sets}, {lengths} "
                "steps: choose the data set and the steps that were forecast"
            )
        for number in numbers:
            chosen[number][name] = file
    return [
        _with_forecasts(test, chosen[number], predictors, partial)
        for number, test in enumerate(tests)
    ]


def _recordings(test: Test) -> set[str]:
    return {reading.recording for reading in test.windows.reading}


def _with_forecasts(
    test: Test,
    files: Mapping[str, ForecastFile],
    predictors: Mapping[str, Predictor],
    partial: bool,
) -> Test:
    windows, rows = test.windows, {}
    complete = np.ones(windows.scenes, bool)
    for name, file in files.items():
        covered, rows[name] = match(file, windows, partial=partial)
        complete &= covered
    if not complete.any():
        raise InputError(f"{', '.join(files)}: no window is in all of these files")
    people, windows = np.repeat(complete, windows.sizes), windows.take(complete)
    forecasts = [
        (str(file.path), matched(file, name, windows, rows[name][people]))
        for name, file in files.items()
    ]
    forecasts += [
        (None, predict_windows(function, name, windows))
        for name, function in predictors.items()
    ]
    return dataclasses.replace(test, windows=windows, forecasts=forecasts)


def with_tests(results: Sequence[Result]) -> list[Row]:
    """The rows of `results`, with the p value of each metric's paired test under `NAME_p`.

    The test is against the model of best mean on the same test set, which has None, and
    p is adjusted by Holm's method for the number of models. Scenes are paired.
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
        runs = [[results[number] for number in numbers] for numbers in members.values()]
        for metric, p_values in _p_values(runs).items():
            for numbers, p in zip(members.values(), p_values):
                for number in numbers:
                    rows[number][f"{metric}_p"] = p
    return rows


def _p_values(lines: list[list[Result]]) -> dict[str, list[float | None]]:
    """By metric, for each line of one test set, which has one training or several."""

    @functools.cache
    def difference(best: int, other: int) -> Difference:
        runs, other_runs = (
            [run.errors for run in lines[number]] for number in (best, other)
        )
        runs = runs * len(other_runs) if len(runs) == 1 else runs
        return paired_difference(
            runs, other_runs * len(runs) if len(other_runs) == 1 else other_runs
        )

    p_by_metric = {}
    for column, metric in enumerate(lines[0][0].errors.scores):
        values = [[run.row[metric] for run in line] for line in lines]
        means = [
            None if None in trainings else float(np.mean(trainings))
            for trainings in values
        ]

        def p_value(best: int, other: int, column: int = column) -> float:
            return difference(best, other).over_both.p_value(column)

        p_by_metric[metric] = against_best(
            means, METRICS[metric].higher_is_better, p_value
        )
    return p_by_metric
