"""Losses of the GAN: the adversarial term, and the errors by which the best of k is chosen."""

import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import AnyArray

__all__ = ["adversarial_loss", "distance_errors", "safe_norm", "squared_displacement_errors"]


def adversarial_loss(scores: Array, label: Array | float, valid: Array) -> Array:
    """Binary cross-entropy of `scores [A]` (logits) with one smoothed label, mean over valid `[A]`.

    The stable form `max(s, 0) - s y + log(1 + exp(-|s|))`.
    """
    loss = jnp.maximum(scores, 0) - scores * label + jnp.log1p(jnp.exp(-jnp.abs(scores)))
    return jnp.where(valid, loss, 0).sum() / valid.sum()


def squared_displacement_errors(forecast: Array, truth: AnyArray, valid: AnyArray) -> Array:
    """SGAN's criterion of one scene: one value a sample, square metres.

    Args:
        forecast: [k, N, pred_len, 2] displacements in metres.
        truth: [N, pred_len, 2] displacements in metres.
        valid: [N] bool.

    Returns:
        [1, k]: squared error summed over agents, steps and coordinates, divided by the number of
        valid agents and steps.
    """
    squared = jnp.where(valid[:, None, None], (forecast - truth) ** 2, 0).sum(axis=(1, 2, 3))
    return (squared / (jnp.maximum(valid.sum(), 1) * truth.shape[1]))[None]


def distance_errors(forecast: Array, truth: AnyArray, valid: AnyArray) -> Array:
    """The test's own criteria of one scene: ADE and FDE of each sample, metres.

    Arguments as above, but positions. Returns [2, k], means over the scene's valid agents.
    """
    distance = jnp.where(valid[:, None], safe_norm(forecast - truth), 0)
    agents = jnp.maximum(valid.sum(), 1)
    ade = distance.mean(axis=-1).sum(axis=-1) / agents
    return jnp.stack([ade, distance[..., -1].sum(axis=-1) / agents])


def safe_norm(vector: Array) -> Array:
    """Euclidean norm over the last axis, with gradient zero where the vector is zero.

    NaN stays NaN: as a zero it would be the best of all errors.
    """
    squared = (vector**2).sum(axis=-1)
    zero = squared == 0
    return jnp.where(zero, 0, jnp.sqrt(jnp.where(zero, 1, squared)))
