"""The part of every pooling that works on pairs: second layer, and maximum over the neighbours."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.models.layers import Affine

__all__ = ["max_over_neighbours"]


def max_over_neighbours(
    first_layer: Callable[[Any], Array], agents: Any, second: Affine, valid: Array
) -> Array:
    """`max_j relu(W relu(first_layer(i)_j) + b)` over valid j, for every agent i.

    Agents are taken one by one, and the first layer's output is computed again for the gradient:
    so the widest array is `[N, hidden]`, which stays in the cache where `[N, N, hidden]` does not.

    Args:
        first_layer: from agent i's slice of `agents` to `[N, hidden]`, one row a neighbour j.
        agents: arrays with a leading axis of N agents.
        second: the second layer, `hidden -> B`.
        valid: [N] bool.

    Returns:
        [N, B], finite and at least 0 for every slot.
    """
    kernel, bias = second.kernel, second.bias

    @jax.checkpoint
    def of_agent(agent: Any) -> Array:
        pairs = nn.relu(nn.relu(first_layer(agent)) @ kernel + bias)
        # The last ReLU makes every candidate non-negative, so zero is neutral for the maximum.
        return jnp.where(valid[:, None], pairs, 0).max(axis=0)

    return jax.lax.map(of_agent, agents)
