"""What a pooling is, and the two short ones: none, and Social LSTM's."""

import abc
import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Checked, Count, Positive
from neurosym_jax.models.layers import Perceptron

__all__ = ["NO_FORECAST", "NoPooling", "Pooling", "Social"]

NO_FORECAST = (
    "does not weight pairs: it takes one row of alpha an agent, picked by the released collation "
    "out of other scenes' pairs, so it forecasts in parity cases only"
)
"""What is wrong with a pooling that takes "alpha_rows"."""


@dataclasses.dataclass(frozen=True)
class Pooling(Checked, abc.ABC):
    """A pooling over each agent's neighbours in one scene; the fields of a subclass are options.

    A subclass is registered by `register_pooling` and chosen by `GeneratorConfig.pooling`.
    """

    title: ClassVar[str]
    """What a model with it is called in tables."""
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "position"})
    """What the network is called with, by name, besides `valid` [N] bool:

    - "hidden": [N, h_dim] hidden states;
    - "position": [N, 2] metres, the last position;
    - "track": [N, obs_len, 2] metres, the last positions, observed or predicted;
    - "alpha": [N, N, obs_len] weight of j for i at each step of the track;
    - "alpha_rows": [N, obs_len] instead, for the parity of a release (`NO_FORECAST`).
    """

    @abc.abstractmethod
    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> Any:
        """The Flax module from `inputs` to [N, `width(h_dim)`].

        It returns finite vectors for every slot; only valid agents contribute. Sizes are those of
        a hidden state, a track, and an embedded position in the generator.
        """

    def width(self, h_dim: int) -> int:
        """Size of a pooled vector, by default the option `bottleneck_dim`."""
        return getattr(self, "bottleneck_dim")  # noqa: B009 (a subclass has it)


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
        return self.mlp(jnp.einsum("ijc,jh->ich", occupied, hidden).reshape(len(valid), -1))
