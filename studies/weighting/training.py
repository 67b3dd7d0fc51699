"""Trainings of the study: `neurosym_jax.training`'s own steps, many in one process.

What a run of `neurosym train` does besides (validation, checkpoints, curves) is left out: the last
state is what is tested, so no arm is favoured by a choice of the best. Seeds of an arm share its
program, which a run of its own would trace for each.
"""

import dataclasses
from typing import Any

import jax

from neurosym_jax.data.windows import Windows
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.step import initial_state, train_steps
from neurosym_jax.training.stream import SceneStream

__all__ = ["train"]

CHUNK = 25
"""Steps of one compiled call."""


def train(generator: GeneratorConfig, recipe: TrainConfig, windows: Windows, seed: int) -> Any:
    """Parameters after all steps of `recipe`, whose own seed does not matter.

    Args:
        generator: the network.
        recipe: how it is trained; its `steps` are a multiple of 25.
        windows: what it learns from.
        seed: of initial values, batches, augmentation and noise; those of two arms are the same.
    """
    recipe = dataclasses.replace(recipe, seed=0)  # So that seeds share a program.
    stream = SceneStream(windows, recipe.batch_scenes, seed, recipe.max_agents)
    key = jax.random.key(seed)
    state = initial_state(generator, recipe, jax.random.fold_in(key, 0))
    of_steps = jax.random.fold_in(key, 1)
    for done in range(0, recipe.steps, CHUNK):
        groups = jax.tree.map(lambda leaf: leaf[:, None], stream.steps(done, CHUNK))
        state, _ = train_steps(generator, recipe, of_steps, state, groups)
    return state.params
