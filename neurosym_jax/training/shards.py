"""Data-parallel training: steps whose batches are divided into shards, which processes share.

A shard's gradient is a compiled call of its own, the same whichever process makes it, and the
shards' gradients are added up in their order. So what comes out depends on the number of shards and
not on the number of processes, where all run on the same versions, threads and instruction set.
"""

import functools

import jax
import numpy as np
import optax
from jax import Array
from jax.flatten_util import ravel_pytree

from neurosym_jax.config import GeneratorConfig, TrainConfig
from neurosym_jax.runtime.processes import gather, share
from neurosym_jax.training.gradients import Counts, Metrics
from neurosym_jax.training.groups import Groups
from neurosym_jax.training.step import (
    Part,
    TrainState,
    learn_to_forecast,
    learn_to_judge,
    split,
    update_discriminator,
    update_generator,
)

__all__ = ["advance_in_shards"]

_update_generator = jax.jit(update_generator, static_argnums=0)
_update_discriminator = jax.jit(update_discriminator, static_argnums=0)


def advance_in_shards(
    generator: GeneratorConfig, config: TrainConfig, key: Array, state: TrainState, groups: Groups
) -> tuple[TrainState, dict[str, np.ndarray]]:
    """One step for each of `groups [steps, batches, shards, ...]`; metrics `[steps]`.

    As `step.train_step` but for the shards. Every process is given all of them, and ends with the
    same state.
    """
    rows = []
    for number in range(len(groups[0].valid)):
        batches = jax.tree.map(lambda leaf, number=number: leaf[number], groups)
        keys = split(jax.random.fold_in(key, state.step))
        state, metrics = _step(generator, config, state, batches, keys)
        rows.append(metrics)
    return state, {name: np.stack([row[name] for row in rows]) for name in rows[0]}


def _step(
    generator: GeneratorConfig, config: TrainConfig, state: TrainState, batches: Groups, keys: Array
) -> tuple[TrainState, Metrics]:
    metrics: Metrics = {}
    if config.adversarial_weight:
        shards = jax.tree.map(lambda leaf: leaf[0], batches)
        gradient, metrics = _gradient(learn_to_judge, generator, config, state, shards, keys)
        state = _update_discriminator(config, state, gradient)
    shards = jax.tree.map(lambda leaf: leaf[-1], batches)
    gradient, more = _gradient(learn_to_forecast, generator, config, state, shards, keys)
    more["g_gradient_norm"] = optax.tree.norm(gradient)
    return _update_generator(config, state, gradient), metrics | more


def _gradient(learn, generator, config, state, shards: Groups, keys: Array):
    """The gradient and metrics of the whole batch `shards [shards, scenes, ...]`."""
    counts = Counts.of(shards)
    mine = []
    for _, shard in share(range(config.shards)):
        groups = jax.tree.map(lambda leaf, shard=shard: leaf[shard], shards)
        found = _learn(learn, generator, config, state, groups, keys, Part(shard, counts))
        vector, as_tree = ravel_pytree(found)
        mine.append(np.asarray(vector))
    return as_tree(gather(mine).sum(axis=0))


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _learn(learn, generator, config, state, groups, keys, part):
    return learn(generator, config, state, groups, keys, part)
