"""NeuroSyM's poolings: SGAN's with the pair's relative history weighted step by step by alpha.

`docs/symbols.md` explains the three variants: the papers' (`as_described`), the robot
package's (`neurosym_ros`) and the earlier release's with its defects
(`neurosym_ijcnn`).
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.models.sgan.layers import Affine, Perceptron, with_bias
from neurosym_jax.models.sgan.pooling import (
    NO_FORECAST,
    PoolNet,
    bottleneck_relu,
    max_over_neighbours,
)

__all__ = ["AsDescribed", "NeurosymIjcnn", "NeurosymRos"]


class _DescribedNetwork(nn.Module):
    """As described: each step's `Dense(X_j(t) - X_i(t))` times `alpha_ij(t)`, beside h_j.

    The first layer of the pair perceptron is linear in `[alpha dx, alpha dy, alpha]` of
    each step, so the embedding folds into it: 3 inputs a step instead of
    `embedding_dim`.
    """

    obs_len: int
    embedding_dim: int
    h_dim: int
    hidden_dim: int
    bottleneck_dim: int
    whole_history: ClassVar[bool] = False
    """Whether the embedding takes all steps at once."""

    def setup(self):
        steps = self.obs_len if self.whole_history else 1
        width = self.obs_len * self.embedding_dim
        self.spatial_embedding = Affine(2 * steps, self.embedding_dim * steps)
        self.mlp = Perceptron(
            (width + self.h_dim, self.hidden_dim, self.bottleneck_dim)
        )

    def __call__(
        self, hidden: Array, track: Array, valid: Array, alpha: Array
    ) -> Array:
        """Social vectors `[N, bottleneck_dim]`, see `Pooling.inputs`."""
        first, second = self.mlp.layers
        step_kernel, hidden_kernel = jnp.split(
            first.kernel, [self.obs_len * self.embedding_dim]
        )
        shared, own, neighbour = self.histories(track, step_kernel)
        neighbours = neighbour, with_bias(hidden @ hidden_kernel, first.bias)
        highest = max_over_neighbours(
            self.pair, shared, own, neighbours, alpha, second, valid
        )
        return bottleneck_relu(self, highest)

    def histories(self, track: Array, step_kernel: Array) -> tuple[Array, Array, Array]:
        """The first layer's parameters, and the histories of agents i and of neighbours j."""
        step_kernel = step_kernel.reshape(
            self.obs_len, self.embedding_dim, self.hidden_dim
        )
        # [3, obs_len, hidden_dim]: what alpha dx, alpha dy and alpha of each step
        # contribute.
        dense = self.spatial_embedding
        embedding = jnp.concatenate([dense.kernel, dense.bias[None]])
        folded = jnp.einsum("ce,teh->cth", embedding, step_kernel)
        return folded.reshape(3 * self.obs_len, self.hidden_dim), track, track

    @staticmethod
    def pair(
        folded: Array, own: Array, neighbour: tuple[Array, Array], alpha: Array
    ) -> Array:
        """The first layer of a pair, see `max_over_neighbours`."""
        track, neighbour_part = neighbour
        x, y = (track - own).T
        return jnp.concatenate([alpha * x, alpha * y, alpha]) @ folded + neighbour_part


class _RosNetwork(_DescribedNetwork):
    """The robot package: one Linear over the whole flattened history, then alpha by step.

    Block t of its output, `embedding_dim` channels, is multiplied by `alpha_ij(t)`, but
    mixes all steps. The Linear splits into per-agent parts because the history is a
    difference.
    """

    whole_history: ClassVar[bool] = True

    def histories(self, track: Array, step_kernel: Array) -> tuple[Array, Array, Array]:
        """See `_DescribedNetwork.histories`."""
        own = track.reshape(track.shape[0], -1) @ self.spatial_embedding.kernel
        shape = track.shape[0], self.obs_len, -1
        shifted = with_bias(own, self.spatial_embedding.bias)
        return step_kernel, own.reshape(shape), shifted.reshape(shape)

    @staticmethod
    def pair(
        step_kernel: Array, own: Array, neighbour: tuple[Array, Array], alpha: Array
    ) -> Array:
        """See `_DescribedNetwork.pair`."""
        shifted, neighbour_part = neighbour
        return ((shifted - own) * alpha[:, None]).ravel() @ step_kernel + neighbour_part


class _IjcnnNetwork(_DescribedNetwork):
    """The earlier release: its relative history is identically zero, so nothing depends on i.

    Of the embedding only the bias acts, times a row of alpha that the released
    collation picked for agent j; all agents get the same maximum over j.
    """

    def __call__(self, hidden: Array, valid: Array, alpha_rows: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`, all rows equal; an InputError for other alpha."""
        if np.shape(alpha_rows) != (hidden.shape[0], self.obs_len):
            raise InputError(f"neurosym_ijcnn {NO_FORECAST}")
        embedded = alpha_rows[..., None] * self.spatial_embedding.bias
        vectors = self.mlp(
            jnp.concatenate([embedded.reshape(hidden.shape[0], -1), hidden], axis=-1)
        )
        highest = jnp.where(valid[:, None], vectors, 0).max(axis=0)
        return jnp.broadcast_to(highest, vectors.shape)


@dataclasses.dataclass(frozen=True)
class AsDescribed(PoolNet):
    """NeuroSyM as its papers describe it."""

    title: ClassVar[str] = "NeuroSyM"
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "track", "alpha"})
    variant: ClassVar[type[_DescribedNetwork]] = _DescribedNetwork

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return self.variant(
            obs_len, embedding_dim, h_dim, self.hidden_dim, self.bottleneck_dim
        )


@dataclasses.dataclass(frozen=True)
class NeurosymRos(AsDescribed):
    """NeuroSyM as the authors' robot package computes it."""

    title: ClassVar[str] = "NeuroSyM (robot package)"
    variant: ClassVar[type[_DescribedNetwork]] = _RosNetwork


@dataclasses.dataclass(frozen=True)
class NeurosymIjcnn(AsDescribed):
    """NeuroSyM as the earlier release computes it, with its defects."""

    title: ClassVar[str] = "NeuroSyM (IJCNN release)"
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "alpha_rows"})
    variant: ClassVar[type[_DescribedNetwork]] = _IjcnnNetwork
