"""The losses of SGAN's and NeuroSyM's training: best of k forecasts, and the discriminator's."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.stream import Groups

__all__ = ["adversarial_loss", "criterion_errors", "displacements", "distance_errors"]
__all__ += ["safe_norm", "squared_displacement_errors", "variety_loss"]


def squared_displacement_errors(forecast: AnyArray, truth: AnyArray, valid: AnyArray) -> Array:
    """[1, k] square metres: SGAN's criterion of one scene, one value a sample.

    The squared error of the displacements `forecast` [k, N, pred_len, 2] from `truth` [N, pred_len,
    2], summed over agents, steps and coordinates, by the number of `valid` [N] agents and steps.
    """
    squared = jnp.where(valid[:, None, None], (forecast - truth) ** 2, 0).sum(axis=(1, 2, 3))
    return (squared / (jnp.maximum(valid.sum(), 1) * truth.shape[1]))[None]


def distance_errors(forecast: AnyArray, truth: AnyArray, valid: AnyArray) -> Array:
    """[2, k] metres: ADE and FDE of each sample of one scene, means over its `valid` [N] agents.

    `forecast` [k, N, pred_len, 2] and `truth` [N, pred_len, 2] are positions.
    """
    distance = jnp.where(valid[:, None], safe_norm(forecast - truth), 0)
    agents = jnp.maximum(valid.sum(), 1)
    ade = distance.mean(axis=-1).sum(axis=-1) / agents
    return jnp.stack([ade, distance[..., -1].sum(axis=-1) / agents])


def displacements(last: AnyArray, future: AnyArray) -> Array:
    """Displacements of `future [..., pred_len, 2]` that follows the position `last [..., 1, 2]`."""
    start = jnp.broadcast_to(last, (*future.shape[:-2], 1, 2))
    return jnp.diff(jnp.concatenate([start, future], axis=-2), axis=-2)


def safe_norm(vector: AnyArray) -> Array:
    """Euclidean norm over the last axis of `vector [..., D]`, its gradient zero at zero.

    NaN stays NaN; as zero it would be the best of all errors.
    """
    squared = (vector**2).sum(axis=-1)
    zero = squared == 0
    return jnp.where(zero, 0, jnp.sqrt(jnp.where(zero, 1, squared)))


def criterion_errors(recipe: TrainConfig, scenes: Scene, futures: Array) -> Array:
    """[scenes, C, k] of one group's `futures [k, scenes, slots, pred_len, 2]`.

    Each of the criterion's C rows has a best forecast of its own.
    """

    def of_scene(scene: Scene, future: Array) -> Array:
        if recipe.criterion == "distance":
            return distance_errors(future, scene.known_future, scene.valid)
        last = scene.observed[:, -1:]
        moves = displacements(last, future), displacements(last, scene.known_future)
        return squared_displacement_errors(*moves, scene.valid)

    return jax.vmap(of_scene, in_axes=(0, 1))(scenes, futures)


def variety_loss(recipe: TrainConfig, groups: Groups, futures: Sequence[Array]) -> Array:
    """[] the criterion of the best forecasts: SGAN's summed over scenes, distances' mean of people.

    `futures [C, scenes, slots, pred_len, 2]` of each group are the best by each row, in metres.
    """
    total = jnp.zeros(())
    for scene, future in zip(groups, futures):
        best = jnp.diagonal(criterion_errors(recipe, scene, future), axis1=1, axis2=2)
        people = scene.valid.sum(axis=1).astype(best.dtype)
        if recipe.criterion == "distance":
            total += ((best[:, 0] + recipe.fde_weight * best[:, 1]) * people).sum()
        else:
            total += (best[:, 0] * (people > 0)).sum()
    if recipe.criterion == "distance":
        total /= jnp.concatenate([scene.valid.sum(axis=1) for scene in groups]).sum()
    return total


def adversarial_loss(scores: Array, label: Array | float, valid: AnyArray) -> Array:
    """Binary cross-entropy of `scores [A]` (logits) with one smoothed label, mean over valid `[A]`.

    The stable form `max(s, 0) - s y + log(1 + exp(-|s|))`.
    """
    loss = jnp.maximum(scores, 0) - scores * label + jnp.log1p(jnp.exp(-jnp.abs(scores)))
    return jnp.where(valid, loss, 0).sum() / valid.sum()
