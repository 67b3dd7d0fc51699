"""From test sets to results: every model beside the baselines, forecast, scored and timed."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from neurosym_jax.configuration import refuse_below
from neurosym_jax.data.batching import single_scene
from neurosym_jax.data.tracks import Tracks, on_grid
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.load import Test, make_test
from neurosym_jax.evaluation.paired import ErrorsByScene
from neurosym_jax.evaluation.plan import BASELINES, Entries, TestSet, baseline
from neurosym_jax.evaluation.programs import Programs
from neurosym_jax.evaluation.scene_scores import Scores
from neurosym_jax.evaluation.scoring import Evaluation
from neurosym_jax.evaluation.seeds import score_seeds
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.runtime.progress import Progress
from neurosym_jax.scene import Scene, pad_scene

__all__ = [
    "Result",
    "Row",
    "Settings",
    "each_result",
    "evaluate",
    "evaluate_tests",
    "latency",
]

EXAMPLE = 8
"""People that a figure can show with ease."""

Row = dict[str, Any]
"""One row of the JSON."""


@dataclasses.dataclass(frozen=True)
class Settings:
    """How every test set is evaluated."""

    samples: int = 20
    """Forecasts of each scene, k."""
    seed: int = 0
    """Determines, with the scene and the sample, the noise."""
    metrics: tuple[str, ...] | None = None
    """Names; None for those of every table."""
    seeds: int = 1
    """Noise is drawn anew for so many seeds, from `seed` on; means are over all of them."""
    scenes_alike: bool = False
    """Whether means are over scenes, each weighing the same, and not over people."""


@dataclasses.dataclass(frozen=True, eq=False)
class Result:
    """What came out for one model on one test set."""

    test_set: TestSet
    row: Row
    """For JSON and tables."""
    errors: ErrorsByScene
    example: Scene
    """A typical scene of the test set, padded, with its truth; the same for all models."""
    forecast: np.ndarray
    """[k, N, pred_len, 2] world metres, of the example."""
    horizons: dict[str, np.ndarray]
    """[pred_len] means over the test set, of the metrics that have a value for each step."""
    period: float
    """Seconds between steps."""

    @property
    def name(self) -> str:
        """Of the model."""
        return self.row["model"]


def evaluate(
    models: Model | Sequence[Model],
    recordings: Tracks | Sequence[Tracks],
    *,
    samples: int = 20,
    seed: int = 0,
    min_agents: int = 2,
    metrics: Sequence[str] | None = None,
    baselines: Sequence[str] = BASELINES,
) -> list[Row]:
    """Test models on recordings: the rows that `neurosym evaluate` writes; see `format_table`.

    Recordings are brought to the steps that a model was trained on.

    Args:
        models: one or several, see `load_model`.
        recordings: see `make_tracks` and `read_any`.
        samples: forecasts of each scene, k.
        seed: determines, with the scene and the sample, the noise.
        min_agents: scenes with fewer people are left out.
        metrics: names; default: those of every table, see `metric_names`.
        baselines: forecasters without parameters, by name.

    Raises:
        InputError: for recordings without a single window, or numbers out of range.
    """
    refuse_below(1, {"samples": samples, "min_agents": min_agents})
    models = [models] if isinstance(models, Model) else models
    recordings = [recordings] if isinstance(recordings, Tracks) else recordings
    name = "+".join(dict.fromkeys(tracks.recording for tracks in recordings))
    tested: dict[tuple[int, int, float], Entries] = {}
    for model in models:
        config = model.config
        key = (config.obs_len, config.pred_len, config.period)
        tested.setdefault(key, []).append((None, model))
    tests = [
        make_test(
            TestSet(name, obs_len, pred_len),
            [*((None, baseline(each, obs_len, pred_len)) for each in baselines), *entries],
            [on_grid(tracks, period) for tracks in recordings],
            min_agents,
        )
        for (obs_len, pred_len, period), entries in tested.items()
    ]
    settings = Settings(samples, seed, None if metrics is None else tuple(metrics))
    return [result.row for result in evaluate_tests(tests, settings)]


def evaluate_tests(tests: Sequence[Test], settings: Settings) -> list[Result]:
    """Results of all tests in their order, the entries of each in theirs.

    Raises:
        InputError: for numbers out of range, or a metric that fails.
    """
    return list(each_result(tests, settings))


def each_result(tests: Sequence[Test], settings: Settings) -> Iterator[Result]:
    """As `evaluate_tests`, each as it comes."""
    total = sum(len(test.entries) for test in tests)
    with (
        Programs(settings.samples, settings.metrics) as programs,
        Progress(total, "evaluating", "model") as progress,
    ):
        for test in tests:
            for _, model in test.entries:
                programs.of_batches(model, test.batches)
                programs.of_one_scene(model, EXAMPLE)
        for test in tests:
            for result in _evaluate_test(programs, test, settings):
                progress.step(f"{result.name} on {result.test_set.dataset}")
                yield result


def _evaluate_test(programs: Programs, test: Test, settings: Settings) -> Iterator[Result]:
    test_set, windows, loading = test.test_set, test.windows, test.seconds
    example = None
    for path, model in test.entries:
        compiling = programs.wait_for(programs.of_batches(model, test.batches))
        found, spread = score_seeds(
            model.forecaster,
            model.params,
            test.batches,
            samples=settings.samples,
            seeds=range(settings.seed, settings.seed + settings.seeds),
            metrics=settings.metrics,
            scenes_alike=settings.scenes_alike,
        )
        if example is None:
            example = single_scene(windows, _typical(test, found))
            # One size for most test sets, because each costs a program for every model.
            example = pad_scene(example, max(EXAMPLE, len(example.valid)))
        slots = len(example.valid)
        compiling += programs.wait_for([programs.of_one_scene(model, slots)])
        common = {"samples": settings.samples, "seed": settings.seed}
        seconds, forecast = latency(model.forecaster, model.params, example, **common)
        metrics = _means(found.scores, f"{model.name} on {test_set.dataset}")
        steps = test_set.obs_len + test_set.pred_len
        errors = ErrorsByScene.of_scores(found.scores, windows.identity, steps)
        row = {
            "checkpoint": path,
            "model": model.name,
            "scene": test_set.dataset,
            "obs_len": test_set.obs_len,
            "pred_len": test_set.pred_len,
            "samples": found.samples,
            "seed": settings.seed,
            "seeds": settings.seeds,
            "scenes": windows.scenes,
            "agents": found.agents,
            "recordings": [how.to_json() for how in windows.reading],
            **{
                best: {error: metrics.get(f"{best}_{error}") for error in ("ade", "fde")}
                for best in ("joint", "marginal")
            },
            "collision_rate": metrics.get("collision_rate"),
            "metrics": metrics,
            "spread": spread,
            "intervals": {name: list(of) for name, of in errors.intervals().items()},
            "blocks": int(errors.blocks.max()) + 1,
            "seconds": {
                "loading": loading,
                "compiling": compiling,
                "evaluating": found.seconds,
                "latency": seconds,
            },
            "forecasts_per_second": found.agents * found.samples / found.seconds,
        }
        horizons = {name: of.mean for name, of in found.scores.items() if of.total.ndim == 2}
        yield Result(test_set, row, errors, example, forecast, horizons, windows.period)
        loading = 0.0


def _typical(test: Test, found: Evaluation) -> int:
    """The scene to show: of those with at most `EXAMPLE` people, the one that the first entry
    forecasts with the median error, so that neither luck nor taste chooses it."""
    sizes = test.windows.sizes
    error = next(iter(found.scores.values())).total / sizes
    small = np.flatnonzero(sizes <= max(EXAMPLE, sizes.min()))
    return int(small[np.argsort(error[small], kind="stable")[len(small) // 2]])


def _means(scores: Scores, of: str) -> dict[str, float | None]:
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
