"""Pooling by encounter: what each neighbour is about to be to oneself, by attention.

Where SGAN's and NeuroSyM's poolings know where neighbours are, this knows how they move, too, and
how near they would come, all as seen by oneself: ahead and to the left. What comes out are pushes,
turned back into the scene's axes, and plain numbers. So a scene that is turned is pooled the same.
"""

import jax.numpy as jnp
from flax import linen as nn
from jax import Array, lax

from neurosym_jax.errors import InputError
from neurosym_jax.models.layers import Affine

__all__ = ["EncounterPooling"]

FEATURES = 9
HEADS = 4
STEPS = 4.0
"""Time steps over which velocities are metres; times are counted in as many."""
SLOW = 0.01
"""Metres a step below which a heading fades away."""
LONGEST = 5.0
"""Times `STEPS`, after which nobody looks ahead."""


class EncounterPooling(nn.Module):
    """`sum_j a_ij exp(s_ij) m_ij / sum_j a_ij exp(s_ij)` over the others j.

    Messages m and scores s, one for each quarter of m, are a perceptron's of the pair; a_ij is
    alpha of the state that the pair was last observed in. Only ratios of alpha between neighbours
    count: a weighting that is the same for all of them is none, whatever its scale. Negative
    weights are 0.
    """

    hidden_dim: int
    bottleneck_dim: int
    """A multiple of 4: half of it are pushes, pairs of numbers."""

    def setup(self):
        """Declare the layer of a pair, and what it says.

        Raises:
            InputError: for a bottleneck that does not divide.
        """
        if self.bottleneck_dim % HEADS:
            raise InputError(f"encounter pooling: bottleneck_dim must be a multiple of {HEADS}")
        self.pair = Affine(FEATURES, self.hidden_dim)
        self.message = Affine(self.hidden_dim, self.bottleneck_dim)
        self.score = Affine(self.hidden_dim, HEADS)

    def __call__(self, hidden: Array, observed: Array, valid: Array, alpha: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`; 0 for who has no neighbour of a positive weight.

        Args:
            hidden: [N, H] encoder states, of which nothing is used.
            observed: [N, T, 2] metres.
            valid: [N] bool.
            alpha: [N, N, T] weight of j for i; the last step's is taken.
        """
        position, back = observed[:, -1], min(2, observed.shape[1] - 1)
        velocity = STEPS * (position - observed[:, -1 - back]) / max(back, 1)
        speed = _length(velocity)
        heading = velocity / jnp.hypot(speed, STEPS * SLOW)[:, None]

        there = _turned(position - position[:, None], heading[:, None], -1)
        motion = _turned(velocity - velocity[:, None], heading[:, None], -1)
        distance = _length(there)
        said = nn.relu(self.pair(_features(there, motion, distance, speed[:, None])))

        others = valid & ~jnp.eye(len(valid), dtype=bool)
        weight = jnp.where(others, jnp.maximum(alpha[..., -1], 0), 0)[..., None]
        score = self.score(said) - distance[..., None]
        # No more than 0, so that nothing overflows; a ratio does not change.
        most = jnp.where(weight > 0, score, -jnp.inf).max(axis=1, keepdims=True)
        score = jnp.minimum(score - lax.stop_gradient(jnp.where(weight > 0, most, 0)), 0)
        share = weight * jnp.exp(score)
        whole = share.sum(axis=1, keepdims=True)
        share = share / jnp.where(whole > 0, whole, 1)

        message = self.message(said).reshape(*share.shape, -1)
        pooled = (share[..., None] * message).sum(axis=1).reshape(len(valid), -1)
        pushes, numbers = jnp.split(pooled, 2, axis=-1)
        pushes = _turned(pushes.reshape(len(valid), -1, 2), heading[:, None], 1)
        return jnp.concatenate([pushes.reshape(numbers.shape), numbers], axis=-1)


def _features(there: Array, motion: Array, distance: Array, speed: Array) -> Array:
    """[N, N, 9] of pairs as i sees them, all within a few units.

    Where j is and how it moves `[N, N, 2]`, the `distance [N, N]`, i's own `speed [N, 1]`; and when
    the two would be nearest if both went on, and how near.
    """
    approach = -(there * motion).sum(axis=-1) / (jnp.square(motion).sum(axis=-1) + 0.04)
    soon = jnp.clip(approach, 0, LONGEST)
    miss = _length(there + motion * soon[..., None])
    bearing = there / jnp.maximum(distance, 1)[..., None]
    numbers = (
        jnp.exp(-distance),
        soon,
        jnp.exp(-2 * miss - soon),
        jnp.broadcast_to(speed, distance.shape),
        1 / (distance + 0.3),
    )
    return jnp.concatenate([bearing, motion, jnp.stack(numbers, axis=-1)], axis=-1)


def _turned(vector: Array, heading: Array, sign: int) -> Array:
    """`vector [..., 2]` turned by the angle of `heading [..., 2]`, or back by it."""
    (x, y), (cos, sin) = jnp.moveaxis(vector, -1, 0), jnp.moveaxis(heading, -1, 0)
    sin = sign * sin
    return jnp.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)


def _length(vector: Array) -> Array:
    """Of `vector [..., 2]`, with a gradient where it is 0."""
    return jnp.sqrt(jnp.square(vector).sum(axis=-1) + 1e-4)
