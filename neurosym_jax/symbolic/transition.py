"""Frequencies of QTC_C1 states and of transitions in data, and the weighting `transition`.

The conceptual neighbourhood diagram (`cnd`) says what is possible in continuous time; these are
counts of what happens from one observed step to the next, over the ordered pairs of scenes.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from neurosym_jax.symbolic.qtc import other_pairs
from neurosym_jax.symbolic.weighting import Parameters, Scenes, SymbolicWeighting, Weighting

__all__ = ["Transition", "count_states"]


@dataclasses.dataclass(frozen=True)
class Transition(SymbolicWeighting):
    """P(q_t | q_(t-1)), as counted in the training data; at the first state P(q_t)."""

    title = "transition"
    learned: bool = False
    """Whether training changes the probabilities."""

    def start(self, scenes: Scenes | None = None) -> Parameters:
        """`state [81]`, P(q_t), and `transition [81, 81]`, P(q_t | q_(t-1)).

        Every transition counts once more than it was seen, so that none is impossible.
        """
        counts = np.zeros((81, 81)) if scenes is None else _count_transitions(self, scenes)
        seen = counts + 1.0
        return {
            "state": seen.sum(axis=1) / seen.sum(),
            "transition": seen / seen.sum(axis=1, keepdims=True),
        }

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`: 0, then P(q_1), P(q_2 | q_1) and so on."""
        given = {name: jnp.asarray(value, positions.dtype) for name, value in parameters.items()}
        if not self.learned:
            given = lax.stop_gradient(given)
        codes = self.codes(parameters, positions)
        first = given["state"].at[codes[..., :1]].get(mode="clip")
        later = given["transition"].at[codes[..., :-1], codes[..., 1:]].get(mode="clip")
        alpha = jnp.concatenate([jnp.zeros_like(first), first, later], axis=-1)
        return alpha[..., : positions.shape[1]]  # A single step has neither.


def count_states(weighting: Weighting, parameters: Parameters, scenes: Scenes) -> np.ndarray:
    """[81] int64: pair-steps in each state, as the weighting observes them."""
    return _count(weighting, parameters, scenes, lambda codes: codes, 81)


def _count_transitions(weighting: Weighting, scenes: Scenes) -> np.ndarray:
    """[81, 81] int64: how often the state of the column followed that of the row."""
    pairs = _count(weighting, {}, scenes, lambda codes: codes[..., :-1] * 81 + codes[..., 1:], 6561)
    return pairs.reshape(81, 81)


def _count(
    weighting: Weighting,
    parameters: Parameters,
    scenes: Scenes,
    key: Callable[[np.ndarray], np.ndarray],
    size: int,
) -> np.ndarray:
    """[size] int64: how often each `key` of the codes [..., T-1] of two different agents occurs."""

    @jax.jit
    @jax.vmap
    def observe(positions: ArrayLike, valid: Array) -> tuple[Array, Array]:
        return weighting.codes(parameters, positions), other_pairs(valid, valid.shape[0])

    total = np.zeros(size, np.int64)
    for positions, valid in scenes:
        codes, others = observe(positions, valid)
        keys = key(np.asarray(codes, np.int64)[np.asarray(others)])
        total += np.bincount(keys.ravel(), minlength=size)
    return total
