"""Scores of forecasts by any metrics: of a batch, of a forecaster on a test set."""

import functools
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS, Metric, metric_names
from neurosym_jax.evaluation.neighbours import without_neighbours
from neurosym_jax.forecasting.batched import (
    Map,
    distribution_batches,
    draw_noises,
    forecast_batches,
    unpacked,
)
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.scene import Scene

__all__ = [
    "Evaluation",
    "Metrics",
    "Score",
    "Scores",
    "chosen",
    "score_forecaster",
    "score_futures",
    "score_group",
    "score_scenes",
]

GROUP = 2**17
"""Samples of agent slots that are forecast before they are scored, about 25 MB."""


class Score(NamedTuple):
    """What a metric gives for S scenes, float64."""

    total: np.ndarray
    """[S], or [S, T] for a metric with a value for each step: sum of weighted values."""
    count: np.ndarray
    """[S] sum of the weights: the number of agents, unless the metric says otherwise."""

    @property
    def mean(self) -> np.ndarray:
        """[] or [T] mean over all scenes; NaN where nothing was counted."""
        count = self.count.sum()
        return self.total.sum(axis=0) / count if count else np.full(self.total.shape[1:], np.nan)

    def of_each_scene(self) -> "Score":
        """Return the mean of each scene with weight 1, in place of its sum."""
        shares = np.where(self.count > 0, self.count, 1)
        total = self.total / shares.reshape(-1, *[1] * (self.total.ndim - 1))
        return Score(total, (self.count > 0).astype(float))


Scores = dict[str, Score]
"""By the name of the metric."""
Metrics = tuple[tuple[str, Metric], ...]
"""(name, metric), hashable for `jax.jit`."""


class Evaluation(NamedTuple):
    """What a forecaster scores on the S scenes of a test set."""

    scores: Scores
    """Scene by scene, in the order of the windows."""
    agents: int
    samples: int
    """k; 1 for a deterministic forecaster."""
    seconds: float

    def mean(self, metric: str) -> float:
        """Mean of a metric with one value."""
        return float(self.scores[metric].mean)


def chosen(names: Sequence[str] | None) -> Metrics:
    """The metrics of these names; by default those that are computed without being named."""
    return tuple((name, METRICS[name]) for name in (metric_names() if names is None else names))


def score_scenes(
    metrics: Metrics,
    forecasts: Mapping[str, np.ndarray],
    scene: Scene,
    probability: np.ndarray | None = None,
) -> Scores:
    """Scores of a batch of B padded scenes by forecasts [k, B, N, T, 2] metres, see `Metric.given`.

    `probability` [k, B] is that of the samples, None where all have the same.

    Raises:
        InputError: for a metric that fails, gives something else, or lacks its forecast.
    """
    scene = scene.replace(origin=None, identity=None)
    found: dict[str, Any] = {}
    for kind in dict.fromkeys(metric.given for _, metric in metrics):
        alike = [(name, metric) for name, metric in metrics if metric.given == kind]
        if kind not in forecasts:
            raise InputError(f"metric {alike[0][0]}: samples alone have no {kind} forecast")
        given, likely = forecasts[kind], probability if kind == "samples" else None
        traced = tuple(each for each in alike if not each[1].on_host)
        parts: Any = _traced(traced, given, scene, likely) if traced else ()
        found |= {name: of for (name, _), of in zip(traced, parts)}
        for name, metric in alike:
            if metric.on_host:
                values, weights = map(np.asarray, _computed(name, metric, given, scene, likely))
                found[name] = _summed(name, values, weights, scene, np)
    return {name: Score(*(np.asarray(of, np.float64) for of in found[name])) for name, _ in metrics}


@functools.partial(jax.jit, static_argnums=0)
def _traced(metrics: Metrics, forecast: Any, scene: Scene, probability: Any) -> Any:
    """(total [B] or [B, T], count [B]) for each of `metrics`, see `score_scenes`."""

    def of_scene(forecast: Any, scene: Scene, probability: Any) -> list[Any]:
        return [
            tuple(map(jnp.asarray, _computed(name, metric, forecast, scene, probability)))
            for name, metric in metrics
        ]

    parts = jax.vmap(of_scene, in_axes=(1, 0, 1))(forecast, scene, probability)
    return [
        _summed(name, values, weights, scene, jnp)
        for (name, _), (values, weights) in zip(metrics, parts)
    ]


def _computed(
    name: str, metric: Metric, forecast: Any, scene: Scene, probability: Any
) -> tuple[Any, Any]:
    """The metric's values and weights; without weights, those of `Metric.compute`."""
    try:
        more = (probability,) if metric.weighted else ()
        values = metric.compute(forecast, scene, *more)
        if isinstance(values, tuple):
            values, weights = values
            return values, weights
        of_scenes = np.ndim(values) == np.ndim(scene.valid) - 1
        valid: Any = scene.valid
        return values, valid.sum(axis=-1) if of_scenes else valid
    except Exception as error:  # A plugin's code can fail in any way.
        raise InputError(f"metric {name}: {type(error).__name__}: {error}") from error


