"""Size classes: which padded sizes a training set gets, for the fewest padded pairs a batch."""

import numpy as np

__all__ = ["quota", "size_classes"]

COST_OF_A_CLASS = 1000
"""Pairs that another class must save: each class is compiled and looped over separately."""


def size_classes(sizes: np.ndarray, batch_scenes: int) -> np.ndarray:
    """The padded sizes, ascending; a scene takes the smallest one that holds it.

    A batch has a `quota` of every class, and pooling costs the square of each padded size. The
    classes minimise the sum of costs (dynamic programming over the sizes).

    Args:
        sizes: [S] agents of each scene.
        batch_scenes: approximate number of scenes in a batch.

    Returns:
        [C] int64; the last is the largest size.
    """
    values, counts = np.unique(sizes, return_counts=True)
    below = np.concatenate([[0], np.cumsum(counts)])
    best, cut = np.zeros(len(values) + 1), np.zeros(len(values) + 1, int)
    for end in range(1, len(values) + 1):
        # One class from each possible beginning to `end`, after the best classes before it.
        members = below[end] - below[:end]
        pairs = quota(members, len(sizes), batch_scenes) * float(values[end - 1]) ** 2
        costs = best[:end] + pairs + COST_OF_A_CLASS
        cut[end] = costs.argmin()
        best[end] = costs[cut[end]]
    classes, end = [], len(values)
    while end:
        classes.append(values[end - 1])
        end = cut[end]
    return np.array(classes[::-1], np.int64)


def quota(members: np.ndarray, scenes: int, batch_scenes: int) -> np.ndarray:
    """[C] scenes of each class in a batch, in proportion to `members` [C], and at least one."""
    return np.maximum(1, np.rint(members * batch_scenes / scenes)).astype(int)
