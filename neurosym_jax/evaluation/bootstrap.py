"""Differences between models on the same test scenes, with their uncertainty.

Both models forecast the same scenes with the same noise, so their errors are compared scene by
scene. Two things make the difference uncertain:

- the test scenes: others would have given other errors. Bootstrap; neighbouring windows share most
  of their steps, so a block is of as many start frames as a window has steps, and because windows
  of neighbouring blocks share steps too, stretches of three blocks are drawn (the moving blocks of
  Künsch, Ann. Stat. 1989).
- the training seeds: other initialisations would have given other models. Runs of one seed on
  several test sets are good or bad together, so they are averaged over test sets first, and
  Student's t is of the seeds' means. A bootstrap over seeds stands beside it; three seeds drawn
  with replacement say too little about a fourth (Student's interval is 2.7 times as wide), so no
  conclusion rests on it.

`holm` adjusts the p values of several comparisons.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scoring import Scores

__all__ = ["Difference", "ErrorsByScene", "holm", "mean_difference"]
__all__ += ["paired_difference", "student_half"]

RESAMPLES = 4000
STRETCH = 3
"""Blocks drawn together, where there are five times as many."""
Interval = tuple[float, float]
"""95 % interval, in the metric's unit."""


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorsByScene:
    """Scores of a model on the S scenes of a test set, and where in the recordings these are."""

    scores: Scores
    """Scores [S] by metric, of the M metrics with one value."""
    identity: np.ndarray
    """[S, 2] (recording, start frame)."""
    steps: int
    """Steps of a window, observed and forecast."""

    @property
    def sums(self) -> np.ndarray:
        """[2, S, M] totals and counts, see `Score`."""
        return np.moveaxis(np.array([*self.scores.values()]), 0, -1)

    @property
    def blocks(self) -> np.ndarray:
        """[S] the block of each scene, of as many start frames as a window has steps."""
        start = self.identity.astype(np.int64) // np.array([1, self.steps])
        return np.unique(start, axis=0, return_inverse=True)[1].ravel()

    @property
    def mean(self) -> np.ndarray:
        """[M] means over the test set."""
        return _ratio(*self.sums.sum(axis=1))

    def intervals(self) -> dict[str, Interval]:
        """95 % interval of each metric's mean over other test scenes."""
        means = _resampled(self, _drawn(self))
        return {name: _interval(of) for name, of in zip(self.scores, means.T)}


@dataclasses.dataclass(frozen=True, eq=False)
class Difference:
    """Scores of one model less those of another, [M] metrics on the last axis."""

    metrics: tuple[str, ...]
    """Names."""
    numbers: tuple[int, ...]
    """The n training seeds."""
    seeds: np.ndarray
    """[n, M] difference of the two runs of each seed, averaged over test sets if several."""
    over_scenes: np.ndarray
    """[RESAMPLES, M] differences on resampled test scenes."""

    @property
    def mean(self) -> np.ndarray:
        """[M]."""
        return self.seeds.mean(axis=0)

    def intervals(self, metric: str, seed: int = 0) -> dict[str, Interval | None]:
        """`scenes`, `seeds` and `both`, see the module; `seeds` is None for a single seed."""
        column = self.metrics.index(metric)
        scenes, of_seeds = self.over_scenes[:, column], self.seeds[:, column]
        n = len(of_seeds)
        if n == 1:
            return {"scenes": _interval(scenes), "seeds": None, "both": _interval(scenes)}
        draw = np.random.default_rng(seed)
        drawn = of_seeds[draw.integers(0, n, (RESAMPLES, n))].mean(axis=1)
        student = of_seeds.std(ddof=1) / np.sqrt(n) * draw.standard_t(n - 1, RESAMPLES)
        both = _interval(scenes + student)
        return {"scenes": _interval(scenes), "seeds": _interval(drawn), "both": both}


def paired_difference(
    ours: Sequence[ErrorsByScene],
    theirs: Sequence[ErrorsByScene],
    seed: int = 0,
    numbers: Sequence[int] | None = None,
) -> Difference:
    """`ours` less `theirs` on one test set: n runs each, of the training seeds `numbers`.

    `seed` is the bootstrap's; the training seeds are 0 to n - 1 by default.
    """
    drawn, pairs = _drawn(ours[0], seed), list(zip(ours, theirs))
    over_scenes = np.mean([_resampled(a, drawn) - _resampled(b, drawn) for a, b in pairs], axis=0)
    seeds = np.stack([a.mean - b.mean for a, b in pairs])
    metrics = tuple(ours[0].scores)
    return Difference(metrics, tuple(numbers or range(len(pairs))), seeds, over_scenes)


def mean_difference(parts: Sequence[Difference]) -> Difference:
    """Mean over test sets with equal weights, of the seeds that all of them have.

    Raises:
        InputError: where there is no such seed.
    """
    common = sorted(set.intersection(*(set(part.numbers) for part in parts)))
    if not common:
        raise InputError("no training seed was tested on every test set, so there is no mean")
    seeds = [part.seeds[[part.numbers.index(number) for number in common]] for part in parts]
    # Centred on the mean of the common seeds.
    moved = [part.over_scenes - part.mean + left.mean(axis=0) for part, left in zip(parts, seeds)]
    return Difference(
        parts[0].metrics, tuple(common), np.mean(seeds, axis=0), np.mean(moved, axis=0)
    )


def holm(p_values: Sequence[float]) -> np.ndarray:
    """Adjust the p values of m comparisons for all of them: below .05 is a finding.

    Holm (Scand. J. Statist. 1979): the family-wise error is kept however they depend on each other.
    """
    p = np.asarray(p_values, float)
    order = np.argsort(p)
    stepped = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    return np.minimum(stepped, 1)[np.argsort(order)]


def student_half(values: Sequence[float]) -> float:
    """Half of Student's 95 % interval of the mean of `values` [n], n > 1."""
    from scipy.special import stdtrit

    n = len(values)
    return float(stdtrit(n - 1, 0.975) * np.std(values, ddof=1) / n**0.5)


def _drawn(errors: ErrorsByScene, seed: int = 0) -> np.ndarray:
    """[RESAMPLES, blocks] how often each block is drawn; the first follows on the last."""
    count = int(errors.blocks.max()) + 1
    length = min(max(count // 5, 1), STRETCH)
    # One stretch less than there are, as a variance is divided by n - 1.
    stretches = max(count // length - 1, 1)
    draw = np.random.default_rng(seed)
    first = draw.multinomial(stretches, np.full(count, 1 / count), RESAMPLES)
    return np.sum([np.roll(first, i, axis=1) for i in range(length)], axis=0)


def _resampled(run: ErrorsByScene, drawn: np.ndarray) -> np.ndarray:
    """[RESAMPLES, M] means over the drawn blocks."""
    of_blocks = np.zeros((drawn.shape[1], 2, len(run.scores)))
    np.add.at(of_blocks, run.blocks, run.sums.swapaxes(0, 1))
    return _ratio(*(drawn @ of_blocks.swapaxes(0, 1)))


def _ratio(totals: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Means; 0 where nothing was counted."""
    return totals / np.where(counts > 0, counts, 1)


def _interval(values: np.ndarray) -> Interval:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)
