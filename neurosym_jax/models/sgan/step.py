"""One training step as a pure function `(state, batch, key) -> (state, metrics)`.

Gentle pooling keeps the units of SGAN's and NeuroSyM's poolings alive. Such a pooling
ends in a layer of 512 inputs, a maximum over neighbours and a ReLU. A unit that is
never above 0 has no gradient and stays so. The layer's first values are large
(positions are in metres), so a loss shuts units at once, and one Adam step of size r
moves a unit by up to 512 r times its inputs. So the layer starts small and above 0,
learns slowly, and a unit below 0 gets a share of the gradients that raise it
(`gradients.with_leak`). Forecasts of given parameters do not change.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.data.windows import Windows
from neurosym_jax.models.sgan.config import GeneratorConfig
from neurosym_jax.models.sgan.forecast import init_generator
from neurosym_jax.models.sgan.loss import (
    Scalars,
    discriminator_gradient,
    draw_group_noise,
    generator_gradient,
)
from neurosym_jax.models.sgan.network import Discriminator
from neurosym_jax.models.sgan.recipe import GeneratorRecipe
from neurosym_jax.training.batches import Groups, SceneStream, augment
from neurosym_jax.training.state import TrainState, new_state, optimizer_step, update

__all__ = ["Adversary", "generator_rounds", "init_adversary", "init_gentle_pooling"]
__all__ += ["init_state", "learn", "scale_pooling_updates", "train_step", "train_steps"]

SCALE, BIAS = 0.3, 0.5
"""Gentle pooling's factor of the initial weights of the last layer, and its initial biases."""
RATE = 0.05
"""Its factor of the learning rate of the pooling's parameters."""

Drawn = tuple[Groups, Sequence[Array]]
"""A batch, augmented, and noises for it."""


class Adversary(NamedTuple):
    """SGAN's discriminator in training."""

    params: Any
    optimizer: Any


def init_state(
    generator_config: GeneratorConfig, recipe: GeneratorRecipe, key: Array
) -> TrainState:
    """Parameters as SGAN initialises them, and new optimisers; consumes `key`."""
    generator_key, discriminator_key = jax.random.split(key)
    params = init_generator(generator_config, generator_key)
    if recipe.gentle_pooling:
        params = init_gentle_pooling(params)
    if not recipe.adversarial_weight:
        return new_state(recipe, params)
    network, observed = Discriminator(recipe.discriminator), jnp.zeros((1, 1, 2))
    discriminator = network.init(
        discriminator_key, observed, observed, jnp.ones(1, bool)
    )
    return new_state(recipe, params, init_adversary(recipe, discriminator))


def init_adversary(recipe: GeneratorRecipe, params: Any) -> Adversary:
    """The discriminator with these parameters, before its first step."""
    return Adversary(params, optax.adam(recipe.d_learning_rate).init(params))


def generator_rounds(
    config: GeneratorConfig, windows: Windows, recipe: GeneratorRecipe, key: Array
) -> Callable[..., tuple[TrainState, Scalars]]:
    """See `Forecaster.rounds`."""
    stream = SceneStream(windows, recipe.batch_scenes, recipe.seed, recipe.max_agents)
    # Each step of a network has a batch of its own.
    batches = 1 + recipe.discriminator_steps if recipe.adversarial_weight else 1
    recipe = dataclasses.replace(recipe, seed=0)  # Seeds share the compiled step.

    def advance(state: TrainState, done: int, count: int) -> tuple[TrainState, Scalars]:
        groups = jax.tree.map(
            lambda leaf: leaf.reshape(count, batches, *leaf.shape[1:]),
            stream.steps(done * batches, count * batches),
        )
        return train_steps(config, recipe, key, state, groups)

    return advance


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def train_steps(
    generator_config: GeneratorConfig,
    recipe: GeneratorRecipe,
    key: Array,
    state: TrainState,
    batches: Groups,
) -> tuple[TrainState, Scalars]:
    """One compiled call of many steps: the state after the last one, and metrics `[steps]`.

    `batches` are groups `[steps, batches, ...]`, see `train_step`; `key` is the run's,
    the same for all steps. The buffers of `state` are donated.
    """

    def step(state: TrainState, batches: Groups):
        # The key follows from the step, not from where the run was interrupted.
        key_of_step = jax.random.fold_in(key, state.step)
        return train_step(generator_config, recipe, state, batches, key_of_step)

    return jax.lax.scan(step, state, batches)


def train_step(
    generator_config: GeneratorConfig,
    recipe: GeneratorRecipe,
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
        groups = augment(
            jax.tree.map(lambda leaf: leaf[batch], batches), keys[0], recipe
        )
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
    recipe: GeneratorRecipe,
    state: TrainState,
    first: Drawn | None,
    second: Drawn,
    *,
    real: tuple[Array | float, Array | float],
    fake: Array | float,
) -> tuple[TrainState, Scalars, tuple[Any, Any]]:
    """An Adam step of the discriminator on `first`, if any, then of the generator on `second`.

    `real` are the two steps' labels [] of real trajectories, `fake` [] the
    discriminator's of forecasts. The last value are both gradients, not clipped.
    """
    discriminator_grads, metrics = (), {}
    if first is not None:
        state, metrics, discriminator_grads = learn_discriminator(
            generator_config, recipe, state, first, real[0], fake
        )
    discriminator = state.extra.params if state.extra else ()
    grads, terms = generator_gradient(
        generator_config, recipe, state.params, discriminator, *second, label=real[1]
    )
    scale = scale_pooling_updates if recipe.gentle_pooling else lambda moves: moves
    return (
        update(recipe, state, grads, scale),
        metrics | terms,
        (discriminator_grads, grads),
    )


def learn_discriminator(
    generator_config: GeneratorConfig,
    recipe: GeneratorRecipe,
    state: TrainState,
    batch: Drawn,
    label_real: Array | float,
    label_fake: Array | float,
) -> tuple[TrainState, Scalars, Any]:
    """An Adam step of the discriminator; the last value is its gradient."""
    params, optimizer = state.extra
    grads, metrics = discriminator_gradient(
        generator_config,
        recipe,
        state.params,
        params,
        *batch,
        label_real=label_real,
        label_fake=label_fake,
    )
    adam = optax.adam(recipe.d_learning_rate)
    moves, optimizer = optimizer_step(adam, grads, optimizer, params)
    adversary = Adversary(optax.apply_updates(params, moves), optimizer)
    return state._replace(extra=adversary), metrics, grads


def init_gentle_pooling(generator: Any) -> Any:
    """The variables `generator` with a small layer above 0 at the end of each pooling."""

    def start(pooling: Any) -> Any:
        layer = pooling["mlp"]["layer_1"]
        layer = {
            "kernel": SCALE * layer["kernel"],
            "bias": jnp.full_like(layer["bias"], BIAS),
        }
        return {**pooling, "mlp": {**pooling["mlp"], "layer_1": layer}}

    return _map_pooling_params(generator, start)


def scale_pooling_updates(update: Any) -> Any:
    """Adam's `update` of the generator with the poolings' part at their own learning rate."""
    return _map_pooling_params(
        update, lambda pooling: jax.tree.map(lambda leaf: RATE * leaf, pooling)
    )


def _map_pooling_params(tree: Any, change: Callable[[Any], Any]) -> Any:
    """`tree` with `change` of the parameters of each pooling that ends in such a layer."""
    if not isinstance(tree, dict):
        return tree
    return {
        name: change(part)
        if name == "pooling" and "layer_1" in part.get("mlp", ())
        else _map_pooling_params(part, change)
        for name, part in tree.items()
    }
