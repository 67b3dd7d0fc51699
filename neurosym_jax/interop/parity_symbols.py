"""Parity of symbols: QTC arrays, and the weights that NeuroSyM's released code makes of them.

Symbols are observed in float64 from the positions as stored, not centred: an exact tie, such as
everybody on one line, is one in the coordinates that the released code saw.
"""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.windows import Windows
from neurosym_jax.interop.parity_case import Arrays, Compared, floats, whole_numbers
from neurosym_jax.symbolic.calculi import observe
from neurosym_jax.symbolic.cnd import alpha_from_states
from neurosym_jax.symbolic.state_weightings import CndShipped
from neurosym_jax.symbolic.weightings import make_weighting

__all__ = ["qtc", "shipped_alpha"]

DECIMALS = 4
"""Of the authors' table as they printed it, and of their coordinates."""

RELEASED = CndShipped(convention="as_published", decimals=DECIMALS)


def qtc(row: Mapping[str, Any], arrays: Arrays) -> Compared:
    """States and weights of stored pairs, in every convention that is stored.

    The released code writes 10 for a pair in which both people stand; we write 0.
    """
    del row
    k = floats(arrays, "k", None, None, 2).astype(np.float64)
    l = floats(arrays, "l", *k.shape).astype(np.float64)  # noqa: E741 (the calculus calls them so)
    steps = (len(k), k.shape[1] - 1)
    with jax.enable_x64(True):
        compiled = jax.jit(observe, static_argnames="convention")
        released = compiled(k, l, convention="as_published")
        ours = {
            "qtc_reference": released,
            "qtc_signed": compiled(k, l),
            "qtc_signed_q005": compiled(k, l, quantisation_factor=0.05),
        }
        weights = np.asarray(alpha_from_states(released, RELEASED.state_weights()))
    compared: Compared = {}
    for name, states in ours.items():
        theirs = whole_numbers(arrays, name, *steps, 4)
        compared[name] = (np.asarray(states), np.where(theirs == 10, 0, theirs))
    return compared | {"alpha_reference": (weights, floats(arrays, "alpha_reference", *steps))}


def shipped_alpha(windows: Windows) -> np.ndarray:
    """[sum of N*N, T] by the authors' table; a scene of one agent has one row, of zeros."""
    # Stored as float32, but the released code observed its symbols in float64.
    positions = np.round(windows.position[:, : windows.obs_len], DECIMALS)
    weigh = jax.jit(make_weighting(RELEASED))
    with jax.enable_x64(True):
        scenes = [np.asarray(weigh(part)) for part in np.split(positions, windows.bounds[1:-1])]
    return np.concatenate([alpha.reshape(-1, alpha.shape[-1]) for alpha in scenes])
