"""How right the ids of a tracker, or of a stitcher, are."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

__all__ = ["idf1"]


def idf1(person: ArrayLike, ids: ArrayLike) -> float:
    """IDF1: share of rows whose id is right, under the best one-to-one naming of ids after people.

    `2 IDTP / (2 IDTP + IDFP + IDFN)`; 1 is perfect (Ristani et al., ECCV workshops
    2016).

    Args:
        person: [R] whole numbers, the true person of each row; -1 for a false
            detection.
        ids: [R] whole numbers, the id of each row; -1 if the person was missed.
    """
    person, ids = np.asarray(person), np.asarray(ids)
    tracked = (person != -1) & (ids != -1)
    people, row = np.unique(person[tracked], return_inverse=True)
    names, column = np.unique(ids[tracked], return_inverse=True)
    together = np.zeros((len(people), len(names)), int)
    np.add.at(together, (row, column), 1)
    right = together[linear_sum_assignment(together, maximize=True)].sum()
    return float(2 * right / ((person != -1).sum() + (ids != -1).sum()))
