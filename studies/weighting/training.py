"""Trainings of the study: `neurosym_jax.training`'s own steps, many in one process.

What a run of `neurosym train` does besides (validation, saved states, curves) is left
out: the last state is what is tested, so no arm is favoured by a choice of the best.
Seeds of an arm share its program, which a run of its own would trace for each.
"""

import dataclasses
from typing import Any

import jax

from neurosym_jax.data.windows import Windows
from neurosym_jax.forecasting.forecaster import forecaster_of
from neurosym_jax.training.recipe import Recipe
from neurosym_jax.training.run import ROUND

__all__ = ["train"]


def train(network: Any, recipe: Recipe, windows: Windows, seed: int) -> Any:
    """Parameters after all steps of `recipe`, whose own seed does not matter.

    Args:
        network: configuration of a generator or of anchors.
        recipe: how it is trained; its `steps` are a multiple of 25.
        windows: what it learns from.
        seed: of initial values, batches, augmentation and noise; those of two arms are
            the same.
    """
    init_key, steps_key = (
        jax.random.fold_in(jax.random.key(seed), part) for part in (0, 1)
    )
    forecaster, recipe = forecaster_of(network), dataclasses.replace(recipe, seed=seed)
    state = forecaster.init_state(recipe, init_key)
    advance = forecaster.rounds(windows, recipe, steps_key)
    for done in range(0, recipe.steps, ROUND):
        state, _ = advance(state, done, ROUND)
    return state.average if recipe.ema else state.params
