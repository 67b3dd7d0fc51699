"""The state of a training, and one update of a forecaster's parameters: clipping, Adam, average."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.training.recipe import Recipe

__all__ = ["TrainState", "clipping", "new_state", "update"]


class TrainState(NamedTuple):
    """The state of a training; a pytree of arrays."""

    step: Array
    """[] int32 steps done."""
    params: Any
    """Parameters of the forecaster."""
    optimizer: Any
    average: Any
    """Averaged parameters, () where the recipe averages none."""
    extra: Any = ()
    """What else a family trains, such as SGAN's discriminator."""


def new_state(recipe: Recipe, params: Any, extra: Any = ()) -> TrainState:
    """The state before the first step."""
    # A copy: the loop donates the state's buffers, each of them once.
    average = jax.tree.map(jnp.copy, params) if recipe.ema else ()
    optimizer = _optimizer(recipe).init(params)
    return TrainState(jnp.zeros((), jnp.int32), params, optimizer, average, extra)


def update(
    recipe: Recipe,
    state: TrainState,
    gradient: Any,
    scale: Callable[[Any], Any] = lambda moves: moves,
) -> TrainState:
    """The state after clipping the gradient and one Adam step of the forecaster.

    `scale` may change the step. The average has `ema` for its decay; early, it is over the last
    tenth of the steps.
    """
    moves, optimizer = _optimizer(recipe).update(gradient, state.optimizer, state.params)
    params: Any = optax.apply_updates(state.params, scale(moves))
    average = state.average
    if recipe.ema:
        decay = jnp.minimum(recipe.ema, (1.0 + state.step) / (10.0 + state.step))
        average = jax.tree.map(lambda a, p: decay * a + (1 - decay) * p, average, params)
    return state._replace(step=state.step + 1, params=params, optimizer=optimizer, average=average)


def clipping(recipe: Recipe) -> optax.GradientTransformation:
    """The first part of an update: gradients of at most the recipe's norm."""
    return optax.clip_by_global_norm(recipe.clip_norm) if recipe.clip_norm else optax.identity()


def _optimizer(recipe: Recipe) -> optax.GradientTransformation:
    rate: optax.ScalarOrSchedule = recipe.learning_rate
    if recipe.schedule == "cosine":
        warmup = min(recipe.warmup_steps, recipe.steps // 2)
        rate = optax.warmup_cosine_decay_schedule(0.0, recipe.learning_rate, warmup, recipe.steps)
    return optax.chain(clipping(recipe), optax.adam(rate))
