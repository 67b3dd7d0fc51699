"""How much better one model is than another on the same test scenes, and how certain that is.

Both models forecast the same scenes with the same noise, so their errors are compared scene by
scene. Two things make the difference uncertain:

- the test scenes: others would have given other errors. Bootstrap; because neighbouring windows
  share most of their steps, it is not windows that are drawn but blocks of as many start frames as
  a window has steps.
- the seeds: other initialisations would have given other models. Bootstrap over the pairs of runs
  of equal seed; but three seeds drawn with replacement say too little of a fourth (Student's
  interval is 2.7 times as wide), so conclusions rest on Student's t of the seeds' mean, with
  Welch's degrees of freedom where test sets are averaged.

This knows nothing of training, files or text.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from neurosym_jax.evaluation.scoring import Scores

__all__ = [
    "Difference",
    "ErrorsByScene",
    "Interval",
    "mean_difference",
    "paired_difference",
]

RESAMPLES = 4000


class Interval(NamedTuple):
    """95 % of what resampling gave, in the metric's unit."""

    low: float
    high: float


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorsByScene:
    """What a model scores on the S scenes of a test set, by M metrics of one value."""

    metrics: tuple[str, ...]
    """Their names."""
    totals: np.ndarray
    """[S, M] summed over what is counted in each scene."""
    counts: np.ndarray
    """[S, M] agents, or what else a metric counts."""
    identity: np.ndarray
    """[S, 2] (recording, start frame)."""
    steps: int
    """Steps of a window, observed and forecast."""

    @classmethod
    def of_scores(cls, scores: Scores, identity: np.ndarray, steps: int) -> "ErrorsByScene":
        """Those of `scores` that have one value, of scenes of `identity` [S]."""
        single = {name: score for name, score in scores.items() if score.total.ndim == 1}
        totals, counts = (np.stack(parts, axis=1) for parts in zip(*single.values()))
        return cls(tuple(single), totals, counts, identity, steps)

    @property
    def mean(self) -> np.ndarray:
        """[M] over the test set."""
        return _ratio(self.totals.sum(axis=0), self.counts.sum(axis=0))


@dataclasses.dataclass(frozen=True, eq=False)
class Difference:
    """Scores of one model less those of another, [M] metrics on the last axis."""

    metrics: tuple[str, ...]
    """Their names."""
    seeds: np.ndarray
    """[n, M] the difference of each pair of runs; of the mean over test sets, seed by seed."""
    over_scenes: np.ndarray
    """[RESAMPLES, M] what other test scenes would have given."""
    over_seeds: np.ndarray
    """[RESAMPLES, M] what other seeds would have given, by bootstrap."""
    variance: np.ndarray
    """[M] of the mean over seeds, by Student."""
    freedom: np.ndarray
    """[M] its degrees of freedom; 0 for a single seed."""

    @property
    def mean(self) -> np.ndarray:
        """[M]."""
        return self.seeds.mean(axis=0)

    def intervals(self, metric: str, seed: int = 0) -> dict[str, Interval | None]:
        """`scenes`, `seeds` and `both`, see the module; `seeds` is None for a single seed."""
        at = self.metrics.index(metric)
        scenes, several = self.over_scenes[:, at], self.freedom[at] > 0
        both = scenes
        if several:
            draw = np.random.default_rng(seed).standard_t(self.freedom[at], len(scenes))
            both = scenes + np.sqrt(self.variance[at]) * draw
        return {
            "scenes": _interval(scenes),
            "seeds": _interval(self.over_seeds[:, at]) if several else None,
            "both": _interval(both),
        }


def paired_difference(
    ours: Sequence[ErrorsByScene], theirs: Sequence[ErrorsByScene], seed: int = 0
) -> Difference:
    """`ours` less `theirs` on one test set; the n runs of each are paired in order."""
    draw = np.random.default_rng(seed)
    first = ours[0]
    start = first.identity.astype(np.int64) // np.array([1, first.steps])
    _, block = np.unique(start, axis=0, return_inverse=True)
    count = int(block.max()) + 1
    drawn = draw.multinomial(count, np.full(count, 1 / count), RESAMPLES)

    def resampled(run: ErrorsByScene) -> np.ndarray:
        # [RESAMPLES, M] its means over the scenes that were drawn.
        totals, counts = np.zeros((2, count, len(first.metrics)))
        np.add.at(totals, block.ravel(), run.totals)
        np.add.at(counts, block.ravel(), run.counts)
        return _ratio(drawn @ totals, drawn @ counts)

    pairs = list(zip(ours, theirs))
    over_scenes = np.mean([resampled(a) - resampled(b) for a, b in pairs], axis=0)
    seeds = np.stack([a.mean - b.mean for a, b in pairs])
    n = len(seeds)
    over_seeds = seeds[draw.integers(0, n, (RESAMPLES, n))].mean(axis=1)
    variance = seeds.var(axis=0, ddof=1) / n if n > 1 else np.zeros(len(first.metrics))
    freedom = np.full(len(first.metrics), n - 1.0)
    return Difference(first.metrics, seeds, over_scenes, over_seeds, variance, freedom)


def mean_difference(parts: Sequence[Difference]) -> Difference:
    """The mean over test sets, each weighing the same; runs on different sets are independent."""
    share = np.stack([part.variance for part in parts]) / len(parts) ** 2
    variance = share.sum(axis=0)
    # Welch and Satterthwaite; no variance at all needs no degrees of freedom.
    freedoms = np.stack([part.freedom for part in parts])
    weight = (share**2 / np.maximum(freedoms, 1)).sum(axis=0)
    known = (freedoms > 0).all(axis=0)
    freedom = np.where(weight > 0, variance**2 / np.where(weight > 0, weight, 1), 1.0) * known
    count = min(len(part.seeds) for part in parts)
    return Difference(
        parts[0].metrics,
        np.mean([part.seeds[:count] for part in parts], axis=0),
        np.mean([part.over_scenes for part in parts], axis=0),
        np.mean([part.over_seeds for part in parts], axis=0),
        variance,
        freedom,
    )


def _ratio(totals: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Means; 0 where nothing was counted, for the total is 0 then."""
    return totals / np.where(counts > 0, counts, 1)


def _interval(values: np.ndarray) -> Interval:
    return Interval(*map(float, np.percentile(values, [2.5, 97.5])))
