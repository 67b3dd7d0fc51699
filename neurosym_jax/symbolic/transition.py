"""Frequencies of QTC_C1 states and of transitions in data, and the weighting `transition`.

The conceptual neighbourhood diagram (`cnd`) says what is possible in continuous time; these are
counts of what happens from one observed step to the next, over the ordered pairs of scenes.
"""

import dataclasses

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
        seen = np.ones((81, 81))
        for codes in _observed_pairs(self, {}, scenes or ()):
            keys = codes[:, :-1] * 81 + codes[:, 1:]
            seen += np.bincount(keys.ravel(), minlength=81 * 81).reshape(81, 81)
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
    total = np.zeros(81, np.int64)
    for codes in _observed_pairs(weighting, parameters, scenes):
        total += np.bincount(codes.ravel(), minlength=81)
    return total


def _observed_pairs(weighting: Weighting, parameters: Parameters, scenes: Scenes):
    """Codes [P, T-1] of the pairs of two different agents, batch by batch."""

    @jax.jit
    @jax.vmap
    def observe(positions: ArrayLike, valid: Array) -> tuple[Array, Array]:
        return weighting.codes(parameters, positions), other_pairs(valid, valid.shape[0])

    for positions, valid in scenes:
        codes, others = map(np.asarray, observe(positions, valid))
        yield codes[others]
