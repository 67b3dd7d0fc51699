"""Pooling over the neighbours in one scene: `[N, H]` hidden states to `[N, B]` social vectors.

Every pooling takes (hidden, positions, valid), gives a finite value for every slot, and lets only
valid agents contribute. An agent is among its own neighbours in `HiddenPooling`, as in SGAN, so the
maximum is never over nothing.
"""

from typing import Any

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.models.layers import Affine, Perceptron
from neurosym_jax.models.pairs import max_over_neighbours
from neurosym_jax.models.symbolic_pooling import SYMBOLIC_POOLINGS

__all__ = ["HiddenPooling", "Pooling", "SocialPooling", "make_pooling"]

Pooling = Any
"""A module of this file, or of `symbolic_pooling` with alpha as a fourth argument."""


class HiddenPooling(nn.Module):
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

    def __call__(self, hidden: Array, positions: Array, valid: Array) -> Array:
        """`hidden [N, H]`, `positions [N, 2]`, `valid [N]` to `[N, bottleneck_dim]`."""
        first, second = self.mlp.layers
        of_embedding, of_hidden = jnp.split(first.kernel, [self.embedding_dim])
        v = positions @ (self.spatial_embedding.kernel @ of_embedding)
        u = v + hidden @ of_hidden + (self.spatial_embedding.bias @ of_embedding + first.bias)
        return max_over_neighbours(_difference, (), v, u, (), second, valid)


def _difference(_, v: Array, u: Array, __) -> Array:
    return u - v


class SocialPooling(nn.Module):
    """Social LSTM's pooling: neighbours' hidden states summed in the cells of a grid.

    The grid has `grid_size` x `grid_size` cells over a square of side `neighborhood_size` metres
    centred on the agent, x to the right and y downwards, as in SGAN's code.
    """

    h_dim: int
    grid_size: int
    neighborhood_size: float

    def setup(self):
        """Declare the single layer after the grid."""
        self.mlp = Perceptron((self.grid_size**2 * self.h_dim, self.h_dim))

    def __call__(self, hidden: Array, positions: Array, valid: Array) -> Array:
        """`hidden [N, H]`, `positions [N, 2]`, `valid [N]` to `[N, H]`."""
        agents = positions.shape[0]
        half = self.neighborhood_size / 2
        offset = positions[None, :, :] - positions[:, None, :]
        inside = (
            (jnp.abs(offset) < half).all(axis=-1) & valid[None, :] & ~jnp.eye(agents, dtype=bool)
        )
        scaled = (jnp.stack([offset[..., 0], -offset[..., 1]], -1) + half) / (2 * half)
        column, row = jnp.moveaxis(jnp.floor(scaled * self.grid_size), -1, 0)
        cell = jnp.where(inside, column + self.grid_size * row, -1)
        occupied = (cell[..., None] == jnp.arange(self.grid_size**2)).astype(hidden.dtype)
        grid = jnp.einsum("ijc,jh->ich", occupied, hidden)
        return self.mlp(grid.reshape(agents, -1))


def make_pooling(config: GeneratorConfig, h_dim: int) -> Pooling:
    """The pooling that `config` names, for hidden states of size `h_dim`; there must be one."""
    if config.pooling == "social":
        return SocialPooling(h_dim, config.grid_size, config.neighborhood_size)
    sizes = (config.embedding_dim, h_dim, config.pool_hidden_dim, config.bottleneck_dim)
    if config.pooling == "pool_net":
        return HiddenPooling(*sizes)
    return SYMBOLIC_POOLINGS[config.pooling](config.obs_len, *sizes)