def _summed(name: str, values: Any, weights: Any, scene: Scene, xp: Any) -> tuple[Any, Any]:
    """(total [B] or [B, T], count [B]) of a batch's values and weights.

    Raises:
        InputError: for shapes that are none of a metric's.
    """
    batch, slots, steps = scene.known_future.shape[:3]
    shapes = ((batch,), (batch, slots), (batch, slots, steps))
    if values.shape not in shapes or weights.shape != values.shape[:2]:
        raise InputError(
            f"metric {name}: values [], [{slots}] or [{slots}, {steps}] of a scene are wanted and "
            f"weights [] or [{slots}] alike, not {list(values.shape[1:])} and "
            f"{list(weights.shape[1:])}"
        )
    if values.ndim == 1:
        return xp.where(weights > 0, values * weights, 0), weights
    weights = xp.where(scene.valid, weights, 0)
    shares = weights[..., None] if values.ndim == 3 else weights
    return xp.where(shares > 0, values * shares, 0).sum(axis=1), weights.sum(axis=1)


def score_forecaster(
    forecaster: Forecaster,
    params: Any,
    batches: Sequence[Batch],
    *,
    samples: int,
    seed: int,
    metrics: Sequence[str] | None = None,
) -> Evaluation:
    """Scores of `forecaster` on every scene of `batches`, see `make_batches`."""
    start = time.perf_counter()
    samples = forecaster.count(samples)
    groups = list(_groups(batches, samples))
    slots = max(sum(batch.scene.valid.size for batch in group) for group in groups)
    refuse_beyond_memory(
        f"evaluating {slots} people at once with {samples} samples",
        # Futures, a copy in their places, offsets from the truth; and the noise.
        4.0 * samples * slots * (6 * forecaster.pred_len + 2 * forecaster.noise.dim),
        "ask for fewer samples",
    )
    measured = chosen(metrics)
    scenes = sum(int((batch.index >= 0).sum()) for batch in batches)
    found: Scores = {}
    with ThreadPoolExecutor(cpu_cores()) as pool:
        for group in groups:
            given = (forecaster, params, [batch.scene for batch in group], samples, seed)
            for batch, scores in zip(group, score_group(*given, measured, pool.map)):
                there = batch.index >= 0
                for name, part in scores.items():
                    if name not in found:
                        shape = (scenes, *part.total.shape[1:])
                        found[name] = Score(np.zeros(shape), np.zeros(scenes))
                    for whole, of in zip(found[name], part):
                        whole[batch.index[there]] = of[there]
    agents = sum(int(batch.scene.valid.sum()) for batch in batches)
    return Evaluation(found, agents, samples, time.perf_counter() - start)


def _groups(batches: Sequence[Batch], samples: int) -> Iterator[list[Batch]]:
    """`batches` in pieces whose futures fit into memory, however many windows there are."""
    group: list[Batch] = []
    for batch in batches:
        group.append(batch)
        if sum(each.scene.valid.size for each in group) * samples >= GROUP:
            yield group
            group = []
    if group:
        yield group


def score_group(
    forecaster: Forecaster,
    params: Any,
    scenes: Sequence[Scene],
    samples: int,
    seed: int,
    metrics: Metrics,
    run: Map = map,
) -> list[Scores]:
    """Scores of each of some batches, all forecast at once."""
    noises = draw_noises(forecaster.noise, scenes, samples, seed)
    kinds = {metric.given for _, metric in metrics}
    if "noise_free" in kinds and forecaster.noise.dim:
        # A sample more, which the other metrics do not see.
        noises = [np.concatenate([noise, np.zeros_like(noise[:1])]) for noise in noises]
    futures, probability = distribution_batches(forecaster, params, scenes, noises, run)
    forecasts: dict[str, np.ndarray] = {"samples": futures[:samples], "noise_free": futures[-1:]}
    if probability is not None:
        sizes = np.concatenate([scene.valid.sum(axis=1) for scene in scenes])
        likely = np.repeat(probability.argmax(axis=0), sizes)
        forecasts["noise_free"] = futures[likely, np.arange(len(likely))][None]
    if "moves" in kinds:
        people, drawn = zip(*map(without_neighbours, scenes, noises))
        singles = forecast_batches(forecaster, params, people, drawn, run)
        forecasts["moves"] = (futures - singles)[:samples]
    return score_futures(metrics, forecasts, scenes, run, probability)


def score_futures(
    metrics: Metrics,
    forecasts: Mapping[str, np.ndarray],
    scenes: Sequence[Scene],
    run: Map = map,
    probability: np.ndarray | None = None,
) -> list[Scores]:
    """Scores of each of some batches by forecasts [k, A, T, 2] of their agents.

    `probability` [k, S] is that of the samples in all scenes, None where all have the same.
    """
    ends = np.cumsum([scene.valid.sum() for scene in scenes])
    starts = ends - [scene.valid.sum() for scene in scenes]
    kinds = {metric.given for _, metric in metrics} & forecasts.keys()
    likely: Sequence[np.ndarray | None] = [None] * len(scenes)
    if probability is not None:
        likely = np.split(probability, np.cumsum([len(each.valid) for each in scenes])[:-1], axis=1)

    def of_batch(scene: Scene, start: int, end: int, likely: np.ndarray | None) -> Scores:
        valid = np.asarray(scene.valid)
        pieces = {kind: unpacked(forecasts[kind][:, start:end], valid) for kind in kinds}
        return score_scenes(metrics, pieces, scene, likely)

    return list(run(of_batch, scenes, starts, ends, likely))
