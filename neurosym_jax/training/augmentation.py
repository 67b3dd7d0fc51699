"""What is changed at random in the scenes of a training batch, anew each time they are drawn."""

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.config import TrainConfig
from neurosym_jax.scene import Scene
from neurosym_jax.training.groups import Groups, cuts

__all__ = ["augment"]


def augment(groups: Groups, key: Array, config: TrainConfig) -> Groups:
    """Scenes turned, mirrored, stretched and observed with errors, as `config` has it.

    Args:
        groups: the batch.
        key: consumed.
        config: its `rotate`, `scale` and `jitter`.
    """
    moving, erring = jax.random.split(key)
    if config.rotate or config.scale:
        groups = _moved(groups, moving, rotate=config.rotate, scale=config.scale)
    if config.jitter:
        groups = _jittered(groups, erring, config.jitter)
    return groups


def _moved(groups: Groups, key: Array, *, rotate: float, scale: float) -> Groups:
    """A share of the scenes turned, each by its own angle, and mirrored or not; all stretched."""
    counts = [scene.valid.shape[0] for scene in groups]
    choose, turn, flip, stretch = jax.random.split(key, 4)
    total = sum(counts)
    turned = jax.random.uniform(choose, (total,)) < rotate
    factor = jax.random.uniform(stretch, (total,), minval=1 - scale, maxval=1 + scale)
    angle = turned * jax.random.uniform(turn, (total,), maxval=2 * jnp.pi)
    sign = jnp.where(turned, jax.random.rademacher(flip, (total,)), 1)
    cos, sin = factor * jnp.cos(angle), factor * jnp.sin(angle)
    matrix = jnp.stack([cos, -sin * sign, sin, cos * sign], axis=-1).reshape(total, 2, 2)

    def moved(vectors: Array, matrix: Array) -> Array:
        return jnp.einsum("sab,sntb->snta", matrix, vectors)

    return tuple(
        scene.replace(
            observed=moved(scene.observed, part),
            displacement=moved(scene.displacement, part),
            future=moved(scene.future, part),
        )
        for scene, part in zip(groups, jnp.split(matrix, cuts(counts)))
    )


def _jittered(groups: Groups, key: Array, jitter: float) -> Groups:
    """Scenes whose observed positions have errors, in each scene of another size.

    The future is left as it is: what is to be forecast is where people were, and not the errors.
    """
    size, error = jax.random.split(key)
    sizes = [scene.observed.size for scene in groups]
    # One draw for all groups: each draw adds a second of compiling to the step.
    errors = jax.random.normal(error, (sum(sizes),))
    counts = [scene.valid.shape[0] for scene in groups]
    deviations = jax.random.uniform(size, (sum(counts), 1, 1, 1), maxval=jitter)

    def jittered(scene: Scene, errors: Array, deviation: Array) -> Scene:
        observed = scene.observed + deviation * errors.reshape(scene.observed.shape)
        first = jnp.zeros_like(observed[..., :1, :])
        displacement = jnp.concatenate([first, jnp.diff(observed, axis=-2)], axis=-2)
        return scene.replace(observed=observed, displacement=displacement)

    return tuple(
        jittered(*one)
        for one in zip(groups, jnp.split(errors, cuts(sizes)), jnp.split(deviations, cuts(counts)))
    )
