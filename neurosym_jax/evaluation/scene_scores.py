"""Scores, by any metrics, of scenes whose forecasts are known; `scoring` has whole test sets."""

import functools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.data.batching import bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS, Metric, metric_names
from neurosym_jax.scene import Scene, model_dtype

__all__ = ["Metrics", "Score", "Scores", "chosen", "score", "score_scenes"]


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
        counted = self.count > 0
        shares = np.where(counted, self.count, 1)
        total = self.total / (shares if self.total.ndim == 1 else shares[:, None])
        return Score(total, counted.astype(float))


Scores = dict[str, Score]
"""By the name of the metric."""
Metrics = tuple[tuple[str, Metric], ...]
"""(name, metric), hashable for `jax.jit`."""


def chosen(names: Sequence[str] | None) -> Metrics:
    """The metrics of these names; by default those that are computed without being named."""
    return tuple((name, METRICS[name]) for name in (metric_names() if names is None else names))


def score(
    forecast: ArrayLike,
    future: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    observed: ArrayLike | None = None,
    extras: Mapping[str, ArrayLike] | None = None,
    metrics: Sequence[str] | None = None,
) -> Scores:
    """Scores of one scene, S = 1.

    Args:
        forecast: [k, N, T, 2] metres in any frame.
        future: [N, T, 2] metres in the same frame, the truth.
        valid: [N] bool, agents that count; positions of the others are ignored.
        observed: [N, obs_len, 2] metres in the same frame, for metrics of symbols.
        extras: [N, ...] of each agent by name, for metrics that ask for them.
        metrics: names; by default those that are computed without being named.

    Raises:
        InputError: for a metric that fails, or that needs the forecast without noise.
    """
    forecast, future = np.asarray(forecast, np.float64), np.asarray(future, np.float64)
    present = np.ones(len(future), bool) if valid is None else np.asarray(valid)
    # A program for each bucket, not for each number of people; and no loss far from the origin.
    slots = int(bucket_of(len(present)))
    origin = future[present].mean(axis=(0, 1)) if present.any() else np.zeros(2)
    seen = np.zeros((len(future), 1, 2)) if observed is None else np.asarray(observed, np.float64)

    def padded(values: np.ndarray, dtype: Any = None) -> np.ndarray:
        """[1, slots, ...] of `values [N, ...]`, zero where nobody counts."""
        array = np.zeros((1, slots, *values.shape[1:]), dtype or model_dtype())
        array[0, : len(present)][present] = values[present]
        return array

    scene = Scene(
        observed=padded(seen - origin),
        displacement=padded(np.diff(seen, axis=1, prepend=seen[:, :1])),
        valid=padded(present, bool),
        identity=np.zeros((1, 2), np.uint32),
        origin=None,
        future=padded(future - origin),
        extras={name: padded(v := np.asarray(of), v.dtype) for name, of in (extras or {}).items()},
    )
    samples = np.stack([padded(sample - origin) for sample in forecast])
    return score_scenes(chosen(metrics), samples, scene)


def score_scenes(
    metrics: Metrics, forecast: np.ndarray, scene: Scene, noise_free: np.ndarray | None = None
) -> Scores:
    """Scores of a batch of B padded scenes.

    Args:
        metrics: to compute.
        forecast: [k, B, N, T, 2] metres.
        scene: a batch, with the truth.
        noise_free: [1, B, N, T, 2] metres, where a metric asks for it.

    Raises:
        InputError: for a metric that fails, gives something else, or lacks its forecast.
    """
    scene = scene.replace(origin=None, identity=None)
    found: Scores = {}
    for wanted, given in ((False, forecast), (True, noise_free)):
        alike = [(name, metric) for name, metric in metrics if metric.noise_free == wanted]
        if not alike:
            continue
        if given is None:
            raise InputError(f"metric {alike[0][0]}: samples alone lack the noise-free forecast")
        traced = tuple(each for each in alike if not each[1].on_host)
        parts: Any = _traced(traced, given, scene) if traced else ()
        found |= {name: _score(*of) for (name, _), of in zip(traced, parts)}
        for name, metric in alike:
            if metric.on_host:
                values, weights = map(np.asarray, _computed(name, metric, given, scene))
                found[name] = _score(*_summed(name, values, weights, scene, np))
    return {name: found[name] for name, _ in metrics}


@functools.partial(jax.jit, static_argnums=0)
def _traced(metrics: Metrics, forecast: Any, scene: Scene) -> Any:
    """(total [B] or [B, T], count [B]) for each of `metrics`, see `score_scenes`."""

    def of_scene(forecast: Any, scene: Scene) -> list[Any]:
        return [
            tuple(map(jnp.asarray, _computed(name, metric, forecast, scene)))
            for name, metric in metrics
        ]

    parts = jax.vmap(of_scene, in_axes=(1, 0))(forecast, scene)
    return [
        _summed(name, values, weights, scene, jnp)
        for (name, _), (values, weights) in zip(metrics, parts)
    ]


def _computed(name: str, metric: Metric, forecast: Any, scene: Scene) -> tuple[Any, Any]:
    """The metric's values and weights; without weights, those of `Metric.compute`."""
    try:
        values = metric.compute(forecast, scene)
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


def _score(total: Any, count: Any) -> Score:
    return Score(np.asarray(total, np.float64), np.asarray(count, np.float64))
