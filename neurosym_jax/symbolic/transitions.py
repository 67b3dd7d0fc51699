"""How often people were seen to be in each QTC_C1 state, and to go from one to the next.

The conceptual neighbourhood diagram (`cnd`) says what is possible in continuous time; this is what
happens from one observed step to the next, counted over the ordered pairs of scenes.
"""

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.symbolic.qtc import other_pairs, pairwise_qtc_c1
from neurosym_jax.symbolic.states import encode_state
from neurosym_jax.symbolic.weighting_kind import Scenes

if TYPE_CHECKING:
    from neurosym_jax.symbolic.weighting_config import WeightingConfig

__all__ = [
    "count_states",
    "count_transitions",
    "pair_codes",
    "pair_states",
    "transition_parameters",
]


def pair_states(config: "WeightingConfig", positions: Any, valid: Any) -> Array:
    """[N, N, T-1, 4] states of one scene, by the config's quantisation and convention."""
    return pairwise_qtc_c1(
        positions,
        valid,
        quantisation_factor=config.quantisation_factor or 0.0,
        convention=config.convention,
        side_quantisation_factor=config.side_quantisation_factor,
    )


def pair_codes(config: "WeightingConfig", positions: Any, valid: Any) -> Array:
    """[N, N, T-1] codes of one scene's states; 81 for a pair that is not of two valid agents."""
    states = pair_states(config, positions, valid)
    others = other_pairs(valid, len(positions))
    return jnp.where(others[..., None], encode_state(states), 81)


def count_states(config: "WeightingConfig", scenes: Scenes) -> np.ndarray:
    """[81] int64: pair-steps in each state."""
    return _count(config, scenes, lambda codes: codes, 81)


def count_transitions(config: "WeightingConfig", scenes: Scenes) -> np.ndarray:
    """[81, 81] int64: how often a pair in the state of the row was then in that of the column."""
    # A pair that is none has the code 81 at both steps, which lies beyond all of those that are.
    pairs = _count(config, scenes, lambda codes: codes[..., :-1] * 81 + codes[..., 1:], 81 * 81)
    return pairs.reshape(81, 81)


def transition_parameters(counts: np.ndarray) -> dict[str, np.ndarray]:
    """The weighting `transition`: `state [81]`, P(q_t), and `transition [81, 81]`, P(q_t | q_t-1).

    Everything is taken to have been seen once more than it was, so that nothing is impossible.
    """
    seen = counts + 1.0
    return {
        "state": (seen.sum(axis=1) / seen.sum()).astype(np.float32),
        "transition": (seen / seen.sum(axis=1, keepdims=True)).astype(np.float32),
    }


def _count(config: "WeightingConfig", scenes: Scenes, key: Any, size: int) -> np.ndarray:
    observe = jax.jit(jax.vmap(lambda positions, valid: pair_codes(config, positions, valid)))
    total = np.zeros(size, np.int64)
    for positions, valid in scenes:
        keys = key(np.asarray(observe(positions, valid), np.int64)).ravel()
        total += np.bincount(keys[keys < size], minlength=size)
    return total
