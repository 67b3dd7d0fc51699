"""The table of poolings, and the two short ones: none, and Social LSTM's."""

import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Count, Positive
from neurosym_jax.models.encounter import Encounter
from neurosym_jax.models.layers import Perceptron
from neurosym_jax.models.neurosym import AsDescribed, NeurosymIjcnn, NeurosymRos
from neurosym_jax.models.pool_net import PoolNet
from neurosym_jax.models.pooling import Pooling
from neurosym_jax.plugins import Registry

__all__ = ["POOLINGS", "NoPooling", "Social", "pooling_names", "register_pooling"]


@dataclasses.dataclass(frozen=True)
class NoPooling(Pooling):
    """Agents do not see each other."""

    title: ClassVar[str] = "SGAN, no pooling"
    inputs: ClassVar[frozenset[str]] = frozenset()

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> Any:
        """None: there is nothing to call."""

    def width(self, h_dim: int) -> int:
        """0."""
        return 0


@dataclasses.dataclass(frozen=True)
class Social(Pooling):
    """Social LSTM's pooling: neighbours' hidden states summed in the cells of a grid.

    Alahi et al., CVPR 2016. The grid has `grid_size` x `grid_size` cells over a square of side
    `neighborhood_size` metres centred on the agent, x to the right and y downwards, as in SGAN's
    code.
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
        half = self.neighborhood_size / 2
        offset = position[None] - position[:, None]
        inside = (jnp.abs(offset) < half).all(axis=-1) & valid & ~jnp.eye(len(valid), dtype=bool)
        scaled = (jnp.stack([offset[..., 0], -offset[..., 1]], -1) + half) / (2 * half)
        column, row = jnp.moveaxis(jnp.floor(scaled * self.grid_size), -1, 0)
        cell = jnp.where(inside, column + self.grid_size * row, -1)
        occupied = (cell[..., None] == jnp.arange(self.grid_size**2)).astype(hidden.dtype)
        grid = jnp.einsum("ijc,jh->ich", occupied, hidden)
        return self.mlp(grid.reshape(len(valid), -1))


POOLINGS: Registry[type[Pooling]] = Registry(
    "pooling",
    {
        "none": NoPooling,
        "pool_net": PoolNet,
        "social": Social,
        "as_described": AsDescribed,
        "neurosym_ros": NeurosymRos,
        "encounter": Encounter,
        "neurosym_ijcnn": NeurosymIjcnn,
    },
)

register_pooling = POOLINGS.register


def pooling_names(*, symbolic: bool) -> tuple[str, ...]:
    """Names of the poolings that can be trained: NeuroSyM's, which take alpha, or the others."""
    return tuple(
        name
        for name, pooling in POOLINGS.items()
        if ("alpha" in pooling.inputs) == symbolic and "alpha_rows" not in pooling.inputs
    )
