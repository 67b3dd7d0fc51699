"""The poolings that take alpha: NeuroSyM's, and encounter pooling.

NeuroSyM's is SGAN's with the pair's relative history weighted step by step by alpha.
`docs/symbols.md` explains its three variants: the papers' (`as_described`), the robot package's
(`neurosym_ros`) and the earlier release's with its defects (`neurosym_ijcnn`).

Encounter pooling is attention over neighbours. It sees velocities and the closest approach too, in
the agent's own frame (ahead, left). Its output is vectors, rotated back into the scene's axes, and
scalars, so a rotated scene gives rotated vectors and the same scalars.
"""

import dataclasses
from typing import Annotated, ClassVar

import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax import Array, lax

from neurosym_jax.configuration import Rule, Size
from neurosym_jax.errors import InputError
from neurosym_jax.models.frames import closest_approach, length, turned
from neurosym_jax.models.layers import Affine, Perceptron, with_bias
from neurosym_jax.models.pooling import (
    NO_FORECAST,
    Pooling,
    PoolNet,
    bottleneck_relu,
    max_over_neighbours,
)

__all__ = ["AsDescribed", "Encounter", "NeurosymIjcnn", "NeurosymRos"]


class _DescribedNetwork(nn.Module):
    """As described: each step's `Dense(X_j(t) - X_i(t))` times `alpha_ij(t)`, beside h_j.

    The first layer of the pair perceptron is linear in `[alpha dx, alpha dy, alpha]` of each step,
    so the embedding folds into it: 3 inputs a step instead of `embedding_dim`.
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
        self.mlp = Perceptron((width + self.h_dim, self.hidden_dim, self.bottleneck_dim))

    def __call__(self, hidden: Array, track: Array, valid: Array, alpha: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`, see `Pooling.inputs`."""
        first, second = self.mlp.layers
        of_steps, of_hidden = jnp.split(first.kernel, [self.obs_len * self.embedding_dim])
        shared, own, theirs = self.histories(track, of_steps)
        neighbours = theirs, with_bias(hidden @ of_hidden, first.bias)
        highest = max_over_neighbours(self.pair, shared, own, neighbours, alpha, second, valid)
        return bottleneck_relu(self, highest)

    def histories(self, track: Array, of_steps: Array) -> tuple[Array, Array, Array]:
        """The first layer's parameters, and the histories of agents i and of neighbours j."""
        of_steps = of_steps.reshape(self.obs_len, self.embedding_dim, self.hidden_dim)
        # [3, obs_len, hidden_dim]: what alpha dx, alpha dy and alpha of each step contribute.
        dense = self.spatial_embedding
        embedding = jnp.concatenate([dense.kernel, dense.bias[None]])
        folded = jnp.einsum("ce,teh->cth", embedding, of_steps)
        return folded.reshape(3 * self.obs_len, self.hidden_dim), track, track

    @staticmethod
    def pair(folded: Array, own: Array, theirs: tuple[Array, Array], alpha: Array) -> Array:
        """The first layer of a pair, see `max_over_neighbours`."""
        track, of_neighbour = theirs
        x, y = (track - own).T
        return jnp.concatenate([alpha * x, alpha * y, alpha]) @ folded + of_neighbour


class _RosNetwork(_DescribedNetwork):
    """The robot package: one Linear over the whole flattened history, then alpha by step.

    Block t of its output, `embedding_dim` channels, is multiplied by `alpha_ij(t)`, but mixes all
    steps. The Linear splits into per-agent parts because the history is a difference.
    """

    whole_history: ClassVar[bool] = True

    def histories(self, track: Array, of_steps: Array) -> tuple[Array, Array, Array]:
        """See `_DescribedNetwork.histories`."""
        own = track.reshape(track.shape[0], -1) @ self.spatial_embedding.kernel
        shape = track.shape[0], self.obs_len, -1
        return (
            of_steps,
            own.reshape(shape),
            with_bias(own, self.spatial_embedding.bias).reshape(shape),
        )

    @staticmethod
    def pair(of_steps: Array, own: Array, theirs: tuple[Array, Array], alpha: Array) -> Array:
        """See `_DescribedNetwork.pair`."""
        shifted, of_neighbour = theirs
        return ((shifted - own) * alpha[:, None]).ravel() @ of_steps + of_neighbour


