"""Trainings of the study: `neurosym_jax.training`'s own steps, many in one process.

What a run of `neurosym train` does besides (validation, saved states, curves) is left out: the last
state is what is tested, so no arm is favoured by a choice of the best. Seeds of an arm share its
program, which a run of its own would trace for each.
"""

import dataclasses
from typing import Any

import jax

from neurosym_jax.data.windows import Windows
from neurosym_jax.forecasting.anchors import AnchorsForecaster
from neurosym_jax.training.anchors import AnchorStream, anchor_step
from neurosym_jax.training.recipe import AnchorRecipe, Recipe, TrainConfig
from neurosym_jax.training.run import ROUND
from neurosym_jax.training.step import initial_state, new_state, train_steps
from neurosym_jax.training.stream import SceneStream

__all__ = ["train"]


def train(network: Any, recipe: Recipe, windows: Windows, seed: int) -> Any:
    """Parameters after all steps of `recipe`, whose own seed does not matter.

    Args:
        network: configuration of a generator or of anchors.
        recipe: how it is trained; its `steps` are a multiple of 25.
        windows: what it learns from.
        seed: of initial values, batches, augmentation and noise; those of two arms are the same.
    """
    start, steps = (jax.random.fold_in(jax.random.key(seed), part) for part in (0, 1))
    shared = dataclasses.replace(recipe, seed=0)  # So that seeds share a program.
    if isinstance(shared, AnchorRecipe):
        anchors = AnchorStream(windows, dataclasses.replace(shared, seed=seed))
        state = new_state(shared, AnchorsForecaster(network).initial(start))
        for step in range(shared.steps):
            state, _ = anchor_step(network, shared, steps, state, *anchors.batch(step))
        return state.average
    assert isinstance(shared, TrainConfig)
    stream = SceneStream(windows, shared.batch_scenes, seed, shared.max_agents)
    state = initial_state(network, shared, start)
    for done in range(0, shared.steps, ROUND):
        groups = jax.tree.map(lambda leaf: leaf[:, None], stream.steps(done, ROUND))
        state, _ = train_steps(network, shared, steps, state, groups)
    return state.params
