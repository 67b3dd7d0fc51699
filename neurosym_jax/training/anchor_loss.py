"""The loss of forecasts with probabilities, of a batch in which scenes are merged into crowds.

The best of k joint forecasts of two people may be bold; that of forty must be near the mean. Small
recordings have few crowds, so several scenes of a batch are scored as one: their people do not see
each other, but are counted, and one sample must fit all of them.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.configuration import NotNegative, Positive

__all__ = ["AnchorLossOptions", "anchor_loss", "company"]


@dataclasses.dataclass(frozen=True)
class AnchorLossOptions:
    """Weights of the terms of the loss; errors are ADE + `fde_weight` FDE."""

    joint_weight: NotNegative = 1.0
    """Weight of the best sample of each crowd."""
    marginal_weight: NotNegative = 0.75
    """Weight of the best sample of each person."""
    fde_weight: NotNegative = 0.5
    """Weight of the FDE in an error."""
    mean_weight: NotNegative = 0.01
    """Weight of the mean ADE over samples, by which every sample learns."""
    likely_weight: NotNegative = 0.05
    """Weight of the most probable sample of each crowd."""
    probability_weight: NotNegative = 0.05
    """Weight of the cross-entropy between the probabilities and a softmax of the joint errors."""
    temperature: Positive = 0.1
    """Of that softmax, metres of error for a person."""


def company(valid: Array, crowd: Array) -> Array:
    """[B] number of people in the other scenes of each scene's crowd.

    Args:
        valid: [B, N] bool.
        crowd: [B] index of each scene's crowd, below B.
    """
    own = valid.sum(1)
    return (jax.ops.segment_sum(own, crowd, len(valid))[crowd] - own).astype(jnp.float32)


def anchor_loss(
    forecast: Array,
    log_probability: Array,
    future: Array,
    valid: Array,
    crowd: Array,
    options: AnchorLossOptions,
) -> Array:
    """[] loss of a batch, per person.

    Args:
        forecast: [B, k, N, T, 2] metres.
        log_probability: [B, k].
        future: [B, N, T, 2] metres.
        valid: [B, N] bool.
        crowd: [B] index of each scene's crowd, below B.
        options: weights of the terms.
    """

    def of_crowds(values: Array) -> Array:
        return jax.ops.segment_sum(values, crowd, len(valid))

    people = of_crowds(valid.sum(1))
    n = jnp.maximum(people, 1)
    square = jnp.square(forecast - future[:, None]).sum(-1)
    # Smooth at 0, where a sample meets the truth.
    distance = jnp.where(valid[:, None, :, None], jnp.sqrt(square + 1e-9), 0)
    ade = distance.mean(-1)
    error = ade + options.fde_weight * distance[..., -1]  # [B, k, N]
    joint = of_crowds(error.sum(2))  # [crowds, k]
    total = options.joint_weight * joint.min(1).sum()
    total += options.marginal_weight * error.min(1).sum()
    total += options.mean_weight * ade.mean(1).sum()

    log_probability = of_crowds(log_probability * valid.sum(1)[:, None]) / n[:, None]
    target = jax.lax.stop_gradient(jax.nn.softmax(-joint / n[:, None] / options.temperature))
    total -= options.probability_weight * ((target * log_probability).sum(1) * people).sum()
    likely = log_probability.argmax(1)[:, None]
    total += options.likely_weight * jnp.take_along_axis(joint, likely, 1).sum()
    return total / valid.sum()
