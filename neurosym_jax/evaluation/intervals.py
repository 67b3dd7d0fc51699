"""95 % intervals and paired tests of mean scores, over test scenes and over training seeds.

Other test scenes would have given other scores. Neighbouring windows share most of
their steps, so scenes are summed in blocks of as many start frames as a window has
steps. Each mean is a ratio of sums over blocks, and its variance that of the jackknife,
which leaves out one block at a time and so weighs unequal blocks. Windows at the border
of two blocks share steps too: where errors of steps are independent, neighbouring block
means correlate by 1/4. So the variance of the mean of n blocks is (3 n - 1) / (2 n - 1)
times, for many 1.5 times, what the spread of the blocks says, and their spread has 8/9
of n - 1 degrees of freedom (Satterthwaite's). n is the effective number of blocks, (sum
of weights)^2 / sum of squares.

Models forecast the same scenes with the same noise, so a difference is of the same
blocks.

Other training seeds would have given other models. Runs of one seed on several test
sets are good or bad together, so they are averaged over test sets first, and Student's
t is of the seeds' means. Both variances add; degrees of freedom are Welch's and
Satterthwaite's.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scores import Scores

__all__ = [
    "FEWEST",
    "Difference",
    "ErrorsByScene",
    "Estimate",
    "against_best",
    "half_interval",
    "holm",
    "mean_difference",
    "paired_difference",
    "student_half",
    "student_p",
    "two_sided_p",
]


# Student's t by formula: SciPy, which has it, takes a quarter of a second to import.

NORMAL = 1.959963984540054
"""Half of the 95 % interval of a standard normal variable."""


def two_sided_p(t: float, freedom: float) -> float:
    """Two-sided p value of Student's t, with any positive number of degrees of freedom.

    The regularised incomplete beta function I_x(freedom / 2, 1 / 2) at x = freedom /
    (freedom + t^2), see section 26.7 of Abramowitz and Stegun. NaN where the freedom is
    not known.
    """
    if not freedom > 0 or math.isnan(t):
        return math.nan
    if math.isinf(freedom):
        return math.erfc(abs(t) / math.sqrt(2))
    a = freedom / 2
    b = 0.5
    x = freedom / (freedom + t * t)
    if x in (0.0, 1.0):
        return x
    scale = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    powers = a * math.log(x) + b * math.log1p(-x)
    front = math.exp(scale + powers)
    # The fraction converges fast on this side; the other side is its complement.
    if x < (a + 1) / (a + b + 2):
        return front * _beta_fraction(a, b, x) / a
    return 1 - front * _beta_fraction(b, a, 1 - x) / b


def _beta_fraction(a: float, b: float, x: float) -> float:
    """The continued fraction of the incomplete beta function, 26.5.8 there, by Lentz's method."""
    ratio = 1.0
    inverse = 1 / (1 - (a + b) * x / (a + 1))
    value, step = inverse, 0
    change = math.inf
    while abs(change - 1) > 1e-15 and step < 100_000:
        step += 1
        end = a + 2 * step
        even = step * (b - step) * x / ((end - 1) * end)
        odd = -(a + step) * (a + b + step) * x / (end * (end + 1))
        for numerator in (even, odd):
            inverse = 1 / (1 + numerator * inverse)
            ratio = 1 + numerator / ratio
            change = ratio * inverse
            value *= change
    return value


@functools.cache
def half_interval(freedom: float) -> float:
    """Half of the 95 % interval of Student's t: its two-sided p value is 0.05."""
    if not freedom > 0:
        return math.nan
    if math.isinf(freedom):
        return NORMAL
    scale = math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2)
    scale -= math.log(freedom * math.pi) / 2
    # Tails are heavier than a normal variable's, and p is convex: Newton's method comes
    # from below.
    half, step = NORMAL, math.inf
    while abs(step) > 1e-14 * half:
        power = (freedom + 1) / 2 * math.log1p(half * half / freedom)
        density = math.exp(scale - power)
        step = (two_sided_p(half, freedom) - 0.05) / (2 * density)
        # Beside the root the sign of what is left is rounding.
        if step <= 0:
            break
        half += step
    return half


FEWEST = 3
"""Blocks below which an interval is infinite and no difference is significant."""
ROUNDING = 1e-9
"""Difference of means, in the metric's unit, that is rounding; a constant one has no variance."""
Interval = tuple[float, float]
"""95 % interval, in the metric's unit."""


