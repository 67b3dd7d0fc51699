"""Every model of a sweep against a reference of it, paired by seed and test scene."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.paired import (
    Difference,
    ErrorsByScene,
    mean_difference,
    paired_difference,
)

__all__ = ["MEAN", "Comparison", "compare", "label_of", "one_horizon"]

MEAN = "mean"
"""The name of the mean over test sets."""

Row = dict[str, Any]


class Comparison(NamedTuple):
    """One model less a reference on one test set."""

    model: str
    reference: str
    scene: str
    """A test set, or `MEAN`."""
    difference: Difference
    reference_mean: list[float]
    """[M] the reference's own scores, mean over seeds."""

    def to_json(self) -> dict[str, Any]:
        """Plain numbers: for each metric the difference and its three intervals, metres."""
        of_metrics = {}
        for at, metric in enumerate(self.difference.metrics):
            intervals = self.difference.intervals(metric)
            of_metrics[metric] = {
                "reference": self.reference_mean[at],
                "difference": float(self.difference.mean[at]),
                "of_seeds": [float(value) for value in self.difference.seeds[:, at]],
                **{name: value and list(value) for name, value in intervals.items()},
            }
        named = {"model": self.model, "reference": self.reference, "scene": self.scene}
        return {**named, **of_metrics}


def label_of(row: Row) -> str:
    """What tells a sweep's models apart: `SGAN`, or the weighting, and another variant by name."""
    run = row["run"]
    if run["model"] == "sgan":
        return "SGAN"
    if run["weighting"] is None:
        return row["model"]
    name = row["model"].partition(", ")[2]
    return name if run["model"] == "as_described" else f"{name} ({run['model']})"


def one_horizon(rows: Sequence[Row], pred_len: int | None) -> list[int]:
    """Indices of the trained rows to compare.

    Raises:
        InputError: for horizons among which to choose, or recipes that are not the same.
    """
    trained = [
        index
        for index, row in enumerate(rows)
        if row["run"] and pred_len in (None, row["pred_len"])
    ]
    horizons = sorted({(rows[index]["obs_len"], rows[index]["pred_len"]) for index in trained})
    if len(horizons) != 1:
        raise InputError(f"horizons in the sweep: {horizons or 'none'}; --pred-len chooses one")
    budgets = [{**rows[index]["run"]["training"], "seed": None} for index in trained]
    if any(budget != budgets[0] for budget in budgets):
        raise InputError("the runs were not trained alike, so their differences mean nothing")
    return trained


def compare(
    rows: Sequence[Row],
    errors: dict[int, ErrorsByScene],
    chosen: Sequence[int],
    references: list[str],
) -> list[Comparison]:
    """Every other model against each of `references`, on each test set and in the mean.

    Seeds that either of the two has not finished on a test set are left out of it, and of the mean.

    Raises:
        InputError: for a reference that the sweep has not, or pairs without a seed in common, on
            a test set or on all of them.
    """
    found: dict[str, dict[str, dict[int, ErrorsByScene]]] = {}
    for index in chosen:
        of_model = found.setdefault(label_of(rows[index]), {})
        of_model.setdefault(rows[index]["scene"], {})[rows[index]["run"]["seed"]] = errors[index]
    comparisons = []
    for reference in references:
        if reference not in found:
            raise InputError(f"no {reference!r} to compare with: there are {', '.join(found)}")
        for model in found:
            if model != reference:
                comparisons += _of_pair(model, found[model], reference, found[reference])
    return comparisons


def _of_pair(
    model: str,
    ours: dict[str, dict[int, ErrorsByScene]],
    reference: str,
    theirs: dict[str, dict[int, ErrorsByScene]],
) -> list[Comparison]:
    parts = []
    for scene in ours:
        seeds = sorted(ours[scene].keys() & theirs.get(scene, {}).keys())
        if not seeds:
            raise InputError(f"{model} and {reference} have no seed in common on {scene}")
        first, second = ([of[scene][seed] for seed in seeds] for of in (ours, theirs))
        mean = np.mean([one.mean for one in second], axis=0).tolist()
        difference = paired_difference(first, second, numbers=seeds)
        parts.append(Comparison(model, reference, scene, difference, mean))
    if len(parts) > 1:
        whole = mean_difference([part.difference for part in parts])
        of_all = [sum(values) / len(parts) for values in zip(*(p.reference_mean for p in parts))]
        parts.append(Comparison(model, reference, MEAN, whole, of_all))
    return parts
