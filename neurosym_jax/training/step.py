"""One training step as a pure function `(state, batch, key) -> (state, metrics)`.

Gentle pooling keeps the units of SGAN's and NeuroSyM's poolings alive. Such a pooling ends in a
layer of 512 inputs, a maximum over neighbours and a ReLU. A unit that is never above 0 has no
gradient and stays so. The layer's first values are large (positions are in metres), so a loss shuts
units at once, and one Adam step of size r moves a unit by up to 512 r times its inputs. So the
layer starts small and above 0, learns slowly, and a unit below 0 gets a share of the gradients that
raise it (`gradients.with_leak`). Forecasts of given parameters do not change.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.forecasting.forecasters import GeneratorForecaster
from neurosym_jax.models import Discriminator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.training.gradients import (
    Scalars,
    discriminator_gradient,
    draw_group_noise,
    generator_gradient,
)
from neurosym_jax.training.recipe import Recipe, TrainConfig
from neurosym_jax.training.stream import Groups, augment

__all__ = ["TrainState", "clipping", "initial_state", "learn", "new_state", "slowed", "started"]
__all__ += ["train_step", "train_steps", "update"]

SCALE, BIAS = 0.3, 0.5
"""Gentle pooling's factor of the initial weights of the last layer, and its initial biases."""
RATE = 0.05
"""Its factor of the learning rate of the pooling's parameters."""

Drawn = tuple[Groups, Sequence[Array]]
"""A batch, augmented, and noises for it."""


class TrainState(NamedTuple):
    """The state of a training; a pytree of arrays."""

    step: Array
    """[] int32 steps done."""
    params: Any
    """Parameters of the forecaster."""
    optimizer: Any
    average: Any
    """Averaged parameters, () where the recipe averages none."""
    discriminator: Any = ()
    """() where the recipe has no adversarial term."""
    discriminator_optimizer: Any = ()


def initial_state(generator_config: GeneratorConfig, recipe: TrainConfig, key: Array) -> TrainState:
    """Parameters as SGAN initialises them, and new optimisers; consumes `key`."""
    of_generator, of_discriminator = jax.random.split(key)
    params = GeneratorForecaster(generator_config).initial(of_generator)
    if recipe.gentle_pooling:
        params = started(params)
    if not recipe.adversarial_weight:
        return new_state(recipe, params)
    network, observed = Discriminator(recipe.discriminator), jnp.zeros((1, 1, 2))
    return new_state(
        recipe, params, network.init(of_discriminator, observed, observed, jnp.ones(1, bool))
    )


def new_state(recipe: Recipe, params: Any, discriminator: Any = ()) -> TrainState:
    """The state before the first step; `discriminator` has the parameters of one, if any."""
    # A copy: the loop donates the state's buffers, each of them once.
    average = jax.tree.map(jnp.copy, params) if recipe.ema else ()
    state = TrainState(jnp.zeros((), jnp.int32), params, _optimizer(recipe).init(params), average)
    if isinstance(recipe, TrainConfig) and discriminator:
        optimizer = optax.adam(recipe.d_learning_rate).init(discriminator)
        state = state._replace(discriminator=discriminator, discriminator_optimizer=optimizer)
    return state


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def train_steps(
    generator_config: GeneratorConfig,
    recipe: TrainConfig,
    key: Array,
    state: TrainState,
    batches: Groups,
) -> tuple[TrainState, Scalars]:
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
) -> tuple[TrainState, Scalars]:
    """Discriminator steps (where there is one), then a generator step, each on the next batch.

    `batches` are groups with a leading axis: a batch for each step. `key` is consumed.
    """
    earlier = recipe.discriminator_steps - 1 if recipe.adversarial_weight else 0
    keys = jax.random.split(key, 7 + 4 * earlier)

    def drawn(batch: int, keys: Array, samples: int) -> Drawn:
        groups = augment(jax.tree.map(lambda leaf: leaf[batch], batches), keys[0], recipe)
        return groups, draw_group_noise(generator_config, groups, keys[1], samples)

    def label(key: Array, between: tuple[float, float]) -> Array:
        return jax.random.uniform(key, (), minval=between[0], maxval=between[1])

    for batch, own in enumerate(keys[7:].reshape(earlier, 4)):
        labels = label(own[2], recipe.label_real), label(own[3], recipe.label_fake)
        state, *_ = learn_discriminator(
            generator_config, recipe, state, drawn(batch, own[:2], 1), *labels
        )
    state, metrics, _ = learn(
        generator_config,
        recipe,
        state,
        drawn(-2, keys[:2], 1) if recipe.adversarial_weight else None,
        drawn(-1, keys[3:5], recipe.best_k),
        real=(label(keys[2], recipe.label_real), label(keys[5], recipe.label_real)),
        fake=label(keys[6], recipe.label_fake),
    )
    return state, metrics


