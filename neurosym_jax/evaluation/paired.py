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

__all__ = [
    "METRICS",
    "Difference",
    "ErrorsByScene",
    "Interval",
    "mean_difference",
    "paired_difference",
]

METRICS = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde")
RESAMPLES = 4000


class Interval(NamedTuple):
    """95 % of what resampling gave, metres."""

    low: float
    high: float


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorsByScene:
    """A model's errors on the S scenes of a test set."""

    errors: np.ndarray
    """[S, 4] metres, the `METRICS` summed over the agents of each scene."""
    agents: np.ndarray
    """[S] agents."""
    identity: np.ndarray
    """[S, 2] (recording, start frame)."""
    steps: int
    """Steps of a window, observed and forecast."""

    @property
    def mean(self) -> np.ndarray:
        """[4] metres."""
        return self.errors.sum(axis=0) / self.agents.sum()


@dataclasses.dataclass(frozen=True, eq=False)
class Difference:
    """Errors of one model less those of another, [4] `METRICS` on the last axis, metres."""

    seeds: np.ndarray
    """[n, 4] the difference of each pair of runs; of the mean over test sets, seed by seed."""
    over_scenes: np.ndarray
    """[RESAMPLES, 4] what other test scenes would have given."""
    over_seeds: np.ndarray
    """[RESAMPLES, 4] what other seeds would have given, by bootstrap."""
    variance: np.ndarray
    """[4] of the mean over seeds, by Student."""
    freedom: np.ndarray
    """[4] its degrees of freedom; 0 for a single seed."""

    @property
    def mean(self) -> np.ndarray:
        """[4] metres."""
        return self.seeds.mean(axis=0)

    def intervals(self, metric: str, seed: int = 0) -> dict[str, Interval | None]:
        """`scenes`, `seeds` and `both`, see the module; `seeds` is None for a single seed."""
        at = METRICS.index(metric)
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
    # [blocks, n, 4] and [blocks].
    differences = np.stack([a.errors - b.errors for a, b in zip(ours, theirs)], axis=1)
    in_blocks = np.zeros((count, *differences.shape[1:]))
    np.add.at(in_blocks, block.ravel(), differences)
    agents = np.bincount(block.ravel(), first.agents, count)

    drawn = draw.multinomial(count, np.full(count, 1 / count), RESAMPLES)
    over_scenes = np.tensordot(drawn, in_blocks.mean(axis=1), 1) / (drawn @ agents)[:, None]
    seeds = differences.sum(axis=0) / first.agents.sum()
    n = len(seeds)
    over_seeds = seeds[draw.integers(0, n, (RESAMPLES, n))].mean(axis=1)
    variance = seeds.var(axis=0, ddof=1) / n if n > 1 else np.zeros(len(METRICS))
    freedom = np.full(len(METRICS), n - 1.0)
    return Difference(seeds, over_scenes, over_seeds, variance, freedom)


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
        np.mean([part.seeds[:count] for part in parts], axis=0),
        np.mean([part.over_scenes for part in parts], axis=0),
        np.mean([part.over_seeds for part in parts], axis=0),
        variance,
        freedom,
    )


def _interval(values: np.ndarray) -> Interval:
    return Interval(*map(float, np.percentile(values, [2.5, 97.5])))
