"""Random changes to the scenes of a training batch, drawn each time a scene is used.

To add an augmentation: its function, an entry at the end of `AUGMENTATIONS`, and its options in
`Recipe`.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.training.recipe import Recipe
from neurosym_jax.training.stream import Groups, split

__all__ = ["AUGMENTATIONS", "augment"]


def _move(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Rotate and mirror a share of the scenes, each by its own angle; scale all."""
    if not recipe.rotate and not recipe.scale and recipe.stretch == 1:
        return groups
    scenes = _counts(groups)
    choose, turn, flip, stretch = jax.random.split(key, 4)
    total = (sum(count for (count,) in scenes),)
    turned = jax.random.uniform(choose, total) < recipe.rotate
    if recipe.stretch > 1:
        bound = math.log(recipe.stretch)
        factor = jnp.exp(jax.random.uniform(stretch, total, minval=-bound, maxval=bound))
    else:
        scale = recipe.scale
        factor = jax.random.uniform(stretch, total, minval=1 - scale, maxval=1 + scale)
    angle = turned * jax.random.uniform(turn, total, maxval=2 * jnp.pi)
    sign = jnp.where(turned, jax.random.rademacher(flip, total), 1)
    cos, sin = factor * jnp.cos(angle), factor * jnp.sin(angle)
    matrix = jnp.stack([cos, -sin * sign, sin, cos * sign], axis=-1).reshape(*total, 2, 2)

    def moved(vectors: AnyArray, matrix: Array) -> Array:
        return jnp.einsum("sab,sntb->snta", matrix, vectors)

    return tuple(
        scene.replace(
            observed=moved(scene.observed, part),
            displacement=moved(scene.displacement, part),
            future=moved(scene.known_future, part),
        )
        for scene, part in zip(groups, split(matrix, scenes))
    )


def _jitter(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Add noise to observed positions, of a size drawn for each scene; futures stay as they are."""
    if not recipe.jitter:
        return groups
    size, error = jax.random.split(key)
    scenes, shapes = _counts(groups), [scene.observed.shape for scene in groups]
    # One draw for all groups: each draw adds a second of compiling to the step.
    errors = jax.random.normal(error, (sum(map(math.prod, shapes)),))
    per_scene = (sum(count for (count,) in scenes), 1, 1, 1)
    if clean := recipe.clean_share:
        level = jax.random.uniform(size, per_scene, minval=-clean / (1 - clean))
        deviations = recipe.jitter * jnp.maximum(level, 0)
    else:
        deviations = jax.random.uniform(size, per_scene, maxval=recipe.jitter)

    def jittered(scene: Scene, errors: Array, deviation: Array) -> Scene:
        observed = scene.observed + deviation * errors
        first = jnp.zeros_like(observed[..., :1, :])
        displacement = jnp.concatenate([first, jnp.diff(observed, axis=-2)], axis=-2)
        return scene.replace(observed=observed, displacement=displacement)

    return tuple(map(jittered, groups, split(errors, shapes), split(deviations, scenes)))


def _single_agents(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Reduce some scenes to one person, because training windows hold two people or more."""
    if not recipe.single_agent_share:
        return groups
    choose, who = jax.random.split(key)
    scenes, shapes = _counts(groups), [scene.valid.shape for scene in groups]
    total = (sum(count for (count,) in scenes),)
    alone = jax.random.uniform(choose, total) < recipe.single_agent_share
    lots = jax.random.uniform(who, (sum(map(math.prod, shapes)),))

    def left(scene: Scene, alone: Array, lots: Array) -> Scene:
        valid = jnp.asarray(scene.valid)
        lot = jnp.where(valid, lots, -1)
        drawn = jnp.arange(valid.shape[1]) == lot.argmax(axis=1)[:, None]
        return scene.replace(valid=valid & (drawn | ~alone[:, None]))

    return tuple(map(left, groups, split(alone, scenes), split(lots, shapes)))


def _counts(groups: Groups) -> list[tuple[int]]:
    return [(scene.valid.shape[0],) for scene in groups]


AUGMENTATIONS = (_move, _jitter, _single_agents)
"""`(groups, key, recipe) -> groups`, applied in this order; each consumes its key."""


def augment(groups: Groups, key: Array, recipe: Recipe) -> Groups:
    """Apply all augmentations that the recipe asks for to a batch; consumes `key`."""
    # The first keys do not depend on how many there are: a new augmentation changes no old recipe.
    for augmentation, part in zip(AUGMENTATIONS, jax.random.split(key, len(AUGMENTATIONS))):
        groups = augmentation(groups, part, recipe)
    return groups
