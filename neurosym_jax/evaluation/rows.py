"""From cases to rows: every model beside the baselines on its test set, as the JSON has it."""

import dataclasses
import time
import warnings
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from tqdm import tqdm

from neurosym_jax.data.batching import Batch, make_batches, single_scene
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.evaluation.cases import Case
from neurosym_jax.evaluation.paired import ErrorsByScene
from neurosym_jax.evaluation.programs import compile_ahead, compile_single_ahead, wait_for
from neurosym_jax.evaluation.scoring import Evaluation, Scores, score_forecaster
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.plotting.evaluation import Shown
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.scene import Scene, pad_scene

__all__ = ["Row", "Settings", "evaluate_cases", "latency", "metric_means"]

SHOWN = 8
"""People that a figure can show with ease."""

Row = dict[str, Any]
"""One row of the JSON."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """How every case is evaluated."""

    samples: int = 20
    """Forecasts of each scene, k."""
    seed: int = 0
    """Determines, with the scene and the sample, the noise."""
    min_agents: int = 2
    """Scenes with fewer people are left out."""
    metrics: tuple[str, ...] | None = None
    """Names; None for all."""


@dataclasses.dataclass(frozen=True, eq=False)
class _Test:
    """A case, its recordings cut, and what takes part in it."""

    case: Case
    windows: Windows
    batches: list[Batch]
    contestants: list[tuple[str | None, str, Forecaster, Any]]
    """(checkpoint, model, forecaster, params), plain constant velocity first."""
    loading: float
    """Seconds."""


def evaluate_cases(
    cases: Sequence[Case], settings: Settings
) -> tuple[list[Row], list[Shown], list[ErrorsByScene]]:
    """Rows of all cases in their order, the baselines before the models; for each also what to
    draw and its errors scene by scene.

    Raises:
        InputError: for recordings without a single window.
    """
    rows: list[Row] = []
    shown: list[Shown] = []
    errors: list[ErrorsByScene] = []
    tests = [_cut(case, settings) for case in cases]
    total = sum(len(test.contestants) for test in tests)
    pool = ThreadPoolExecutor(cpu_cores())
    try:
        for test in tests:
            for _, _, forecaster, params in test.contestants:
                compile_ahead(
                    pool, forecaster, params, test.batches, settings.samples, settings.metrics
                )
                _compile_single(pool, test, SHOWN, forecaster, params, settings)
        with tqdm(total=total, desc="evaluating", unit="model", disable=None, leave=False) as bar:
            for test in tests:
                for row, of_row, by_scene in _evaluate_test(pool, test, settings):
                    rows.append(row)
                    shown.append(of_row)
                    errors.append(by_scene)
                    bar.update()
    finally:
        pool.shutdown(cancel_futures=True)
    return rows, shown, errors


def _cut(case: Case, settings: Settings) -> _Test:
    start = time.perf_counter()
    lengths = case.test_set.obs_len, case.test_set.pred_len
    windows = cut_windows(case.recordings, *lengths, min_agents=settings.min_agents)
    for path, model in case.models:
        trained = model.config.period
        if abs(trained - windows.period) > 0.01 * trained:
            warnings.warn(
                f"{path}: was trained on steps of {trained:g} s and is tested on steps of "
                f"{windows.period:g} s (--period {trained:g} would bring the test to its own)",
                InputWarning,
                stacklevel=2,
            )
    batches = make_batches(windows)
    contestants = [
        (None, "constant velocity", ConstantVelocity(lengths[1]), ()),
        (None, "constant velocity, sampled", ConstantVelocitySampled(lengths[1]), ()),
        *((path, model.name, model.forecaster, model.params) for path, model in case.models),
    ]
    return _Test(case, windows, batches, contestants, time.perf_counter() - start)


def _compile_single(
    pool: Executor, test: _Test, slots: int, forecaster: Forecaster, params: Any, settings: Settings
) -> Future:
    obs_len, samples = test.windows.obs_len, settings.samples
    return compile_single_ahead(pool, forecaster, params, slots, obs_len, samples)


def _evaluate_test(
    pool: Executor, test: _Test, settings: Settings
) -> Iterator[tuple[Row, Shown, ErrorsByScene]]:
    """The baselines and then the case's checkpoints."""
    test_set, windows, loading = test.case.test_set, test.windows, test.loading
    common = {"samples": settings.samples, "seed": settings.seed}
    example = None
    for checkpoint, name, forecaster, params in test.contestants:
        samples = settings.samples if forecaster.noise.dim else 1
        compiling = wait_for(
            compile_ahead(pool, forecaster, params, test.batches, samples, settings.metrics)
        )
        result = score_forecaster(
            forecaster, params, test.batches, **common, metrics=settings.metrics
        )
        if example is None:
            example = single_scene(windows, _typical(windows, result))
            # One size for most test sets, because each costs a program for every model.
            example = pad_scene(example, max(SHOWN, len(example.valid)))
        slots = len(example.valid)
        compiling += wait_for([_compile_single(pool, test, slots, forecaster, params, settings)])
        seconds, forecast = latency(forecaster, params, example, **common)
        metrics = metric_means(result.scores, f"{name} on {test_set.scene}")
        row = {
            "checkpoint": checkpoint,
            "model": name,
            **dataclasses.asdict(test_set),
            "samples": result.samples,
            "seed": settings.seed,
            "scenes": windows.scenes,
            "agents": result.agents,
            "recordings": [how.to_json() for how in windows.reading],
            "joint": {"ade": metrics.get("joint_ade"), "fde": metrics.get("joint_fde")},
            "marginal": {"ade": metrics.get("marginal_ade"), "fde": metrics.get("marginal_fde")},
            "collision_rate": metrics.get("collision_rate"),
            "metrics": metrics,
            "seconds": {
                "loading": loading,
                "compiling": compiling,
                "evaluating": result.seconds,
                "latency": seconds,
            },
            "forecasts_per_second": result.agents * result.samples / result.seconds,
        }
        by_scene = ErrorsByScene.of_scores(
            result.scores, windows.identity, test_set.obs_len + test_set.pred_len
        )
        score = float(next(iter(result.scores.values())).mean)
        horizons = {name: each.mean for name, each in result.scores.items() if each.total.ndim == 2}
        shown = Shown(test_set, name, example, forecast, horizons, windows.period, score)
        yield row, shown, by_scene
        loading = 0.0


