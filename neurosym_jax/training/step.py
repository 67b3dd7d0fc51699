"""One training step as a pure function `(state, batch, key) -> (state, metrics)`."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.forecasting.networks import initial_generator
from neurosym_jax.models import Discriminator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.symbolic.weighting import initial_parameters
from neurosym_jax.training.augmentation import augment
from neurosym_jax.training.gentle_pooling import slowed, started
from neurosym_jax.training.gradients import (
    Metrics,
    discriminator_gradient,
    draw_group_noise,
    generator_gradient,
)
from neurosym_jax.training.recipe import Recipe, TrainConfig
from neurosym_jax.training.stream import Groups

__all__ = ["TrainState", "clipping", "initial_state", "new_state", "train_step", "train_steps"]
__all__ += ["update", "update_discriminator"]


class TrainState(NamedTuple):
    """The state of a training; a pytree of arrays."""

    step: Array
    """[] int32 steps done."""
    params: Any
    """Of the forecaster."""
    optimizer: Any
    average: Any
    """Averaged parameters, () where the recipe averages none."""
    discriminator: Any = ()
    """() where the recipe has no adversarial term."""
    discriminator_optimizer: Any = ()


def initial_state(generator_config: GeneratorConfig, recipe: TrainConfig, key: Array) -> TrainState:
    """Parameters as SGAN initialises them, and new optimisers; consumes `key`."""
    of_generator, of_discriminator = jax.random.split(key)
    params = initial_generator(generator_config, of_generator)
    if weighting := initial_parameters(generator_config.weighting):
        params = {**params, "weighting": jax.tree.map(jnp.asarray, weighting)}
    if recipe.gentle_pooling:
        params = started(params)
    state = new_state(recipe, params)
    if not recipe.adversarial_weight:
        return state
    observed = jnp.zeros((1, generator_config.obs_len, 2))
    discriminator = Discriminator(recipe.discriminator).init(
        of_discriminator, observed, observed, jnp.ones(1, bool)
    )
    optimizer = optax.adam(recipe.d_learning_rate).init(discriminator)
    return state._replace(discriminator=discriminator, discriminator_optimizer=optimizer)


def new_state(recipe: Recipe, params: Any) -> TrainState:
    """The state before the first step, without discriminator."""
    # A copy: the loop donates the state's buffers, each of them once.
    average = jax.tree.map(jnp.copy, params) if recipe.ema else ()
    return TrainState(jnp.zeros((), jnp.int32), params, _optimizer(recipe).init(params), average)


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def train_steps(
    generator_config: GeneratorConfig,
    recipe: TrainConfig,
    key: Array,
    state: TrainState,
    batches: Groups,
) -> tuple[TrainState, Metrics]:
    """One compiled call of many steps: the state after the last one, and metrics `[steps]`.

    `batches` are groups `[steps, batches, ...]`, see `train_step`; `key` is the run's, the same for
    all steps. The buffers of `state` are donated.
    """

    def step(state: TrainState, batches: Groups):
        # The key follows from the step, not from where the run was interrupted.
        key_of_step = jax.random.fold_in(key, state.step)
        return train_step(generator_config, recipe, state, batches, key_of_step)

    return jax.lax.scan(step, state, batches)


def train_step(
    generator_config: GeneratorConfig,
    recipe: TrainConfig,
    state: TrainState,
    batches: Groups,
    key: Array,
) -> tuple[TrainState, Metrics]:
    """A discriminator step on one batch (where there is one), a generator step on the next.

    `batches` are groups with a leading axis of 2 batches, or of 1 without adversarial term. `key`
    is consumed.
    """
    keys = jax.random.split(key, 7)

    def drawn(batch: int, keys: Array, samples: int) -> tuple[Groups, list[Array]]:
        groups = augment(jax.tree.map(lambda leaf: leaf[batch], batches), keys[0], recipe)
        return groups, draw_group_noise(generator_config, groups, keys[1], samples)

    def label(key: Array, between: tuple[float, float]) -> Array:
        return jax.random.uniform(key, (), minval=between[0], maxval=between[1])

    metrics: Metrics = {}
    if recipe.adversarial_weight:
        gradient, metrics = discriminator_gradient(
            generator_config,
            recipe,
            state.params,
            state.discriminator,
            *drawn(0, keys[:2], 1),
            label_real=label(keys[2], recipe.label_real),
            label_fake=label(keys[6], recipe.label_fake),
        )
        state = update_discriminator(recipe, state, gradient)
    gradient, more = generator_gradient(
        generator_config,
        recipe,
        state.params,
        state.discriminator,
        *drawn(-1, keys[3:5], recipe.best_k),
        label=label(keys[5], recipe.label_real),
    )
    return update(recipe, state, gradient), metrics | more


def update_discriminator(recipe: TrainConfig, state: TrainState, gradient: Any) -> TrainState:
    """The state after one Adam step of the discriminator."""
    moves, optimizer = optax.adam(recipe.d_learning_rate).update(
        gradient, state.discriminator_optimizer, state.discriminator
    )
    params = optax.apply_updates(state.discriminator, moves)
    return state._replace(discriminator=params, discriminator_optimizer=optimizer)


def update(recipe: Recipe, state: TrainState, gradient: Any) -> TrainState:
    """The state after clipping the gradient and one Adam step of the forecaster.

    The average has `ema` for its decay; early, it is over the last tenth of the steps.
    """
    moves, optimizer = _optimizer(recipe).update(gradient, state.optimizer, state.params)
    if isinstance(recipe, TrainConfig) and recipe.gentle_pooling:
        moves = slowed(moves)
    params: Any = optax.apply_updates(state.params, moves)
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
