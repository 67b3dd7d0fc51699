"""What the runs of two arms say of their difference: intervals, tests, and what was in reach.

The unit is the seed: of each, the two arms' errors on the same scenes with the same noise are
subtracted. Percent are of the reference's mean.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from neurosym_jax.evaluation.bootstrap import ErrorsByScene, holm, paired_difference

__all__ = ["LEVEL", "MARGIN", "Comparison", "adjusted", "compare", "verdict"]

MARGIN = 2.0
"""Per cent: the smallest difference of interest."""
LEVEL = 0.05


@dataclasses.dataclass(frozen=True)
class Comparison:
    """An arm less a reference, by one metric on one data set; below 0 the arm is better."""

    arm: str
    reference: str
    metric: str
    seeds: int
    percent: float
    low: float
    """Per cent: with `high` the interval of 95 % by Student's t over seeds."""
    high: float
    wide_low: float
    """Per cent: with `wide_high` the interval over seeds and test scenes, see `paired`."""
    wide_high: float
    p: float
    """p value of no difference."""
    p_equivalent: float
    """p value of a difference of `MARGIN` or more."""
    reach: float
    """Per cent: the least margin that equivalence would be shown within, were there no difference,
    in nine of ten such studies."""


def compare(
    arm: str, reference: str, runs: Mapping[str, Mapping[int, ErrorsByScene]], metric: str
) -> Comparison:
    """Compare two arms on the seeds that both have; `runs` by arm and seed."""
    common = sorted(set(runs[arm]) & set(runs[reference]))
    ours, theirs = ([runs[name][seed] for seed in common] for name in (arm, reference))
    found = paired_difference(ours, theirs, numbers=common)
    at = found.metrics.index(metric)
    unit = 100 / float(np.mean([run.mean[at] for run in theirs]))
    each = found.seeds[:, at] * unit
    half, reach = _student(each)
    wide = found.intervals(metric)["both"]
    assert wide is not None
    return Comparison(
        arm,
        reference,
        metric,
        len(common),
        float(each.mean()),
        float(each.mean() - half),
        float(each.mean() + half),
        wide.low * unit,
        wide.high * unit,
        found.p_value(metric),
        found.p_equivalent(metric, MARGIN / unit),
        reach,
    )


def _student(each: np.ndarray) -> tuple[float, float]:
    """Half the 95 % interval of the mean of `each [n]`, and the margin in reach at 90 % power."""
    from scipy.stats import t  # It takes half a second to import.

    n = len(each)
    if n == 1:
        return np.nan, np.nan
    error = each.std(ddof=1) / np.sqrt(n)
    # Both one-sided tests have to succeed: each may fail in one of twenty.
    return float(t.ppf(0.975, n - 1) * error), float(2 * t.ppf(0.95, n - 1) * error)


def adjusted(comparisons: Sequence[Comparison]) -> tuple[np.ndarray, np.ndarray]:
    """`p` and `p_equivalent` [m] of all primary comparisons together, by Holm."""
    return (
        holm([each.p for each in comparisons]),
        holm([each.p_equivalent for each in comparisons]),
    )


def verdict(
    comparisons: Sequence[Comparison], p: np.ndarray, equivalent: np.ndarray, seen: bool
) -> str:
    """What the primary comparisons of one data set say: `yes`, `no`, or `open`.

    Args:
        comparisons: `quantised` less each of its references, by joint ADE.
        p: adjusted, of no difference.
        equivalent: adjusted, of a difference of `MARGIN` or more.
        seen: whether the control was; if not, nothing is a no.
    """
    if all(each.percent < 0 for each in comparisons) and (p < LEVEL).all():
        return "yes"
    return "no" if seen and (equivalent < LEVEL).all() else "open"
