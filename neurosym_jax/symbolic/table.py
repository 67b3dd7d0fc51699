"""The QTC_C1 states of all pairs of a recording over time, as rows."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from neurosym_jax.symbolic.qtc import observe

__all__ = ["pairs_over_time", "states_of_pairs"]

PART = 65_536
"""Pairs that are observed at once: of one number, so that one program serves all."""


def pairs_over_time(step: np.ndarray, ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of people who are both seen at a step and at the one before.

    Args:
        step: [R] number of each row's step, ascending for each person.
        ids: [R] people; the rows of one follow each other.

    Returns:
        [P] rows of k and [P] rows of l at the end of each pair's step, by step; each
        pair once, k before l. The row before has where they come from.
    """
    goes_on = (np.diff(ids) == 0) & (np.diff(step) == 1)
    ends = 1 + np.flatnonzero(goes_on)
    ends = ends[np.argsort(step[ends], kind="stable")]
    _, first, counts = np.unique(step[ends], return_index=True, return_counts=True)
    k, l = [np.zeros(0, int)], [np.zeros(0, int)]
    for start, people in zip(first, counts):
        first_person, second_person = np.triu_indices(people, 1)
        k.append(ends[start + first_person])
        l.append(ends[start + second_person])
    return np.concatenate(k), np.concatenate(l)


def states_of_pairs(
    position: np.ndarray, k: np.ndarray, l: np.ndarray, thresholds: Mapping[str, Any]
) -> np.ndarray:
    """[P, 4] int8 states of pairs over one step, see `qtc`.

    Args:
        position: [R, 2] metres.
        k: [P] rows at the end of each pair's step, of the first person.
        l: [P] the same of the second.
        thresholds: arguments of `observe`, see `Weighting.thresholds`.
    """
    states = np.zeros((len(k), 4), np.int8)
    for start in range(0, len(k), PART):
        rows = slice(start, start + PART)
        k_path = np.zeros((PART, 2, 2))
        l_path = np.zeros((PART, 2, 2))
        for path, ends in ((k_path, k[rows]), (l_path, l[rows])):
            path[: len(ends)] = position[np.stack([ends - 1, ends], axis=1)]
        # Far from the origin float32 would lose the differences.
        origin = k_path[:, :1].copy()
        observed = observe(k_path - origin, l_path - origin, **thresholds)
        states[rows] = np.asarray(observed)[: len(states[rows]), 0]
    return states
