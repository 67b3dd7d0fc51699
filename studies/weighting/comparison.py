"""Differences between arms in the table of runs: intervals, tests, and what was in reach.

The unit is the seed: the errors of two arms with one seed, on the same scenes, are
subtracted. Percent are of the reference's mean.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import polars as pl

from neurosym_jax.evaluation.intervals import holm

__all__ = [
    "ALIVE",
    "ENERGY",
    "INTERACTING",
    "LEVEL",
    "MARGIN",
    "Comparison",
    "Runs",
    "adjusted",
    "answer",
]
__all__ += ["compared", "p_text", "percent_text"]

INTERACTING = "interacting joint_ade"
"""The primary metric."""
ENERGY = "interacting energy_score"
"""The metric by which models are ranked elsewhere; secondary in this study."""
MARGIN = 2.0
"""Per cent: the smallest difference of interest."""
LEVEL = 0.05
ALIVE = 0.95
"""Least share of people with a near neighbour whom a run's network changes for it."""
DEAD = 0.1
"""An arm with a larger share of runs below `ALIVE` answers nothing, if a part says no other."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """An arm minus a reference, by one metric on one data set; below 0 the arm is better."""

    dataset: str
    arm: str
    reference: str
    metric: str
    seeds: int
    percent: float
    half: float
    """Per cent: half the 95 % interval by Student's t over seeds."""
    p: float
    """p value of no difference."""
    p_equivalent: float
    """p value of a difference of `MARGIN` or more."""
    reach: float
    """Per cent: the least margin within which nine of ten such studies would show equivalence,
    were there no difference."""
    answered: bool
    """Whether few enough of each arm's runs ignore neighbours."""


class Runs:
    """The table of runs, without those whose network ignores neighbours."""

    def __init__(self, rows: pl.DataFrame, tolerated: float = DEAD):
        """Hold `rows` of set, arm, seed, metric and value.

        An arm with a larger share of dead runs than `tolerated` answers nothing.
        """
        # `right` weights almost all pairs 0, so most neighbours must change nobody.
        near = rows.filter(pl.col("arm") != "encounter, right", metric="neighbour_near")
        dead = pl.col("value") < ALIVE
        arms = near.group_by("set", "arm", maintain_order=True).agg(
            dead.sum(), runs=dead.len()
        )
        self.dead = arms.filter(pl.col("value") > 0)
        """Rows of set, arm, value (runs that are left out) and runs."""
        silent = self.dead.filter(pl.col("value") > tolerated * pl.col("runs"))
        self._silent = set(silent.select("set", "arm").iter_rows())
        self.rows = rows.join(near.filter(dead), on=["set", "arm", "seed"], how="anti")

    def values(self, dataset: str, arm: str, metric: str) -> dict[int, float]:
        """The metric of each seed."""
        columns = {"set": dataset, "arm": arm, "metric": metric}
        return dict(self.rows.filter(**columns).select("seed", "value").iter_rows())

    def compare(
        self, dataset: str, arm: str, reference: str, metric: str = INTERACTING
    ) -> Comparison | None:
        """The comparison over the seeds that both arms have; None for fewer than three."""
        first, second = (
            self.values(dataset, name, metric) for name in (arm, reference)
        )
        common = sorted(set(first) & set(second))
        if len(common) < 3:
            return None
        percent = np.array([first[seed] - second[seed] for seed in common])
        percent *= 100 / np.mean([second[seed] for seed in common])
        answered = not {(dataset, arm), (dataset, reference)} & self._silent
        return compared(dataset, arm, reference, metric, percent, answered)


def compared(
    dataset: str,
    arm: str,
    reference: str,
    metric: str,
    percent: np.ndarray,
    answered: bool = True,
) -> Comparison:
    """The comparison that differences [n] in per cent make, one of each seed (or place)."""
    from scipy.stats import t, ttest_1samp  # They take half a second to import.

    n = len(percent)
    error = percent.std(ddof=1) / np.sqrt(n)
    below = ttest_1samp(percent, MARGIN, alternative="less").pvalue
    above = ttest_1samp(percent, -MARGIN, alternative="greater").pvalue
    return Comparison(
        dataset,
        arm,
        reference,
        metric,
        n,
        float(percent.mean()),
        float(t.ppf(0.975, n - 1) * error),
        float(ttest_1samp(percent, 0).pvalue),
        float(max(below, above)),
        # Both one-sided tests have to succeed: each may fail in one of twenty.
        float(2 * t.ppf(0.95, n - 1) * error),
        answered,
    )


def adjusted(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """The primary comparisons with p values corrected together by Holm's method."""
    different = holm([comparison.p for comparison in comparisons])
    equivalent = holm([comparison.p_equivalent for comparison in comparisons])
    return [
        dataclasses.replace(comparison, p=float(p), p_equivalent=float(p_equivalent))
        for comparison, p, p_equivalent in zip(comparisons, different, equivalent)
    ]


def answer(comparison: Comparison) -> str:
    """What an adjusted comparison says, by the protocol's rules."""
    if not comparison.answered:
        return "not answered"
    if comparison.p < LEVEL:
        return "helps" if comparison.percent < 0 else "harms"
    return (
        f"no effect beyond {MARGIN:g} %" if comparison.p_equivalent < LEVEL else "open"
    )


def percent_text(comparison: Comparison) -> str:
    """The difference in per cent and half its interval, `−0.5 ± 1.3`."""
    return f"{comparison.percent:+.1f} ± {comparison.half:.1f}".replace("-", "−")


def p_text(value: float) -> str:
    """A p value, `.012` or `< .001`."""
    return "< .001" if value < 0.001 else f"{value:.3f}".removeprefix("0")