def learn(
    generator_config: GeneratorConfig,
    recipe: TrainConfig,
    state: TrainState,
    first: Drawn | None,
    second: Drawn,
    *,
    real: tuple[Array | float, Array | float],
    fake: Array | float,
) -> tuple[TrainState, Scalars, tuple[Any, Any]]:
    """An Adam step of the discriminator on `first`, if any, then of the generator on `second`.

    `real` are the two steps' labels [] of real trajectories, `fake` [] the discriminator's of
    forecasts.
    The last value are both gradients, not clipped.
    """
    of_discriminator, metrics = (), {}
    if first is not None:
        state, metrics, of_discriminator = learn_discriminator(
            generator_config, recipe, state, first, real[0], fake
        )
    gradient, more = generator_gradient(
        generator_config, recipe, state.params, state.discriminator, *second, label=real[1]
    )
    return update(recipe, state, gradient), metrics | more, (of_discriminator, gradient)


def learn_discriminator(
    generator_config: GeneratorConfig,
    recipe: TrainConfig,
    state: TrainState,
    batch: Drawn,
    label_real: Array | float,
    label_fake: Array | float,
) -> tuple[TrainState, Scalars, Any]:
    """An Adam step of the discriminator; the last value is its gradient."""
    gradient, metrics = discriminator_gradient(
        generator_config,
        recipe,
        state.params,
        state.discriminator,
        *batch,
        label_real=label_real,
        label_fake=label_fake,
    )
    moves, optimizer = optax.adam(recipe.d_learning_rate).update(
        gradient, state.discriminator_optimizer, state.discriminator
    )
    params = optax.apply_updates(state.discriminator, moves)
    state = state._replace(discriminator=params, discriminator_optimizer=optimizer)
    return state, metrics, gradient


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


def started(generator: Any) -> Any:
    """The variables `generator` with a small layer above 0 at the end of each pooling."""

    def start(pooling: Any) -> Any:
        layer = pooling["mlp"]["layer_1"]
        layer = {"kernel": SCALE * layer["kernel"], "bias": jnp.full_like(layer["bias"], BIAS)}
        return {**pooling, "mlp": {**pooling["mlp"], "layer_1": layer}}

    return _changed(generator, start)


def slowed(update: Any) -> Any:
    """Adam's `update` of the generator with the poolings' part at their own learning rate."""
    return _changed(update, lambda pooling: jax.tree.map(lambda leaf: RATE * leaf, pooling))


def _changed(tree: Any, change: Callable[[Any], Any]) -> Any:
    """`tree` with `change` of the parameters of each pooling that ends in such a layer."""
    if not isinstance(tree, dict):
        return tree
    return {
        name: change(part)
        if name == "pooling" and "layer_1" in part.get("mlp", ())
        else _changed(part, change)
        for name, part in tree.items()
    }


def clipping(recipe: Recipe) -> optax.GradientTransformation:
    """The first part of an update: gradients of at most the recipe's norm."""
    return optax.clip_by_global_norm(recipe.clip_norm) if recipe.clip_norm else optax.identity()


def _optimizer(recipe: Recipe) -> optax.GradientTransformation:
    rate: optax.ScalarOrSchedule = recipe.learning_rate
    if recipe.schedule == "cosine":
        warmup = min(recipe.warmup_steps, recipe.steps // 2)
        rate = optax.warmup_cosine_decay_schedule(0.0, recipe.learning_rate, warmup, recipe.steps)
    return optax.chain(clipping(recipe), optax.adam(rate))
