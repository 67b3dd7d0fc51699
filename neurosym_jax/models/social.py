"""Social LSTM's pooling: a grid around every agent (Alahi et al., CVPR 2016)."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Count, Positive
from neurosym_jax.models.layers import Perceptron
from neurosym_jax.models.pooling import Pooling

__all__ = ["Social"]


@dataclasses.dataclass(frozen=True)
class Social(Pooling):
    """Social LSTM's pooling: neighbours' hidden states summed in the cells of a grid.

    The grid has `grid_size` x `grid_size` cells over a square of side `neighborhood_size` metres
    centred on the agent, x to the right and y downwards, as in SGAN's code.
    """

    title: ClassVar[str] = "SGAN, social pooling"
    neighborhood_size: Positive = 2.0
    grid_size: Count = 8

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return _GridNetwork(h_dim, self.grid_size, self.neighborhood_size)

    def width(self, h_dim: int) -> int:
        """That of a hidden state."""
        return h_dim


class _GridNetwork(nn.Module):
    h_dim: int
    grid_size: int
    neighborhood_size: float

    def setup(self):
        """Declare the single layer after the grid."""
        self.mlp = Perceptron((self.grid_size**2 * self.h_dim, self.h_dim))

    def __call__(self, hidden: Array, position: Array, valid: Array) -> Array:
        """`hidden [N, H]`, `position [N, 2]`, `valid [N]` to `[N, H]`."""
        agents = position.shape[0]
        half = self.neighborhood_size / 2
        offset = position[None] - position[:, None]
        inside = (
            (jnp.abs(offset) < half).all(axis=-1) & valid[None, :] & ~jnp.eye(agents, dtype=bool)
        )
        scaled = (jnp.stack([offset[..., 0], -offset[..., 1]], -1) + half) / (2 * half)
        column, row = jnp.moveaxis(jnp.floor(scaled * self.grid_size), -1, 0)
        cell = jnp.where(inside, column + self.grid_size * row, -1)
        occupied = (cell[..., None] == jnp.arange(self.grid_size**2)).astype(hidden.dtype)
        grid = jnp.einsum("ijc,jh->ich", occupied, hidden)
        return self.mlp(grid.reshape(agents, -1))
