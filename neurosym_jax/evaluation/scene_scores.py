"""Scores, by any metrics, of scenes whose forecasts are known; of a test set, see `scoring`."""

import functools
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.data.batching import bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS, Metric, metric_names
from neurosym_jax.scene import Scene, model_dtype

__all__ = ["Score", "Scores", "chosen", "score", "score_scenes", "shapes"]


class Score(NamedTuple):
    """What a metric gives for S scenes, float64."""

    total: np.ndarray
    """[S], or [S, T] for a metric that has a value for each step: summed over what is counted."""
    count: np.ndarray
    """[S] agents, or what else the metric counts."""

    @property
    def mean(self) -> np.ndarray:
        """[], or [T], over all scenes; NaN where nothing was counted."""
        count = self.count.sum()
        return self.total.sum(axis=0) / count if count else np.full(self.total.shape[1:], np.nan)


Scores = dict[str, Score]
"""By the name of the metric."""


def chosen(names: Sequence[str] | None) -> tuple[Metric, ...]:
    """The metrics of these names; without, those that are computed by default."""
    return tuple(METRICS[name] for name in (metric_names() if names is None else names))


def score(
    forecast: ArrayLike,
    future: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    metrics: Sequence[str] | None = None,
) -> Scores:
    """Scores of one scene, S = 1.

    Args:
        forecast: [k, N, T, 2] metres in any frame.
        future: [N, T, 2] metres in the same frame, the truth.
        valid: [N] bool, who counts; what the others' positions are does not matter.
        metrics: names; default: those that are computed without being asked for.

    Raises:
        InputError: for a metric that fails, or is of the forecast without noise.
    """
    forecast, future = np.asarray(forecast, np.float64), np.asarray(future, np.float64)
    present = np.ones(len(future), bool) if valid is None else np.asarray(valid)
    # A program for each bucket, not for each number of people; and no loss far from the origin.
    slots = int(bucket_of(len(present)))
    origin = future[present].mean(axis=(0, 1)) if present.any() else np.zeros(2)
    places = np.zeros((len(forecast), 1, slots, *future.shape[1:]), model_dtype())
    places[:, 0, : len(present)][:, present] = forecast[:, present] - origin
    truth = np.zeros(places.shape[1:], places.dtype)
    truth[0, : len(present)][present] = future[present] - origin
    mask = np.zeros((1, slots), bool)
    mask[0, : len(present)] = present
    return score_scenes(chosen(metrics), places, None, truth, mask)


def score_scenes(
    metrics: tuple[Metric, ...],
    forecast: np.ndarray,
    noise_free: np.ndarray | None,
    future: np.ndarray,
    valid: np.ndarray,
) -> Scores:
    """Scores of B padded scenes.

    Args:
        metrics: to compute.
        forecast: [k, B, N, T, 2] metres.
        noise_free: [1, B, N, T, 2] metres, where a metric asks for it.
        future: [B, N, T, 2] metres.
        valid: [B, N] bool.

    Raises:
        InputError: for a metric that fails, gives something else, or lacks its forecast.
    """
    found: Scores = {}
    for wanted, given in ((False, forecast), (True, noise_free)):
        alike = [metric for metric in metrics if metric.noise_free == wanted]
        if alike and given is None:
            raise InputError(f"metric {alike[0].name}: samples alone lack the noise-free forecast")
        traced = tuple(metric for metric in alike if not metric.on_host)
        scores: Any = _traced_scores(traced, given, future, valid) if traced else ()
        found |= {metric.name: _host(*parts) for metric, parts in zip(traced, scores)}
        for metric in alike:
            if metric.on_host:
                of_scene = (len(valid),)
                parts = _computed(metric, of_scene, of_scene, given, future, valid)
                found[metric.name] = _host(*parts)
    return {metric.name: found[metric.name] for metric in metrics}


@functools.partial(jax.jit, static_argnums=0)
def _traced_scores(metrics: tuple[Metric, ...], forecast: Any, future: Any, valid: Any) -> Any:
    """`(total [B] or [B, T], count [B])` for each of `metrics`, see `score_scenes`."""

    def of_scene(forecast: Array, future: Array, valid: Array) -> list[Any]:
        steps = future.shape[1:2]
        return [_computed(metric, steps, (), forecast, future, valid) for metric in metrics]

    return jax.vmap(of_scene, in_axes=(1, 0, 0))(forecast, future, valid)


def _computed(
    metric: Metric, step_shape: tuple[int, ...], shape: tuple[int, ...], *given: Any
) -> tuple[Any, Any]:
    """Total and count of `metric` if they are of these shapes.

    Raises:
        InputError: for a metric that fails, or gives something else.
    """
    array = np.asarray if metric.on_host else jnp.asarray
    try:
        total, count = metric.compute(*given)
        total, count = array(total), array(count)
    except Exception as error:  # It may be somebody's own code, which can fail in any way.
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"metric {metric.name}: {reason}") from error
    if total.shape not in (shape, step_shape) or count.shape != shape:
        raise InputError(
            f"metric {metric.name}: a total {list(shape)} or {list(step_shape)} and a count "
            f"{list(shape)} are wanted, not {list(total.shape)} and {list(count.shape)}"
        )
    return total, count


def shapes(metrics: tuple[Metric, ...], scene: Scene, samples: int) -> Iterator[Any]:
    """Of the arrays that each metric gives for the scenes of one batch."""
    forecast = jax.ShapeDtypeStruct((samples, *scene.known_future.shape), scene.known_future.dtype)
    given = forecast, scene.known_future, scene.valid
    for metric in metrics:
        if metric.on_host:
            yield (np.zeros(len(scene.valid)),) * 2
        else:
            yield _traced_scores.eval_shape((metric,), *given)[0]


def _host(total: Any, count: Any) -> Score:
    return Score(np.asarray(total, np.float64), np.asarray(count, np.float64))
