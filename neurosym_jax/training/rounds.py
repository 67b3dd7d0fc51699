"""Rounds of steps for each kind of forecaster. Everything random follows from (seed, step)."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.forecasting.anchors import initial_anchors
from neurosym_jax.runtime.process import COMPILED_QUICKLY
from neurosym_jax.training.anchors import AnchorStream, anchor_step
from neurosym_jax.training.recipe import AnchorRecipe
from neurosym_jax.training.run import Run
from neurosym_jax.training.step import TrainState, initial_state, new_state, train_steps
from neurosym_jax.training.stream import SceneStream

__all__ = ["ROUND", "Advance", "rounds_of", "start_of"]

ROUND = 25
"""Most steps between two updates of the progress bar."""

Advance = Callable[[TrainState, int, int], tuple[TrainState, Mapping[str, Any]]]
"""`(state, done, count) -> (state, metrics [count])`: `count` steps after `done` ones."""


def start_of(run: Run) -> TrainState:
    """The state before training."""
    network, recipe = run.network, run.recipe

    def start(key: Array) -> TrainState:
        if isinstance(recipe, AnchorRecipe):
            return new_state(recipe, initial_anchors(network, key))
        return initial_state(network, recipe, key)

    return jax.jit(start, compiler_options=COMPILED_QUICKLY)(_key(run, 0))


def rounds_of(run: Run) -> Advance:
    """The function that trains `run` by a round; it may reuse the buffers of the state."""
    network, recipe, key = run.network, run.recipe, _key(run, 1)
    if isinstance(recipe, AnchorRecipe):
        anchors = AnchorStream(run.training, recipe)

        def advance(state: TrainState, done: int, count: int):
            losses = []
            for step in range(done, done + count):
                state, loss = anchor_step(network, recipe, key, state, *anchors.batch(step))
                losses.append(loss)
            return state, {"loss": np.array(losses)}

        return advance
    stream = SceneStream(run.training, recipe.batch_scenes, recipe.seed, recipe.max_agents)
    each = 2 if recipe.adversarial_weight else 1  # Each network has a batch of its own.

    def advance_generator(state: TrainState, done: int, count: int):
        groups = jax.tree.map(
            lambda leaf: leaf.reshape(count, each, *leaf.shape[1:]),
            stream.steps(done * each, count * each),
        )
        return train_steps(network, recipe, key, state, groups)

    return advance_generator


def _key(run: Run, part: int) -> Array:
    return jax.random.fold_in(jax.random.key(run.recipe.seed), part)
