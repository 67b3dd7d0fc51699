"""Scores of a test set by several seeds of the noise: their mean, and how much they spread."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.scene_scores import Score
from neurosym_jax.evaluation.scoring import Evaluation, score_forecaster
from neurosym_jax.forecasting.forecaster import Forecaster

__all__ = ["score_seeds"]


def score_seeds(
    forecaster: Forecaster,
    params: Any,
    batches: Sequence[Batch],
    *,
    samples: int,
    seeds: Sequence[int],
    metrics: Sequence[str] | None = None,
    scenes_alike: bool = False,
) -> tuple[Evaluation, dict[str, float] | None]:
    """As `score_forecaster`, the mean of `seeds`; one is enough where nothing is drawn.

    With `scenes_alike` each scene has its mean in place of its sum, so that all weigh the same.

    Returns:
        Scores, with the seconds of one seed; and by metric the standard deviation between the means
        of the seeds, None of a single one.
    """
    how: Any = {"samples": samples, "metrics": metrics}
    runs = [
        score_forecaster(forecaster, params, batches, seed=seed, **how)
        for seed in (seeds if forecaster.noise.dim else seeds[:1])
    ]
    of_runs = [run.scores for run in runs]
    if scenes_alike:
        of_runs = [{name: _per_scene(score) for name, score in of.items()} for of in of_runs]
    scores = {
        name: Score(*(np.mean(parts, axis=0) for parts in zip(*(of[name] for of in of_runs))))
        for name in of_runs[0]
    }
    seconds = sum(run.seconds for run in runs) / len(runs)
    found = dataclasses.replace(runs[0], scores=scores, seconds=seconds)
    if len(runs) == 1:
        return found, None
    means = {name: [of[name].mean for of in of_runs] for name in scores}
    return found, {
        name: float(np.std(of, ddof=1))
        for name, of in means.items()
        if np.ndim(of[0]) == 0 and np.isfinite(of).all()
    }


def _per_scene(score: Score) -> Score:
    """Each scene's mean, of one, where there is something to count."""
    counted = score.count > 0
    shares = np.where(counted, score.count, 1)
    total = score.total / (shares if score.total.ndim == 1 else shares[:, None])
    return Score(total, counted.astype(float))
