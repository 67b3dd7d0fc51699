"""One training step as a pure function `(state, batch, key) -> (state, metrics)`."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.core import Tracer

from neurosym_jax.models import Discriminator, Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.runtime.process import COMPILED_QUICKLY
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.weighting import initial_parameters
from neurosym_jax.training.augmentation import augment
from neurosym_jax.training.gentle_pooling import slowed, started
from neurosym_jax.training.gradients import (
    Metrics,
    discriminator_gradient,
    generator_gradient,
)
from neurosym_jax.training.groups import Groups
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.rollout import draw_group_noise

__all__ = [
    "TrainState",
    "averaged",
    "clip_gradient",
    "initial_state",
    "train_step",
    "train_steps",
    "update_discriminator",
    "update_generator",
]


class TrainState(NamedTuple):
    """The state of a training; a pytree of arrays."""

    step: Array
    """[] int32 generator steps done."""
    generator: Any
    generator_optimizer: Any
    average: Any
    """Averaged generator parameters, () where the recipe averages none."""
    discriminator: Any
    """() where the recipe has no adversarial term."""
    discriminator_optimizer: Any


def initial_state(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    example: Scene,
    key: Array,
    weighting: Any = None,
) -> TrainState:
    """Parameters as SGAN initialises them, and new optimisers.

    Args:
        generator_config: the generator.
        config: the recipe.
        example: one scene.
        key: consumed.
        weighting: parameters of the weighting; None for its initial ones.
    """
    of_generator, of_discriminator = jax.random.split(key)
    agents = example.valid.shape[0]
    observed = example.replace(future=None)
    noise = np.zeros((agents, generator_config.noise_dim), np.float32)
    alpha = np.zeros((agents, agents, generator_config.obs_len), np.float32)
    # A network that pools at predicted steps is initialised with weights of zero there.
    next_alpha = jax.tree_util.Partial(lambda *_: jnp.asarray(alpha))
    later = next_alpha if generator_config.symbolic else None
    generator = _initial(Generator(generator_config), of_generator, observed, noise, alpha, later)
    if weighting is None:
        weighting = initial_parameters(generator_config.weighting)
    if weighting:
        generator = {**generator, "weighting": jax.tree.map(jnp.asarray, weighting)}
    if config.gentle_pooling:
        generator = started(generator)
    discriminator = ()
    if config.adversarial_weight:
        discriminator = _initial(
            Discriminator(config.discriminator),
            *(of_discriminator, example.observed, example.displacement, example.valid),
        )
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        generator=generator,
        generator_optimizer=_compiled(_generator_optimizer(config).init, generator),
        # A copy: the loop donates the state's buffers, each of them once.
        average=_compiled(functools.partial(jax.tree.map, jnp.copy), generator)
        if config.ema
        else (),
        discriminator=discriminator,
        discriminator_optimizer=(
            _compiled(_discriminator_optimizer(config).init, discriminator) if discriminator else ()
        ),
    )


def _initial(network: Generator | Discriminator, key: Array, *inputs: Any) -> Any:
    """Parameters of `network` by one program, which depends on the shapes of `inputs` only."""

    def init(key: Array) -> Any:
        return network.init(key, *jax.tree.map(jnp.zeros_like, inputs))

    return _compiled(init, key)


def _compiled(make: Callable[[Any], Any], argument: Any) -> Any:
    """`make(argument)` by one program; otherwise JAX compiles each operation separately."""
    # Compiler options are refused within another program.
    alone = not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(argument))
    return jax.jit(make, compiler_options=COMPILED_QUICKLY if alone else None)(argument)


@functools.partial(jax.jit, static_argnums=(0, 1), donate_argnums=3)
def train_steps(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    key: Array,
    state: TrainState,
    batches: Groups,
) -> tuple[TrainState, Metrics]:
    """One compiled call of many steps.

    Args:
        generator_config: the generator.
        config: the recipe.
        key: of the run, the same for all steps and not consumed.
        state: before the first step; its buffers are donated.
        batches: groups `[steps, batches, ...]`, see `train_step` for the batches of a step.

    Returns:
        The state after the last step, and metrics `[steps]`.
    """

    def step(state: TrainState, batches: Groups):
        # The key follows from the step, not from where the run was interrupted.
        key_of_step = jax.random.fold_in(key, state.step)
        return train_step(generator_config, config, state, batches, key_of_step)

    return jax.lax.scan(step, state, batches)


def train_step(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    state: TrainState,
    batches: Groups,
    key: Array,
) -> tuple[TrainState, Metrics]:
    """A discriminator step on one batch (where there is one), a generator step on the next.

    Args:
        generator_config: the generator.
        config: the recipe.
        state: before the step.
        batches: groups with a leading axis of 2 batches, or of 1 without adversarial term.
        key: consumed.
    """
    keys = jax.random.split(key, 7)
    metrics: Metrics = {}
    if config.adversarial_weight:
        groups = jax.tree.map(lambda leaf: leaf[0], batches)
        groups, noises = _drawn(generator_config, config, groups, keys[:2], 1)
        gradient, metrics = discriminator_gradient(
            generator_config,
            config,
            state.generator,
            state.discriminator,
            groups,
            noises,
            label_real=_label(keys[2], config.label_real),
            label_fake=_label(keys[6], config.label_fake),
        )
        state = update_discriminator(config, state, gradient)
    groups = jax.tree.map(lambda leaf: leaf[-1], batches)
    groups, noises = _drawn(generator_config, config, groups, keys[3:5], config.best_k)
    gradient, more = generator_gradient(
        generator_config,
        config,
        state.generator,
        state.discriminator,
        groups,
        noises,
        label=_label(keys[5], config.label_real),
    )
    return update_generator(config, state, gradient), metrics | more


def _drawn(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    groups: Groups,
    keys: Array,
    samples: int,
) -> tuple[Groups, list[Array]]:
    """The augmented groups of a batch, and the noise of k samples."""
    groups = augment(groups, keys[0], config)
    return groups, draw_group_noise(generator_config, groups, keys[1], samples)


def update_discriminator(config: TrainConfig, state: TrainState, gradient: Any) -> TrainState:
    """The state after one Adam step of the discriminator."""
    update, optimizer = _discriminator_optimizer(config).update(
        gradient, state.discriminator_optimizer, state.discriminator
    )
    params = optax.apply_updates(state.discriminator, update)
    return state._replace(discriminator=params, discriminator_optimizer=optimizer)


def update_generator(config: TrainConfig, state: TrainState, gradient: Any) -> TrainState:
    """The state after clipping the gradient and one Adam step of the generator."""
    update, optimizer = _generator_optimizer(config).update(
        gradient, state.generator_optimizer, state.generator
    )
    if config.gentle_pooling:
        update = slowed(update)
    params = optax.apply_updates(state.generator, update)
    average = averaged(config.ema, state.step, state.average, params) if config.ema else ()
    return state._replace(
        step=state.step + 1, generator=params, generator_optimizer=optimizer, average=average
    )


def averaged(ema: float, step: Array, average: Any, params: Any) -> Any:
    """The moving average after `step` [] steps; early, it is over the last tenth of the steps."""
    decay = jnp.minimum(ema, (1.0 + step) / (10.0 + step))
    return jax.tree.map(lambda a, p: decay * a + (1 - decay) * p, average, params)


def clip_gradient(config: TrainConfig, gradient: Any) -> Any:
    """The clipped gradient of the generator."""
    clipping = _clipping(config)
    return clipping.update(gradient, clipping.init(gradient))[0]


def _label(key: Array, between: tuple[float, float]) -> Array:
    return jax.random.uniform(key, (), minval=between[0], maxval=between[1])


def _clipping(config: TrainConfig) -> optax.GradientTransformation:
    return optax.clip_by_global_norm(config.clip_norm) if config.clip_norm else optax.identity()


def _generator_optimizer(config: TrainConfig) -> optax.GradientTransformation:
    rate: optax.ScalarOrSchedule = config.g_learning_rate
    if config.schedule == "cosine":
        warmup = min(config.warmup_steps, config.steps // 2)
        rate = optax.warmup_cosine_decay_schedule(0.0, config.g_learning_rate, warmup, config.steps)
    return optax.chain(_clipping(config), optax.adam(rate))


def _discriminator_optimizer(config: TrainConfig) -> optax.GradientTransformation:
    return optax.adam(config.d_learning_rate)
