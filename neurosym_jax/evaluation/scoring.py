"""Scores of forecasts by the metrics there are: of one scene, and of all scenes of a test set."""

import dataclasses
import functools
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.data.batching import Batch, bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.batched import Map, draw_noises, forecast_batches, unpacked
from neurosym_jax.evaluation.metrics import METRICS, Metric
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.runtime.processes import share, sum_over_processes
from neurosym_jax.scene import Scene, model_dtype

__all__ = [
    "Evaluation",
    "Score",
    "Scores",
    "chosen",
    "score",
    "score_forecaster",
    "score_futures",
    "score_group",
]

GROUP = 2**17
"""Samples of agent slots that are forecast before they are scored, some 25 MB; and what one of
several processes takes at a time."""


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


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """What a forecaster scores on the S scenes of a test set."""

    scores: Scores
    """Scene by scene, in the order of the windows."""
    agents: int
    """Agent windows."""
    samples: int
    """k; 1 for a deterministic forecaster, whatever was asked for."""
    seconds: float

    def mean(self, metric: str) -> float:
        """Of a metric with one value."""
        return float(self.scores[metric].mean)


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
        metrics: names; default: all that are registered.
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
    measured = chosen(metrics)
    return _on_host(measured, _score_scenes(measured, places, truth, mask))


@functools.partial(jax.jit, static_argnums=0)
def _score_scenes(metrics: tuple[Metric, ...], forecast: Any, future: Any, valid: Any) -> Any:
    """`(total [B] or [B, T], count [B])` of B padded scenes, for each of `metrics`.

    Args:
        metrics: to compute.
        forecast: [k, B, N, T, 2] metres.
        future: [B, N, T, 2] metres.
        valid: [B, N] bool.

    Raises:
        InputError: for a metric that fails, or gives something else.
    """

    def of_scene(forecast: Array, future: Array, valid: Array) -> list[Any]:
        return [_of_scene(metric, forecast, future, valid) for metric in metrics]

    return jax.vmap(of_scene, in_axes=(1, 0, 0))(forecast, future, valid)


def _of_scene(metric: Metric, forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    try:
        total, count = metric.compute(forecast, future, valid)
        total, count = jnp.asarray(total), jnp.asarray(count)
    except Exception as error:  # It may be somebody's own code, which can fail in any way.
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"metric {metric.name}: {reason}") from error
    if total.shape not in ((), future.shape[1:2]) or count.shape != ():
        raise InputError(
            f"metric {metric.name}: a total [] or [{future.shape[1]}] and a count [] are wanted, "
            f"not {list(total.shape)} and {list(count.shape)}"
        )
    return total, count


def score_forecaster(
    forecaster: Forecaster,
    params: Any,
    batches: Sequence[Batch],
    *,
    samples: int,
    seed: int,
    metrics: Sequence[str] | None = None,
) -> Evaluation:
    """Scores of `forecaster` on every scene of `batches`; the truth is in the scenes.

    Args:
        forecaster: what forecasts.
        params: its parameters.
        batches: see `make_batches`.
        samples: k.
        seed: determines, with the scene and the sample, the noise.
        metrics: names; default: all that are registered.

    Raises:
        InputError: for a seed out of range, more samples than there is memory for, or a metric
            that fails.
    """
    start = time.perf_counter()
    samples = samples if forecaster.noise.dim else 1
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
    found: dict[str, Score] = {}
    with ThreadPoolExecutor(cpu_cores()) as pool:
        done = {
            number: score_group(
                forecaster,
                params,
                [b.scene for b in group],
                samples,
                seed,
                measured,
                pool.map,
            )
            for number, group in share(groups)
        }
    # Every process fills in its scenes; those of the others are zero here.
    for metric, shapes in zip(measured, _shapes(measured, batches[0].scene, samples)):
        total, count = (np.zeros((scenes, *shape.shape[1:])) for shape in shapes)
        for number, of_batches in done.items():
            for batch, part in zip(groups[number], of_batches):
                there = batch.index >= 0
                total[batch.index[there]] = part[metric.name].total[there]
                count[batch.index[there]] = part[metric.name].count[there]
        found[metric.name] = Score(sum_over_processes(total), sum_over_processes(count))
    agents = sum(int(batch.scene.valid.sum()) for batch in batches)
    return Evaluation(found, agents, samples, time.perf_counter() - start)


def chosen(names: Sequence[str] | None) -> tuple[Metric, ...]:
    """The metrics of these names; all without."""
    return tuple(METRICS.values() if names is None else (METRICS[name] for name in names))


def _shapes(metrics: tuple[Metric, ...], scene: Scene, samples: int) -> Any:
    forecast = jax.ShapeDtypeStruct((samples, *scene.known_future.shape), scene.known_future.dtype)
    return _score_scenes.eval_shape(metrics, forecast, scene.known_future, scene.valid)


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
    metrics: tuple[Metric, ...],
    run: Map = map,
) -> list[Scores]:
    """Scores of each of some batches, all forecast at once."""
    noises = draw_noises(forecaster.noise, scenes, samples, seed)
    futures = forecast_batches(forecaster, params, scenes, noises, run)
    return score_futures(metrics, futures, scenes, run)


def score_futures(
    metrics: tuple[Metric, ...], futures: np.ndarray, scenes: Sequence[Scene], run: Map = map
) -> list[Scores]:
    """Scores of each of some batches, by the `futures [k, A, T, 2]` of their valid agents."""
    ends = np.cumsum([scene.valid.sum() for scene in scenes])
    pieces = np.split(futures, ends[:-1], axis=1)

    def of_batch(scene: Scene, piece: np.ndarray) -> Scores:
        places = unpacked(piece, np.asarray(scene.valid))
        return _on_host(metrics, _score_scenes(metrics, places, scene.known_future, scene.valid))

    return list(run(of_batch, scenes, pieces))


def _on_host(metrics: tuple[Metric, ...], scores: Sequence[tuple[Array, Array]]) -> Scores:
    return {
        metric.name: Score(*(np.asarray(part, np.float64) for part in parts))
        for metric, parts in zip(metrics, scores)
    }