def _typical(windows: Windows, constant_velocity: Evaluation) -> int:
    """The scene to show: of those with at most `SHOWN` people, the one that constant velocity
    forecasts with the median error, so that neither luck nor taste chooses it."""
    error = next(iter(constant_velocity.scores.values())).total / windows.sizes
    small = np.flatnonzero(windows.sizes <= max(SHOWN, windows.sizes.min()))
    return int(small[np.argsort(error[small], kind="stable")[len(small) // 2]])


def metric_means(scores: Scores, of: str) -> dict[str, float | None]:
    """Means of the metrics that have one value, None where nothing was counted; for JSON.

    Raises:
        InputError: naming `of`, for a metric that is not finite.
    """
    means: dict[str, float | None] = {}
    for name, each in scores.items():
        if each.total.ndim == 1:
            means[name] = float(each.mean) if each.count.sum() else None
            if not np.isfinite(each.total).all():
                raise InputError(f"metric {name}: is not finite for {of}")
    return means


def latency(
    forecaster: Forecaster, params: Any, scene: Scene, *, samples: int, seed: int
) -> tuple[float, np.ndarray]:
    """Median seconds from one scene to its forecast `[k, N, pred_len, 2]`, world metres."""
    forecast = SceneForecaster(forecaster, params, samples=samples, seed=seed)
    futures, seconds = np.empty(0), []
    for _ in range(11):
        start = time.perf_counter()
        futures = forecast(scene)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:])), futures
