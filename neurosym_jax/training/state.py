"""The state of a training, and one update of a forecaster's parameters: clipping, Adam, average."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.training.recipe import Recipe

__all__ = ["TrainState", "clipping", "is_frozen", "new_state", "optimizer_step"]
__all__ += ["update", "warmup_of"]


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

    Modules that the recipe freezes have no gradient. `scale` may change the step. The
    average has `ema` for its decay; early, it is over the last tenth of the steps.
    """
    if recipe.freeze:
        gradient = jax.tree_util.tree_map_with_path(
            lambda path, leaf: (
                jnp.zeros_like(leaf) if is_frozen(recipe, path) else leaf
            ),
            gradient,
        )
    moves, optimizer = optimizer_step(
        _optimizer(recipe), gradient, state.optimizer, state.params
    )
    params: Any = optax.apply_updates(state.params, scale(moves))
    average = state.average
    if recipe.ema:
        done = jnp.asarray(state.step, float)
        decay = jnp.minimum(recipe.ema, (1.0 + done) / (10.0 + done))

        def averaged(path: tuple[Any, ...], mean: Array, value: Array) -> Array:
            if is_frozen(recipe, path):  # The mean of equal numbers is rounded.
                return mean
            share = decay.astype(mean.dtype)
            return share * mean + (1 - share) * value

        average = jax.tree_util.tree_map_with_path(averaged, average, params)
    return state._replace(
        step=state.step + 1, params=params, optimizer=optimizer, average=average
    )


def optimizer_step(
    optimizer: optax.GradientTransformation, gradient: Any, state: Any, params: Any
) -> tuple[Any, Any]:
    """`optimizer.update`, which itself counts on promotions that JAX's strict mode refuses."""
    with jax.numpy_dtype_promotion("standard"):
        return optimizer.update(gradient, state, params)


def is_frozen(recipe: Recipe, path: tuple[Any, ...]) -> bool:
    """Whether a leaf of the parameters is in a module that the recipe freezes."""
    return any(getattr(entry, "key", None) in recipe.freeze for entry in path)


def clipping(recipe: Recipe) -> optax.GradientTransformation:
    """The first part of an update: gradients of at most the recipe's norm."""
    return (
        optax.clip_by_global_norm(recipe.clip_norm)
        if recipe.clip_norm
        else optax.identity()
    )


def warmup_of(recipe: Any) -> int:
    """Steps in which the learning rate rises, as they are done."""
    return (
        min(recipe.warmup_steps, recipe.steps // 2)
        if recipe.schedule == "cosine"
        else 0
    )


def _optimizer(recipe: Recipe) -> optax.GradientTransformation:
    rate: optax.ScalarOrSchedule = recipe.learning_rate
    if recipe.schedule == "cosine":
        rate = optax.warmup_cosine_decay_schedule(
            0.0, recipe.learning_rate, warmup_of(recipe), max(recipe.steps, 1)
        )
    return optax.chain(clipping(recipe), optax.adam(rate))
