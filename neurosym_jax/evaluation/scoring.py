"""Scores of a forecaster on all scenes of a test set."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.metrics import Metric
from neurosym_jax.evaluation.scene_scores import Score, Scores, chosen, score_scenes, shapes
from neurosym_jax.forecasting.batched import Map, draw_noises, forecast_batches, unpacked
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.runtime.processes import share, sum_over_processes
from neurosym_jax.scene import Scene

__all__ = ["Evaluation", "score_forecaster", "score_futures", "score_group"]

GROUP = 2**17
"""Samples of agent slots that are forecast before they are scored, some 25 MB; and what one of
several processes takes at a time."""


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
        metrics: names; default: those that are computed without being asked for.

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
    for metric, of in zip(measured, shapes(measured, batches[0].scene, samples)):
        total, count = (np.zeros((scenes, *shape.shape[1:])) for shape in of)
        for number, of_batches in done.items():
            for batch, part in zip(groups[number], of_batches):
                there = batch.index >= 0
                total[batch.index[there]] = part[metric.name].total[there]
                count[batch.index[there]] = part[metric.name].count[there]
        found[metric.name] = Score(sum_over_processes(total), sum_over_processes(count))
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
    metrics: tuple[Metric, ...],
    run: Map = map,
) -> list[Scores]:
    """Scores of each of some batches, all forecast at once."""
    noises = draw_noises(forecaster.noise, scenes, samples, seed)
    if any(metric.noise_free for metric in metrics) and forecaster.noise.dim:
        # A sample more, which the other metrics do not see.
        noises = [np.concatenate([noise, np.zeros_like(noise[:1])]) for noise in noises]
    futures = forecast_batches(forecaster, params, scenes, noises, run)
    return score_futures(metrics, futures[:samples], scenes, run, futures[-1:])


def score_futures(
    metrics: tuple[Metric, ...],
    futures: np.ndarray,
    scenes: Sequence[Scene],
    run: Map = map,
    noise_free: np.ndarray | None = None,
) -> list[Scores]:
    """Scores of each of some batches, by the `futures [k, A, T, 2]` of their valid agents.

    `noise_free [1, A, T, 2]` is the forecast without noise, for metrics that are of that.
    """
    ends = np.cumsum([scene.valid.sum() for scene in scenes])[:-1]
    if not any(metric.noise_free for metric in metrics):
        noise_free = None
    alone = [None] * len(scenes) if noise_free is None else np.split(noise_free, ends, axis=1)

    def of_batch(scene: Scene, piece: np.ndarray, alone: np.ndarray | None) -> Scores:
        valid, future = np.asarray(scene.valid), np.asarray(scene.known_future)
        without = None if alone is None else unpacked(alone, valid)
        return score_scenes(metrics, unpacked(piece, valid), without, future, valid)

    return list(run(of_batch, scenes, np.split(futures, ends, axis=1), alone))