class _IjcnnNetwork(_DescribedNetwork):
    """The earlier release: its relative history is identically zero, so nothing depends on i.

    Of the embedding only the bias acts, times a row of alpha that the released collation picked for
    agent j; all agents get the same maximum over j.
    """

    def __call__(self, hidden: Array, valid: Array, alpha_rows: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`, all rows equal; an InputError for other alpha."""
        if np.shape(alpha_rows) != (hidden.shape[0], self.obs_len):
            raise InputError(f"neurosym_ijcnn {NO_FORECAST}")
        embedded = alpha_rows[..., None] * self.spatial_embedding.bias
        each = self.mlp(jnp.concatenate([embedded.reshape(hidden.shape[0], -1), hidden], axis=-1))
        highest = jnp.where(valid[:, None], each, 0).max(axis=0)
        return jnp.broadcast_to(highest, each.shape)


@dataclasses.dataclass(frozen=True)
class AsDescribed(PoolNet):
    """NeuroSyM as its papers describe it."""

    title: ClassVar[str] = "NeuroSyM"
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "track", "alpha"})
    variant: ClassVar[type[_DescribedNetwork]] = _DescribedNetwork

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return self.variant(obs_len, embedding_dim, h_dim, self.hidden_dim, self.bottleneck_dim)


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


@dataclasses.dataclass(frozen=True)
class Encounter(Pooling):
    """Attention over neighbours by bearing, relative velocity and closest approach."""

    title: ClassVar[str] = "NeuroSyM, encounter pooling"
    inputs: ClassVar[frozenset[str]] = frozenset({"track", "alpha"})
    bottleneck_dim: Annotated[Size, Rule("be a multiple of 4", lambda dim: dim % 4 == 0)] = 16
    """A part for each head; half of it are pushes, pairs of numbers."""
    hidden_dim: Size = 32

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return _EncounterNetwork(self.hidden_dim, self.bottleneck_dim)


class _EncounterNetwork(nn.Module):
    """`sum_j a_ij exp(s_ij) m_ij / sum_j a_ij exp(s_ij)` over the others j.

    Messages m and scores s, one for each quarter of m, are a perceptron's of the pair; a_ij is
    alpha of the state that the pair was last observed in. Only ratios of alpha between neighbours
    count: a weighting with the same alpha for all neighbours has no effect. Negative weights are 0.
    """

    HEADS = 4
    STEPS = 4.0  # time steps in a unit of time: velocities are metres in so many steps
    SLOW = 0.01  # speed below which a heading fades away, metres a step
    SMOOTH = 0.01  # metres below which lengths are smooth
    LONGEST = 5.0  # longest look-ahead to the closest approach, in units of `STEPS`

    hidden_dim: int
    bottleneck_dim: int

    def setup(self):
        self.pair = Affine(9, self.hidden_dim)
        self.message = Affine(self.hidden_dim, self.bottleneck_dim)
        self.score = Affine(self.hidden_dim, self.HEADS)

    def __call__(self, track: Array, valid: Array, alpha: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`; 0 without a neighbour of positive weight."""
        position, back = track[:, -1], min(2, track.shape[1] - 1)
        velocity = self.STEPS * (position - track[:, -1 - back]) / max(back, 1)
        speed = length(velocity, self.SMOOTH)
        heading = velocity / jnp.hypot(speed, self.STEPS * self.SLOW)[:, None]

        there = turned(position - position[:, None], heading[:, None], -1)
        motion = turned(velocity - velocity[:, None], heading[:, None], -1)
        distance = length(there, self.SMOOTH)
        speed = jnp.broadcast_to(speed[:, None], distance.shape)
        soon, miss = closest_approach(there, motion, 0.04, self.LONGEST, self.SMOOTH)
        bearing = there / jnp.maximum(distance, 1)[..., None]
        numbers = [jnp.exp(-distance), soon, jnp.exp(-2 * miss - soon), speed, 1 / (distance + 0.3)]
        pairs = jnp.concatenate([bearing, motion, jnp.stack(numbers, axis=-1)], axis=-1)
        said = nn.relu(self.pair(pairs))

        others = valid & ~jnp.eye(valid.shape[0], dtype=bool)
        weight = jnp.where(others, jnp.maximum(alpha[..., -1], 0), 0)[..., None]
        score = self.score(said) - distance[..., None]
        # No more than 0, so that nothing overflows; a ratio does not change.
        most = jnp.where(weight > 0, score, -jnp.inf).max(axis=1, keepdims=True)
        score = jnp.minimum(score - lax.stop_gradient(jnp.where(weight > 0, most, 0)), 0)
        share = weight * jnp.exp(score)
        whole = share.sum(axis=1, keepdims=True)
        share = share / jnp.where(whole > 0, whole, 1)

        message = self.message(said).reshape(*share.shape, -1)
        pooled = (share[..., None] * message).sum(axis=1).reshape(valid.shape[0], -1)
        pushes, numbers = jnp.split(pooled, 2, axis=-1)
        pushes = turned(pushes.reshape(valid.shape[0], -1, 2), heading[:, None], 1)
        return jnp.concatenate([pushes.reshape(numbers.shape), numbers], axis=-1)
