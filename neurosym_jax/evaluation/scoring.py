"""Scores of a forecaster on all scenes of a test set."""

import dataclasses
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.scene_scores import Metrics, Score, Scores, chosen, score_scenes
from neurosym_jax.forecasting.batched import Map, draw_noises, forecast_batches, unpacked
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.scene import Scene

__all__ = ["Evaluation", "score_forecaster", "score_futures", "score_group", "score_seeds"]

GROUP = 2**17
"""Samples of agent slots that are forecast before they are scored, about 25 MB."""


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
        """Mean of a metric with one value."""
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
        forecaster: makes the forecasts.
        params: its parameters.
        batches: see `make_batches`.
        samples: k.
        seed: of the noise, with the scene and the sample.
        metrics: names; by default those that are computed without being named.

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


def score_seeds(
    forecaster: Forecaster,
    params: Any,
    batches: Sequence[Batch],
    *,
    seeds: Sequence[int],
    by_scene: bool = False,
    **how: Any,
) -> tuple[Evaluation, dict[str, float]]:
    """Mean of `score_forecaster` over seeds of the noise; one seed where no noise is drawn.

    Args:
        forecaster: see `score_forecaster`, as all but the following.
        params: see there.
        batches: see there.
        seeds: of the noise.
        by_scene: give each scene its mean in place of its sum, so that all weigh the same.
        **how: see there.

    Returns:
        The scores, with the seconds of one seed; and, of several seeds, the standard deviation
        between their means by metric.
    """
    seeds = seeds if forecaster.noise.dim else seeds[:1]
    runs = [score_forecaster(forecaster, params, batches, seed=seed, **how) for seed in seeds]
    of_runs = [run.scores for run in runs]
    if by_scene:
        of_runs = [{name: each.of_each_scene() for name, each in of.items()} for of in of_runs]
    scores = {
        name: Score(*(np.mean(parts, axis=0) for parts in zip(*(of[name] for of in of_runs))))
        for name in of_runs[0]
    }
    seconds = sum(run.seconds for run in runs) / len(runs)
    found = dataclasses.replace(runs[0], scores=scores, seconds=seconds)
    means = {name: [of[name].mean for of in of_runs] for name in scores}
    spread = {
        name: float(np.std(of, ddof=1))
        for name, of in means.items()
        if len(runs) > 1 and np.ndim(of[0]) == 0 and np.isfinite(of).all()
    }
    return found, spread


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
    if any(metric.noise_free for _, metric in metrics) and forecaster.noise.dim:
        # A sample more, which the other metrics do not see.
        noises = [np.concatenate([noise, np.zeros_like(noise[:1])]) for noise in noises]
    futures = forecast_batches(forecaster, params, scenes, noises, run)
    return score_futures(metrics, futures[:samples], scenes, run, futures[-1:])


def score_futures(
    metrics: Metrics,
    futures: np.ndarray,
    scenes: Sequence[Scene],
    run: Map = map,
    noise_free: np.ndarray | None = None,
) -> list[Scores]:
    """Scores of each of some batches, by the `futures [k, A, T, 2]` of their valid agents.

    `noise_free [1, A, T, 2]` is the forecast without noise, for metrics of that.
    """
    ends = np.cumsum([scene.valid.sum() for scene in scenes])[:-1]
    if not any(metric.noise_free for _, metric in metrics):
        noise_free = None
    alone = [None] * len(scenes) if noise_free is None else np.split(noise_free, ends, axis=1)

    def of_batch(scene: Scene, piece: np.ndarray, alone: np.ndarray | None) -> Scores:
        valid = np.asarray(scene.valid)
        without = None if alone is None else unpacked(alone, valid)
        return score_scenes(metrics, unpacked(piece, valid), scene, without)

    return list(run(of_batch, scenes, np.split(futures, ends, axis=1), alone))
