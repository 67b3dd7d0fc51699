"""Several trainings of one model as one row, with an interval over scenes and over trainings."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from neurosym_jax.evaluation.paired import student_half
from neurosym_jax.evaluation.summary import family_of

__all__ = ["of_trainings"]


def of_trainings(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """`rows`, those that differ in the seed of their training as one."""
    groups: dict[tuple, list[Mapping[str, Any]]] = {}
    for row in rows:
        family, _ = family_of(row["checkpoint"])
        key = (family, row["model"], row["scene"], row["obs_len"], row["pred_len"])
        groups.setdefault(key, []).append(row)
    return [
        {**members[0], "checkpoint": key[0], "trainings": len(members), **_mean_of(members)}
        for key, members in groups.items()
    ]


def _mean_of(members: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Metrics and intervals of one model's trainings on one test."""
    metrics, intervals = {}, {}
    for name in members[0]["metrics"]:
        values = [row["metrics"][name] for row in members]
        if None in values:
            metrics[name] = None
            continue
        metrics[name] = mean = float(np.mean(values))
        if all(name in row["intervals"] for row in members):
            widths = [np.diff(row["intervals"][name])[0] / 2 for row in members]
            seeds = student_half(values) if len(values) > 1 else 0.0
            half = float(np.hypot(np.mean(widths), seeds))
            # Of one training the interval is as it was, which need not be symmetric.
            several = [mean - half, mean + half]
            intervals[name] = several if len(values) > 1 else members[0]["intervals"][name]
    return {"metrics": metrics, "intervals": intervals}
