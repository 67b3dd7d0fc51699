"""What is changed at random in the scenes of a training batch, anew each time they are drawn.

To add an augmentation: its function, an entry at the end of `AUGMENTATIONS`, and its options in
`AugmentationOptions`, which are fields of every recipe.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.configuration import BelowOne, NotNegative, Share
from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.training.groups import Groups, cuts

__all__ = ["AUGMENTATIONS", "AugmentationOptions", "augment"]


@dataclasses.dataclass(frozen=True)
class AugmentationOptions:
    """What a recipe says of its augmentations; 0 leaves one out."""

    rotate: bool | Share = 1.0
    """Share of the training scenes turned at random, and half of them mirrored; true is 1."""
    scale: BelowOne = 0.0
    """Stretch each training scene by a random factor within 1 +- scale."""
    jitter: NotNegative = 0.0
    """Largest standard deviation, in metres, of errors added to a scene's observed positions."""
    alone: Share = 0.0
    """Share of the training scenes of which one person is kept, as if nobody else were there."""


def _move(groups: Groups, key: Array, options: AugmentationOptions) -> Groups:
    """A share of the scenes turned, each by its own angle, and mirrored or not; all stretched."""
    rotate, scale = options.rotate, options.scale
    if not rotate and not scale:
        return groups
    counts = [scene.valid.shape[0] for scene in groups]
    choose, turn, flip, stretch = jax.random.split(key, 4)
    total = sum(counts)
    turned = jax.random.uniform(choose, (total,)) < rotate
    factor = jax.random.uniform(stretch, (total,), minval=1 - scale, maxval=1 + scale)
    angle = turned * jax.random.uniform(turn, (total,), maxval=2 * jnp.pi)
    sign = jnp.where(turned, jax.random.rademacher(flip, (total,)), 1)
    cos, sin = factor * jnp.cos(angle), factor * jnp.sin(angle)
    matrix = jnp.stack([cos, -sin * sign, sin, cos * sign], axis=-1).reshape(total, 2, 2)

    def moved(vectors: AnyArray, matrix: Array) -> Array:
        return jnp.einsum("sab,sntb->snta", matrix, vectors)

    return tuple(
        scene.replace(
            observed=moved(scene.observed, part),
            displacement=moved(scene.displacement, part),
            future=moved(scene.known_future, part),
        )
        for scene, part in zip(groups, jnp.split(matrix, cuts(counts)))
    )


def _jitter(groups: Groups, key: Array, options: AugmentationOptions) -> Groups:
    """Scenes whose observed positions have errors, in each scene of another size.

    The future is left as it is: what is to be forecast is where people were, and not the errors.
    """
    if not options.jitter:
        return groups
    size, error = jax.random.split(key)
    sizes = [scene.observed.size for scene in groups]
    # One draw for all groups: each draw adds a second of compiling to the step.
    errors = jax.random.normal(error, (sum(sizes),))
    counts = [scene.valid.shape[0] for scene in groups]
    deviations = jax.random.uniform(size, (sum(counts), 1, 1, 1), maxval=options.jitter)

    def jittered(scene: Scene, errors: Array, deviation: Array) -> Scene:
        observed = scene.observed + deviation * errors.reshape(scene.observed.shape)
        first = jnp.zeros_like(observed[..., :1, :])
        displacement = jnp.concatenate([first, jnp.diff(observed, axis=-2)], axis=-2)
        return scene.replace(observed=observed, displacement=displacement)

    return tuple(
        jittered(*parts)
        for parts in zip(
            groups, jnp.split(errors, cuts(sizes)), jnp.split(deviations, cuts(counts))
        )
    )


def _alone(groups: Groups, key: Array, options: AugmentationOptions) -> Groups:
    """Scenes some of which are one person's: training windows hold two people or more."""
    if not options.alone:
        return groups
    choose, who = jax.random.split(key)
    counts = [scene.valid.shape[0] for scene in groups]
    sizes = [scene.valid.size for scene in groups]
    alone = jax.random.uniform(choose, (sum(counts),)) < options.alone
    lots = jax.random.uniform(who, (sum(sizes),))

    def left(scene: Scene, alone: Array, lots: Array) -> Scene:
        valid = jnp.asarray(scene.valid)
        lot = jnp.where(valid, lots.reshape(valid.shape), -1)
        drawn = jnp.arange(valid.shape[1]) == lot.argmax(axis=1)[:, None]
        return scene.replace(valid=valid & (drawn | ~alone[:, None]))

    return tuple(
        left(*parts)
        for parts in zip(groups, jnp.split(alone, cuts(counts)), jnp.split(lots, cuts(sizes)))
    )


AUGMENTATIONS = (_move, _jitter, _alone)
"""`(groups, key, options) -> groups`, applied in this order; the key is consumed."""


def augment(groups: Groups, key: Array, options: AugmentationOptions) -> Groups:
    """The batch `groups` with every augmentation that `options` ask for; consumes `key`."""
    # The first keys are the same however many there are, so one more changes no recipe without it.
    for augmentation, part in zip(AUGMENTATIONS, jax.random.split(key, len(AUGMENTATIONS))):
        groups = augmentation(groups, part, options)
    return groups
