"""Several trainings of one model as one row, with an interval over scenes and over trainings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from neurosym_jax.evaluation.bootstrap import student_half
from neurosym_jax.evaluation.summary import family_of, metrics_of

__all__ = ["of_trainings"]


def of_trainings(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """`rows`, those that differ in the seed of their training as one."""
    groups: dict[tuple, list[Mapping[str, Any]]] = {}
    for row in rows:
        family, _ = family_of(row["checkpoint"])
        key = (family, row["model"], row["dataset"], row["obs_len"], row["pred_len"])
        groups.setdefault(key, []).append(row)
    return [
        {**members[0], "checkpoint": key[0], "trainings": len(members), **_mean_of(members)}
        for key, members in groups.items()
    ]


def _mean_of(members: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Metrics and intervals of one model's trainings on one test."""
    if len(members) == 1:
        return {}
    found: dict[str, Any] = {}
    for name in metrics_of(members[0]):
        values = [row[name] for row in members]
        bounds = [(row[f"{name}_low"], row[f"{name}_high"]) for row in members]
        found |= dict.fromkeys((name, f"{name}_low", f"{name}_high"))
        if None not in values:
            found[name] = mean = float(np.mean(values))
            width = np.mean([(high - low) / 2 for low, high in bounds])
            half = float(np.hypot(width, student_half(values)))
            found |= {f"{name}_low": mean - half, f"{name}_high": mean + half}
    return found
