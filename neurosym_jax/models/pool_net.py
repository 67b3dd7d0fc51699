"""SGAN's pooling: a perceptron of every pair, and the maximum over neighbours.

An agent is among its own neighbours, as in SGAN, so the maximum is never over nothing.
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Count
from neurosym_jax.models.layers import Affine, Perceptron
from neurosym_jax.models.pairs import bottleneck_relu, max_over_neighbours
from neurosym_jax.models.pooling import Pooling

__all__ = ["PoolNet", "PoolNetwork"]


@dataclasses.dataclass(frozen=True)
class PoolNet(Pooling):
    """SGAN's pooling (Gupta et al., CVPR 2018), see `PoolNetwork`."""

    title: ClassVar[str] = "SGAN"
    bottleneck_dim: Count = 8
    hidden_dim: Count = 512

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return PoolNetwork(embedding_dim, h_dim, self.hidden_dim, self.bottleneck_dim)


class PoolNetwork(nn.Module):
    """SGAN's pooling module: a perceptron of `[Dense(p_j - p_i); h_j]`, maximum over j.

    The first layer is linear in the pair, so it splits into per-agent parts,
    `W [S (p_j - p_i) + s; h_j] + b = u_j - v_i`; only its ReLU and the small second layer are
    computed per pair.
    """

    embedding_dim: int
    h_dim: int
    hidden_dim: int
    bottleneck_dim: int

    def setup(self):
        """Declare the embedding of relative positions and the pair perceptron."""
        self.spatial_embedding = Affine(2, self.embedding_dim)
        self.mlp = Perceptron(
            (self.embedding_dim + self.h_dim, self.hidden_dim, self.bottleneck_dim)
        )

    def __call__(self, hidden: Array, position: Array, valid: Array) -> Array:
        """`hidden [N, H]`, `position [N, 2]`, `valid [N]` to `[N, bottleneck_dim]`."""
        first, second = self.mlp.layers
        of_embedding, of_hidden = jnp.split(first.kernel, [self.embedding_dim])
        v = position @ (self.spatial_embedding.kernel @ of_embedding)
        u = v + hidden @ of_hidden + (self.spatial_embedding.bias @ of_embedding + first.bias)
        highest = max_over_neighbours(_difference, (), v, u, (), second, valid)
        return bottleneck_relu(self, highest)


def _difference(_, v: Array, u: Array, __) -> Array:
    return u - v