@dataclasses.dataclass(frozen=True, eq=False)
class Estimate:
    """Means or differences of M metrics, whose errors follow Student's t."""

    value: np.ndarray
    """[M]."""
    variance: np.ndarray
    """[M] of `value`; infinite where too few blocks tell."""
    freedom: np.ndarray
    """[M] degrees of freedom."""

    def interval(self, column: int) -> Interval:
        """95 % interval of one metric."""
        deviation = self.variance[column] ** 0.5
        half = half_interval(float(self.freedom[column])) * deviation
        value = self.value[column]
        return float(value - half), float(value + half)

    def p_value(self, column: int) -> float:
        """Two-sided p value of one metric against 0."""
        if abs(self.value[column]) < ROUNDING:
            return 1.0
        with np.errstate(divide="ignore"):
            deviation = self.variance[column] ** 0.5
            t = np.abs(self.value[column]) / deviation
        return two_sided_p(float(t), float(self.freedom[column]))


def _sum(value: np.ndarray, parts: Sequence[Estimate]) -> Estimate:
    """An estimate whose variance is the sum of independent ones."""
    variance = sum(part.variance for part in parts)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = []
        for part in parts:
            share = part.variance / variance
            shares.append(np.square(share) / part.freedom)
        freedom = 1 / np.sum(shares, axis=0)
    # Without variance every freedom is right.
    freedom = np.where(np.isfinite(freedom), freedom, 1)
    return Estimate(value, np.asarray(variance), freedom)


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorsByScene:
    """Scores of a model on the S scenes of a test set, and where in the recordings these are."""

    scores: Scores
    """Scores [S] by metric, of the M metrics with one value."""
    identity: np.ndarray
    """[S, 2] (recording, start frame)."""
    steps: int
    """Steps of a window, observed and forecast."""

    @functools.cached_property
    def blocks(self) -> np.ndarray:
        """[S] the block of each scene, of as many start frames as a window has steps."""
        start = self.identity.astype(np.int64) // np.array([1, self.steps])
        _, block = np.unique(start, axis=0, return_inverse=True)
        return block.ravel()

    @functools.cached_property
    def block_sums(self) -> tuple[np.ndarray, np.ndarray]:
        """[blocks, M] totals and counts, see `Score`."""
        totals, counts = [], []
        for total, count in self.scores.values():
            totals.append(np.bincount(self.blocks, total))
            counts.append(np.bincount(self.blocks, count))
        return np.stack(totals, axis=1), np.stack(counts, axis=1)

    @property
    def mean(self) -> np.ndarray:
        """[M] means over the test set; 0 where nothing was counted."""
        totals, counts = self.block_sums
        return _ratio(totals.sum(axis=0), counts.sum(axis=0))

    def intervals(self) -> dict[str, Interval]:
        """95 % interval of each metric's mean over other test scenes."""
        estimate = _over_blocks(self.mean, self.jackknife(), self.effective_blocks())
        return dict(zip(self.scores, map(estimate.interval, itertools.count())))

    def jackknife(self) -> np.ndarray:
        """[blocks, M] how much the mean falls when a block is left out."""
        totals, counts = self.block_sums
        rest = counts.sum(axis=0) - counts
        return _ratio(totals - self.mean * counts, rest)

    def effective_blocks(self) -> np.ndarray:
        """[M] number of equal blocks that would weigh as these do; 0 for fewer than `FEWEST`."""
        _, counts = self.block_sums
        square_of_sum = np.square(counts.sum(axis=0))
        number = _ratio(square_of_sum, np.square(counts).sum(axis=0))
        used = (counts > 0).sum(axis=0)
        return np.where(used < FEWEST, 0, number)


def _over_blocks(
    value: np.ndarray, changes: np.ndarray, effective: np.ndarray
) -> Estimate:
    """An estimate from its `changes [blocks, M]` when a block is left out."""
    # The jackknife's factor, and that of blocks that share steps.
    factor = 1 - 1 / len(changes)
    factor = factor * (3 * effective - 1) / (2 * effective - 1)
    variance = factor * np.square(changes).sum(axis=0)
    enough = effective > 1
    variance = np.where(enough, variance, np.inf)
    freedom = np.where(enough, 8 / 9 * (effective - 1), 1)
    return Estimate(value, variance, freedom)


@dataclasses.dataclass(frozen=True, eq=False)
class Difference:
    """Scores of one model less those of another, [M] metrics on the last axis."""

    metrics: tuple[str, ...]
    """Names."""
    numbers: tuple[int, ...]
    """The n training seeds."""
    seeds: np.ndarray
    """[n, M] difference of the two runs of each seed, averaged over test sets if several."""
    over_scenes: Estimate
    """The difference over other test scenes, by the same trainings."""

    @property
    def mean(self) -> np.ndarray:
        """[M]."""
        return self.seeds.mean(axis=0)

    @property
    def over_seeds(self) -> Estimate | None:
        """The difference of other trainings, on the same scenes; None for a single seed."""
        return _of_sample(self.seeds) if len(self.seeds) > 1 else None

    @property
    def over_both(self) -> Estimate:
        """The difference of other trainings on other test scenes."""
        over_seeds = self.over_seeds
        if over_seeds is None:
            return _sum(self.mean, [self.over_scenes])
        return _sum(self.mean, [self.over_scenes, over_seeds])

    def intervals(self, metric: str) -> dict[str, Interval | None]:
        """`scenes`, `seeds` and `both`, see the module; `seeds` is None for a single seed."""
        column = self.metrics.index(metric)
        seeds = self.over_seeds
        return {
            "scenes": self.over_scenes.interval(column),
            "seeds": seeds and seeds.interval(column),
            "both": self.over_both.interval(column),
        }


