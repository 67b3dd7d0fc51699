"""A generator over the groups of one training batch: futures of many scenes and samples at once.

A batch is a tuple of Scenes, one for each size class, `[scenes, slots, ...]`. Pooling is mapped
over each group's scenes; what looks at no neighbour takes all slots of all groups together.
"""

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.generator_forecaster import decode_scene, interact_scene
from neurosym_jax.models import Generator
from neurosym_jax.scene import Scene

__all__ = ["Groups", "augment", "decode_groups", "draw_group_noise", "encode_groups", "over_slots"]

Groups = tuple[Scene, ...]


def augment(groups: Groups, key: Array, *, rotate: bool, scale: float) -> Groups:
    """Each scene turned by its own angle, mirrored or not, and stretched; `key` is consumed."""
    if not rotate and not scale:
        return groups
    counts = [scene.valid.shape[0] for scene in groups]
    turn, flip, stretch = jax.random.split(key, 3)
    total = sum(counts)
    factor = jax.random.uniform(stretch, (total,), minval=1 - scale, maxval=1 + scale)
    angle = jax.random.uniform(turn, (total,), maxval=2 * jnp.pi * rotate)
    sign = jax.random.rademacher(flip, (total,), angle.dtype) if rotate else jnp.ones(total)
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
        for scene, part in zip(groups, jnp.split(matrix, _cuts(counts)))
    )


def draw_group_noise(
    config: GeneratorConfig, groups: Groups, key: Array, samples: int
) -> list[Array]:
    """For each group [k, scenes, dim], or [k, scenes, slots, dim] per agent; consumes `key`."""
    per_agent = config.noise_mix_type == "ped"
    shapes = [scene.valid.shape if per_agent else scene.valid.shape[:1] for scene in groups]
    sizes = [math.prod(shape) for shape in shapes]
    shape = (samples, sum(sizes), config.noise_dim)
    # One draw for all groups: each draw adds a second of compiling to the step.
    if config.noise_type == "gaussian":
        noise = jax.random.normal(key, shape)
    else:
        noise = jax.random.uniform(key, shape, minval=-1.0, maxval=1.0)
    return [
        part.reshape(samples, *shape, config.noise_dim)
        for part, shape in zip(jnp.split(noise, _cuts(sizes), axis=1), shapes)
    ]


def encode_groups(config: GeneratorConfig, params: Any, groups: Groups) -> list[Array]:
    """Contexts `[scenes, slots, C]` of each group."""
    observe = functools.partial(Generator(config).apply, params, method="observe")
    hidden = over_slots(observe, [scene.displacement for scene in groups])
    interact = jax.vmap(lambda hidden, scene: interact_scene(config, params, hidden, scene))
    groups = jax.tree.map(jnp.asarray, groups)  # `vmap` hands numpy on; pooling cannot take it.
    return [interact(part, scene.replace(future=None)) for part, scene in zip(hidden, groups)]


def over_slots(function: Callable[[Array], Any], parts: Sequence[Array]) -> list[Array]:
    """`function` of `[A, ...]`, all slots together, from and to `[scenes, slots, ...]` parts."""
    shapes = [part.shape[:2] for part in parts]
    out = function(jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts]))
    cuts = _cuts([math.prod(shape) for shape in shapes])
    return [
        part.reshape(*shape, *part.shape[1:]) for part, shape in zip(jnp.split(out, cuts), shapes)
    ]


def decode_groups(
    config: GeneratorConfig,
    params: Any,
    contexts: Sequence[Array],
    groups: Groups,
    noises: Sequence[Array],
) -> list[Array]:
    """Futures `[k, scenes, slots, pred_len, 2]` of each group, metres relative to its origins."""
    futureless = [scene.replace(future=None) for scene in groups]
    if config.pool_every_timestep:
        over_scenes = jax.vmap(
            lambda context, scene, noise: decode_scene(config, params, context, scene, noise),
            in_axes=(0, 0, 1),
            out_axes=1,
        )
        return [over_scenes(*group) for group in zip(contexts, futureless, noises)]
    shapes = [scene.valid.shape for scene in groups]
    samples = noises[0].shape[0]
    slots = [
        jnp.broadcast_to(
            noise if config.noise_mix_type == "ped" else noise[:, :, None],
            (samples, *shape, config.noise_dim),
        ).reshape(samples, math.prod(shape), config.noise_dim)
        for noise, shape in zip(noises, shapes)
    ]
    merged = jax.tree.map(
        lambda *parts: jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts]),
        *futureless,
    )
    context = jnp.concatenate([context.reshape(-1, context.shape[-1]) for context in contexts])
    noise = jnp.concatenate(slots, axis=1)
    future = decode_scene(config, params, context, merged, noise)
    cuts = _cuts([math.prod(shape) for shape in shapes])
    return [
        part.reshape(samples, *shape, *part.shape[2:])
        for part, shape in zip(jnp.split(future, cuts, axis=1), shapes)
    ]


def _cuts(sizes: Sequence[int]) -> list[int]:
    """Where `jnp.split` cuts an axis that holds parts of these sizes."""
    return list(itertools.accumulate(sizes))[:-1]
