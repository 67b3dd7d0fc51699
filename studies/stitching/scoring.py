"""How right the ids of a tracker, or of a stitcher, are."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

__all__ = ["idf1"]


def idf1(person: ArrayLike, given: ArrayLike) -> float:
    """IDF1: share of rows whose id is right, under the best one-to-one naming of ids after people.

    `2 IDTP / (2 IDTP + IDFP + IDFN)`; 1 is perfect (Ristani et al., ECCV workshops 2016).

    Args:
        person: [R] whole numbers, the true person of each row; -1 for a false detection.
        given: [R] whole numbers, the id given to it; -1 if the person was missed.
    """
    person, given = np.asarray(person), np.asarray(given)
    both = (person != -1) & (given != -1)
    people, row = np.unique(person[both], return_inverse=True)
    ids, column = np.unique(given[both], return_inverse=True)
    together = np.zeros((len(people), len(ids)), int)
    np.add.at(together, (row, column), 1)
    right = together[linear_sum_assignment(together, maximize=True)].sum()
    return float(2 * right / ((person != -1).sum() + (given != -1).sum()))
