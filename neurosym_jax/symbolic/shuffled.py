"""The control `shuffled`: the weights of `quantised` with the wrong pairs."""

import dataclasses

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import NotNegative
from neurosym_jax.symbolic.qtc import other_pairs
from neurosym_jax.symbolic.state_weightings import TableWeighting, after_first
from neurosym_jax.symbolic.weighting import Parameters

__all__ = ["Shuffled", "to_wrong_pairs"]


@dataclasses.dataclass(frozen=True)
class Shuffled(TableWeighting):
    """The weights of `quantised` with the wrong pairs, and the last step first.

    Each neighbour of an agent gets those of the next nearer one, the nearest those of the farthest:
    the same weights in the same scene, without their meaning.
    """

    title = "shuffled"
    quantisation_factor: NotNegative = 0.05

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        observed = self.observed(parameters, positions)
        return after_first(to_wrong_pairs(observed, positions[:, -1], valid), parameters)


def to_wrong_pairs(observed: Array, last: Array, valid: ArrayLike | None) -> Array:
    """`observed [N, N, T-1]` of `shuffled`, by the last positions `last [N, 2]`.

    Each agent keeps its weights in another order, which follows from the scene alone: neither
    rotation nor padding nor the order of the agents changes it.
    """
    others = other_pairs(valid, last.shape[0])
    apart = jnp.square(last[:, None] - last[None]).sum(axis=-1)
    by_distance = jnp.argsort(jnp.where(others, apart, jnp.inf), axis=1)
    rank = jnp.argsort(by_distance, axis=1)
    of_others = jnp.maximum(others.sum(axis=1, keepdims=True), 1)
    source = jnp.take_along_axis(by_distance, (rank - 1) % of_others, axis=1)
    return jnp.take_along_axis(observed[..., ::-1], source[..., None], axis=1)