def paired_difference(
    model: Sequence[ErrorsByScene],
    reference: Sequence[ErrorsByScene],
    numbers: Sequence[int] | None = None,
) -> Difference:
    """`model` less `reference` on the same scenes: n runs each, of the training seeds `numbers`.

    The training seeds are 0 to n - 1 by default.
    """
    differences, changes, effective = [], [], []
    for first, second in zip(model, reference):
        differences.append(first.mean - second.mean)
        changes.append(first.jackknife() - second.jackknife())
        effective += [first.effective_blocks(), second.effective_blocks()]
    seeds = np.stack(differences)
    mean_changes = np.mean(changes, axis=0)
    fewest_blocks = np.min(effective, axis=0)
    over_scenes = _over_blocks(seeds.mean(axis=0), mean_changes, fewest_blocks)
    metrics = tuple(model[0].scores)
    named_seeds = tuple(numbers or range(len(seeds)))
    return Difference(metrics, named_seeds, seeds, over_scenes)


def mean_difference(parts: Sequence[Difference]) -> Difference:
    """Mean over independent test sets with equal weights, of the seeds that all of them have.

    Raises:
        InputError: where there is no such seed.
    """
    numbers = [set(part.numbers) for part in parts]
    common = sorted(set.intersection(*numbers))
    if not common:
        raise InputError(
            "no training seed was tested on every test set, so there is no mean"
        )
    common_seeds, shrunk = [], []
    for part in parts:
        rows = [part.numbers.index(number) for number in common]
        common_seeds.append(part.seeds[rows])
        variance = part.over_scenes.variance / len(parts) ** 2
        shrunk.append(dataclasses.replace(part.over_scenes, variance=variance))
    seeds = np.mean(common_seeds, axis=0)
    over_scenes = _sum(seeds.mean(axis=0), shrunk)
    return Difference(parts[0].metrics, tuple(common), seeds, over_scenes)


def holm(p_values: Sequence[float]) -> np.ndarray:
    """Adjust the p values of m comparisons for all of them: below .05 is a finding.

    Holm (Scand. J. Statist. 1979): the family-wise error is kept however they depend on
    each other.
    """
    p = np.asarray(p_values, float)
    order = np.argsort(p)
    factor = np.arange(len(p), 0, -1)
    stepped = np.maximum.accumulate(p[order] * factor)
    return np.minimum(stepped, 1)[np.argsort(order)]


def against_best(
    means: Sequence[float | None],
    higher: bool | None,
    p_value: Callable[[int, int], float],
) -> list[float | None]:
    """Holm-adjusted p values of n models against the one of best mean, which itself has None.

    Args:
        means: [n], None for a model without a value, which is left out.
        higher: whether a higher mean is better; None if neither is, and nothing is
            tested.
        p_value: of the paired test of two models, called with the index of the best
            first.
    """
    adjusted: list[float | None] = [None] * len(means)
    known_means = {at: mean for at, mean in enumerate(means) if mean is not None}
    if higher is None or len(known_means) < 2:
        return adjusted
    choose = max if higher else min
    best = choose(known_means, key=known_means.__getitem__)
    others = [at for at in known_means if at != best]
    p_values = [p_value(best, at) for at in others]
    for at, p in zip(others, holm(p_values)):
        adjusted[at] = float(p)
    return adjusted


def student_half(values: Sequence[float]) -> float:
    """Half of Student's 95 % interval of the mean of `values` [n], n > 1."""
    estimate = _of_sample(np.array([values], float).T)
    low, high = estimate.interval(0)
    return (high - low) / 2


def student_p(values: Sequence[float]) -> float:
    """Two-sided p value of Student's test that the mean of `values` [n], n > 1, is 0."""
    estimate = _of_sample(np.array([values], float).T)
    return estimate.p_value(0)


def _of_sample(values: np.ndarray) -> Estimate:
    """The means of n independent rows `values [n, M]`, n > 1."""
    n, metrics = values.shape
    variance = values.var(axis=0, ddof=1) / n
    freedom = np.full(metrics, n - 1)
    return Estimate(values.mean(axis=0), variance, freedom)


def _ratio(totals: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Means; 0 where nothing was counted."""
    return totals / np.where(counts > 0, counts, 1)
