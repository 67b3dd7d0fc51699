"""A generator applied to the groups of one training batch: many scenes and samples at once.

Pooling is mapped over each group's scenes; encoder and decoder take all slots of all groups
together.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.forecasting.networks import decode_scene, interact_scene
from neurosym_jax.models import Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import AnyArray
from neurosym_jax.training.stream import Groups, merge, split

__all__ = ["decode_groups", "draw_group_noise", "encode_groups", "over_slots"]


def draw_group_noise(
    config: GeneratorConfig, groups: Groups, key: Array, samples: int
) -> list[Array]:
    """Noise of each group [k, scenes, dim], per agent [k, scenes, slots, dim]; consumes `key`."""
    axes = 2 if config.noise_mix_type == "ped" else 1
    shapes = [scene.valid.shape[:axes] for scene in groups]
    shape = (samples, sum(map(math.prod, shapes)), config.noise_dim)
    # One draw for all groups: each draw adds a second of compiling to the step.
    if config.noise_type == "gaussian":
        noise = jax.random.normal(key, shape)
    else:
        noise = jax.random.uniform(key, shape, minval=-1.0, maxval=1.0)
    return split(noise, shapes, axis=1)


def encode_groups(config: GeneratorConfig, params: Any, groups: Groups) -> list[Array]:
    """Contexts `[scenes, slots, C]` of each group."""
    observe = functools.partial(Generator(config).apply, params, method=Generator.observe)
    hidden = over_slots(observe, [scene.displacement for scene in groups])
    interact = jax.vmap(lambda hidden, scene: interact_scene(config, params, hidden, scene))
    groups = jax.tree.map(jnp.asarray, groups)  # `vmap` hands numpy on; pooling cannot take it.
    return [interact(part, scene.replace(future=None)) for part, scene in zip(hidden, groups)]


def over_slots(function: Callable[[Array], Any], parts: Sequence[AnyArray]) -> list[Array]:
    """Apply `function`, of all slots together `[A, ...]`, to parts `[scenes, slots, ...]`."""
    return split(function(merge(parts)), [part.shape[:2] for part in parts])


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
            functools.partial(decode_scene, config, params), in_axes=(0, 0, 1), out_axes=1
        )
        return [over_scenes(*group) for group in zip(contexts, futureless, noises)]
    shapes = [scene.valid.shape for scene in groups]
    if config.noise_mix_type == "global":
        noises = [
            jnp.broadcast_to(noise[:, :, None], (len(noise), *shape, config.noise_dim))
            for noise, shape in zip(noises, shapes)
        ]
    of_slots = [noise.reshape(len(noise), -1, config.noise_dim) for noise in noises]
    scene = jax.tree.map(lambda *parts: merge(parts), *futureless)
    noise = jnp.concatenate(of_slots, axis=1)
    return split(decode_scene(config, params, merge(contexts), scene, noise), shapes, axis=1)
