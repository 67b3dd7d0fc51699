"""A plugin: attention over neighbours by bearing, relative velocity and closest approach.

It works in each agent's own frame (ahead, left). Its output is vectors, rotated back
into the scene's axes, and scalars, so a rotated scene gives rotated vectors and the
same scalars. Use it by `neurosym train --plugin examples/encounter_pooling.py --family
neurosym --pooling encounter`.
"""

import dataclasses
from typing import Annotated, ClassVar

import jax.numpy as jnp
from flax import linen as nn
from jax import Array, lax

from neurosym_jax.configuration import Count, Rule
from neurosym_jax.models import Pooling, register_pooling
from neurosym_jax.models.anchors.config import closest_approach, length, turned
from neurosym_jax.models.sgan.network import Affine


@register_pooling("encounter")
@dataclasses.dataclass(frozen=True)
class Encounter(Pooling):
    """Attention over neighbours by bearing, relative velocity and closest approach."""

    title: ClassVar[str] = "NeuroSyM, encounter pooling"
    inputs: ClassVar[frozenset[str]] = frozenset({"track", "alpha"})
    bottleneck_dim: Annotated[
        Count, Rule("be a multiple of 4", lambda dim: dim % 4 == 0)
    ] = 16
    """A part for each head; half of it are pushes, pairs of numbers."""
    hidden_dim: Count = 32

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return _EncounterNetwork(self.hidden_dim, self.bottleneck_dim)


class _EncounterNetwork(nn.Module):
    """`sum_j a_ij exp(s_ij) m_ij / sum_j a_ij exp(s_ij)` over the others j.

    Messages m and scores s, one for each quarter of m, are a perceptron's of the pair;
    a_ij is alpha of the state that the pair was last observed in. Only ratios of alpha
    between neighbours count: a weighting with the same alpha for all neighbours has no
    effect. Negative weights are 0.
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

        relative = turned(position - position[:, None], heading[:, None], -1)
        motion = turned(velocity - velocity[:, None], heading[:, None], -1)
        distance = length(relative, self.SMOOTH)
        speed = jnp.broadcast_to(speed[:, None], distance.shape)
        soon, miss = closest_approach(relative, motion, 0.04, self.LONGEST, self.SMOOTH)
        bearing = relative / jnp.maximum(distance, 1)[..., None]
        numbers = [
            jnp.exp(-distance),
            soon,
            jnp.exp(-2 * miss - soon),
            speed,
            1 / (distance + 0.3),
        ]
        pairs = jnp.concatenate([bearing, motion, jnp.stack(numbers, axis=-1)], axis=-1)
        features = nn.relu(self.pair(pairs))

        others = valid & ~jnp.eye(valid.shape[0], dtype=bool)
        weight = jnp.where(others, jnp.maximum(alpha[..., -1], 0), 0)[..., None]
        score = self.score(features) - distance[..., None]
        # No more than 0, so that nothing overflows; a ratio does not change.
        most = jnp.where(weight > 0, score, -jnp.inf).max(axis=1, keepdims=True)
        score = jnp.minimum(
            score - lax.stop_gradient(jnp.where(weight > 0, most, 0)), 0
        )
        share = weight * jnp.exp(score)
        total = share.sum(axis=1, keepdims=True)
        share = share / jnp.where(total > 0, total, 1)

        message = self.message(features).reshape(*share.shape, -1)
        pooled = (share[..., None] * message).sum(axis=1).reshape(valid.shape[0], -1)
        pushes, numbers = jnp.split(pooled, 2, axis=-1)
        pushes = turned(pushes.reshape(valid.shape[0], -1, 2), heading[:, None], 1)
        return jnp.concatenate([pushes.reshape(numbers.shape), numbers], axis=-1)
