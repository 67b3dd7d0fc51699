"""Random changes to the scenes of a training batch, drawn each time a scene is used.

To add an augmentation: its function, an entry at the end of `AUGMENTATIONS`, and its options in
`AugmentationOptions`, which are fields of every recipe.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.configuration import AtLeastOne, BelowOne, NotNegative, Share
from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.training.groups import Groups, cuts

__all__ = ["AUGMENTATIONS", "AugmentationOptions", "augment"]


@dataclasses.dataclass(frozen=True)
class AugmentationOptions:
    """The options of a recipe's augmentations; 0 leaves one out."""

    rotate: bool | Share = 1.0
    """Probability that a training scene is rotated by a random angle, and then mirrored with
    probability 1/2; true is 1."""
    scale: BelowOne = 0.0
    """Each training scene is scaled by a random factor within 1 ± scale."""
    stretch: AtLeastOne = 1.0
    """In place of `scale`: the factor is log-uniform from 1 / stretch to stretch."""
    jitter: NotNegative = 0.0
    """Largest standard deviation of noise added to a scene's observed positions, m."""
    clean_share: BelowOne = 0.0
    """Probability that a training scene gets no such noise. Recordings differ in their noise."""
    single_agent_share: Share = 0.0
    """Probability that a training scene is reduced to one random person."""


def _move(groups: Groups, key: Array, options: AugmentationOptions) -> Groups:
    """Rotate and mirror a share of the scenes, each by its own angle; scale all."""
    rotate, scale = options.rotate, options.scale
    if not rotate and not scale and options.stretch == 1:
        return groups
    counts = [scene.valid.shape[0] for scene in groups]
    choose, turn, flip, stretch = jax.random.split(key, 4)
    total = sum(counts)
    turned = jax.random.uniform(choose, (total,)) < rotate
    factor = jax.random.uniform(stretch, (total,), minval=1 - scale, maxval=1 + scale)
    if options.stretch > 1:
        bound = math.log(options.stretch)
        factor = jnp.exp(jax.random.uniform(stretch, (total,), minval=-bound, maxval=bound))
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
    """Add noise to observed positions, of a size drawn for each scene; futures stay as they are."""
    if not options.jitter:
        return groups
    size, error = jax.random.split(key)
    sizes = [scene.observed.size for scene in groups]
    # One draw for all groups: each draw adds a second of compiling to the step.
    errors = jax.random.normal(error, (sum(sizes),))
    counts = [scene.valid.shape[0] for scene in groups]
    if clean := options.clean_share:
        shape = (sum(counts), 1, 1, 1)
        level = jax.random.uniform(size, shape, minval=-clean / (1 - clean))
        deviations = options.jitter * jnp.maximum(level, 0)
    else:
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


def _single_agents(groups: Groups, key: Array, options: AugmentationOptions) -> Groups:
    """Reduce some scenes to one person, because training windows hold two people or more."""
    if not options.single_agent_share:
        return groups
    choose, who = jax.random.split(key)
    counts = [scene.valid.shape[0] for scene in groups]
    sizes = [scene.valid.size for scene in groups]
    alone = jax.random.uniform(choose, (sum(counts),)) < options.single_agent_share
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


AUGMENTATIONS = (_move, _jitter, _single_agents)
"""`(groups, key, options) -> groups`, applied in this order; each consumes its key."""


def augment(groups: Groups, key: Array, options: AugmentationOptions) -> Groups:
    """Apply all augmentations that `options` ask for to a batch; consumes `key`."""
    # The first keys do not depend on how many there are: a new augmentation changes no old recipe.
    for augmentation, part in zip(AUGMENTATIONS, jax.random.split(key, len(AUGMENTATIONS))):
        groups = augmentation(groups, part, options)
    return groups
