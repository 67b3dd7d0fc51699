"""The rows of alpha that NeuroSyM's first release hands to its network, which are not its pairs'.

The released data set keeps one row of weights for each ordered pair, N*N for a scene of N agents,
all scenes after each other; but it takes a scene's rows out by the agents' bounds, N for a scene of
N agents. So a scene is served rows of other pairs, after the first scene of other scenes' pairs,
and which ones depends on everything before it in the data set. The network then reads row
start + j for agent j, whoever looks at j. Nothing but parity needs this.
"""

import numpy as np

from neurosym_jax.errors import InputError

__all__ = ["alpha_rows_used"]


def alpha_rows_used(pair_rows: np.ndarray, bounds: np.ndarray) -> list[np.ndarray]:
    """For each scene, the rows [N, T] that the released code multiplies its agents by.

    Args:
        pair_rows: [sum of N*N, T] weights of the pairs of all scenes, pair (i, j) of a scene in
            its row i*N + j; a scene of one agent has one row.
        bounds: [S, 2] first and one past the last agent of each scene, counted over all scenes.

    Raises:
        InputError: where there are not as many rows as pairs.
    """
    pairs = int(((bounds[:, 1] - bounds[:, 0]) ** 2).sum())
    if len(pair_rows) != pairs:
        raise InputError(f"'alpha' has {len(pair_rows)} rows for {pairs} pairs")
    return [pair_rows[start:end] for start, end in bounds]
