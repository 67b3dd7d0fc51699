"""Results of an evaluation: every model of every test set, forecast, scored and timed.

While one model is evaluated, the programs of those that follow are compiled, in
threads.
"""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.windows import single_scene
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.forecasts import Forecasts
from neurosym_jax.evaluation.intervals import ErrorsByScene
from neurosym_jax.evaluation.plan import Test, TestSet
from neurosym_jax.evaluation.scoring import (
    Evaluation,
    Score,
    Scores,
    chosen,
    score_batch,
    score_forecaster,
    score_samples,
)
from neurosym_jax.forecasting.batched import unpacked
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.model import Model, SceneForecaster
from neurosym_jax.runtime.process import cpu_cores, progress_of
from neurosym_jax.scene import Scene, make_scene, pad_scene

__all__ = ["Result", "Row", "Settings", "evaluate_tests"]

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
