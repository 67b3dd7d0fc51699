"""One training step as a pure function `(state, batch, key) -> (state, metrics)`.

The variety loss learns from the best of k samples alone, so its gradient needs only that one: all k
are decoded without a gradient, then the best (and the one that the discriminator judges) again
with one. Encoding and pooling are done once.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.config import GeneratorConfig, TrainConfig
from neurosym_jax.models import Discriminator, Generator
from neurosym_jax.scene import Scene
from neurosym_jax.training.losses import (
    adversarial_loss,
    distance_errors,
    squared_displacement_errors,
)
from neurosym_jax.training.rollout import (
    Groups,
    augment,
    decode_groups,
    draw_group_noise,
    encode_groups,
)

__all__ = [
    "TrainState",
    "discriminator_step",
    "generator_step",
    "initial_state",
    "train_step",
]

Metrics = dict[str, Array]


class TrainState(NamedTuple):
    """Everything that a step changes; a pytree of arrays."""

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
    generator_config: GeneratorConfig, config: TrainConfig, example: Scene, key: Array
) -> TrainState:
    """Parameters as SGAN initialises them, fresh optimisers; `example` is one scene."""
    of_generator, of_discriminator = jax.random.split(key)
    agents = example.valid.shape[0]
    observed = example.replace(future=None)
    generator = Generator(generator_config).init(
        of_generator,
        observed,
        jnp.zeros((agents, generator_config.noise_dim)),
        jnp.zeros((agents, agents, generator_config.obs_len)),
    )
    discriminator = ()
    if config.adversarial_weight:
        discriminator = Discriminator(config.discriminator).init(
            of_discriminator, example.observed, example.displacement, example.valid
        )
    return TrainState(
        step=jnp.zeros((), jnp.int32),
        generator=generator,
        generator_optimizer=_generator_optimizer(config).init(generator),
        average=generator if config.ema else (),
        discriminator=discriminator,
        discriminator_optimizer=(
            _discriminator_optimizer(config).init(discriminator) if discriminator else ()
        ),
    )


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
    keys = jax.random.split(key, 6)
    metrics: Metrics = {}
    of_generator = jax.tree.map(lambda leaf: leaf[-1], batches)
    if config.adversarial_weight:
        groups = jax.tree.map(lambda leaf: leaf[0], batches)
        groups = augment(groups, keys[0], rotate=config.rotate, scale=config.scale)
        state, metrics = discriminator_step(
            generator_config,
            config,
            state,
            groups,
            draw_group_noise(generator_config, groups, keys[1], 1),
            label_real=_label(keys[2], config.label_real),
            label_fake=_label(jax.random.fold_in(keys[2], 1), config.label_fake),
        )
    groups = augment(of_generator, keys[3], rotate=config.rotate, scale=config.scale)
    state, more = generator_step(
        generator_config,
        config,
        state,
        groups,
        draw_group_noise(generator_config, groups, keys[4], config.best_k),
        label=_label(keys[5], config.label_real),
    )
    return state, metrics | more


def discriminator_step(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    state: TrainState,
    groups: Groups,
    noises: Sequence[Array],
    *,
    label_real: Array | float,
    label_fake: Array | float,
) -> tuple[TrainState, Metrics]:
    """One Adam step of the discriminator; `noises` are of one sample."""
    contexts = encode_groups(generator_config, state.generator, groups)
    fakes = decode_groups(generator_config, state.generator, contexts, groups, noises)
    valid = _slots([scene.valid for scene in groups])

    def loss(params: Any) -> Array:
        real = _scores(config, params, groups, [scene.future for scene in groups])
        fake = _scores(config, params, groups, [future[0] for future in fakes])
        return adversarial_loss(real, label_real, valid) + adversarial_loss(fake, label_fake, valid)

    value, gradient = jax.value_and_grad(loss)(state.discriminator)
    update, optimizer = _discriminator_optimizer(config).update(
        gradient, state.discriminator_optimizer, state.discriminator
    )
    params = optax.apply_updates(state.discriminator, update)
    state = state._replace(discriminator=params, discriminator_optimizer=optimizer)
    return state, {"d_loss": value}


def generator_step(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    state: TrainState,
    groups: Groups,
    noises: Sequence[Array],
    *,
    label: Array | float,
) -> tuple[TrainState, Metrics]:
    """One Adam step of the generator; `noises` are of k samples."""
    criterion = functools.partial(_errors, config)

    def loss(params: Any) -> tuple[Array, Metrics]:
        contexts = encode_groups(generator_config, params, groups)
        decode = functools.partial(decode_groups, generator_config)
        trials = decode(*jax.lax.stop_gradient((params, contexts)), groups, noises)
        chosen = [
            _take_samples(noise, criterion(scene, future).argmin(axis=-1))
            for noise, scene, future in zip(noises, groups, trials)
        ]
        if config.adversarial_weight:
            # The discriminator judges the last sample, as SGAN's generator step does.
            chosen = [jnp.concatenate([some, all_[-1:]]) for some, all_ in zip(chosen, noises)]
        futures = decode(params, contexts, groups, chosen)
        total = variety = _variety_loss(config, criterion, groups, futures)
        metrics = {"g_variety": variety}
        total = config.l2_weight * variety
        if config.adversarial_weight:
            scores = _scores(
                config, state.discriminator, groups, [future[-1] for future in futures]
            )
            valid = _slots([scene.valid for scene in groups])
            metrics["g_adversarial"] = adversarial_loss(scores, label, valid)
            total = total + config.adversarial_weight * metrics["g_adversarial"]
        return total, metrics | {"g_loss": total}

    gradient, metrics = jax.grad(loss, has_aux=True)(state.generator)
    metrics["g_gradient_norm"] = optax.global_norm(gradient)
    update, optimizer = _generator_optimizer(config).update(
        gradient, state.generator_optimizer, state.generator
    )
    params = optax.apply_updates(state.generator, update)
    average = state.average
    if config.ema:
        # The early average follows the parameters closely: a tenth of the steps so far.
        decay = jnp.minimum(config.ema, (1.0 + state.step) / (10.0 + state.step))
        average = jax.tree.map(lambda a, p: decay * a + (1 - decay) * p, average, params)
    state = state._replace(
        step=state.step + 1, generator=params, generator_optimizer=optimizer, average=average
    )
    return state, metrics


def _errors(config: TrainConfig, scene: Scene, futures: Array) -> Array:
    """[scenes, criteria, k] of one group's `futures [k, scenes, slots, pred_len, 2]`."""
    if config.criterion == "distance":
        return jax.vmap(distance_errors, in_axes=(1, 0, 0))(futures, scene.future, scene.valid)
    last = scene.observed[:, :, -1:]
    return jax.vmap(squared_displacement_errors, in_axes=(1, 0, 0))(
        _steps(last, futures), _steps(last, scene.future), scene.valid
    )


def _steps(last: Array, future: Array) -> Array:
    """Displacements of `future [..., pred_len, 2]` after the position `last [..., 1, 2]`."""
    start = jnp.broadcast_to(last, (*future.shape[:-2], 1, 2))
    return jnp.diff(jnp.concatenate([start, future], axis=-2), axis=-2)


def _take_samples(noise: Array, best: Array) -> Array:
    """The samples `best [scenes, criteria]` of `noise [k, scenes, ...]`: [criteria, scenes, ...]."""
    return jax.vmap(lambda of_scene, index: of_scene[index], in_axes=(1, 0), out_axes=1)(
        noise, best
    )


def _variety_loss(config: TrainConfig, criterion, groups: Groups, futures: list[Array]) -> Array:
    """The loss of the chosen samples: sample c was the best by criterion c."""
    total, weight = jnp.zeros(()), jnp.zeros(())
    for scene, future in zip(groups, futures):
        errors = criterion(scene, future)
        count = errors.shape[1]
        best = jnp.diagonal(errors[:, :, :count], axis1=1, axis2=2)
        value = best[:, 0] + (config.fde_weight * best[:, 1] if count > 1 else 0.0)
        agents = scene.valid.sum(axis=1).astype(value.dtype)
        by_agents = config.weigh_scenes == "by_agents"
        share = agents if by_agents else (agents > 0).astype(value.dtype)
        total = total + (value * share).sum()
        weight = weight + share.sum()
    # SGAN's loss is a sum over scenes; a mean keeps `distance` in metres, whatever the batch.
    return total if config.criterion == "squared_displacement" else total / weight


def _scores(config: TrainConfig, params: Any, groups: Groups, futures: Sequence[Array]) -> Array:
    """Discriminator scores of all slots, `futures [scenes, slots, pred_len, 2]` of each group."""
    score = jax.vmap(
        lambda positions, displacement, valid: Discriminator(config.discriminator).apply(
            params, positions, displacement, valid
        )
    )
    scores = []
    for scene, future in zip(groups, futures):
        positions = jnp.concatenate([scene.observed, future], axis=2)
        moves = _steps(scene.observed[:, :, -1:], future)
        displacement = jnp.concatenate([scene.displacement, moves], axis=2)
        scores.append(score(positions, displacement, scene.valid))
    return _slots(scores)


def _slots(parts: Sequence[Array]) -> Array:
    """`[scenes, slots]` of each group as one `[A]`."""
    return jnp.concatenate([part.reshape(-1) for part in parts])


def _label(key: Array, between: tuple[float, float]) -> Array:
    return jax.random.uniform(key, (), minval=between[0], maxval=between[1])


def _generator_optimizer(config: TrainConfig) -> optax.GradientTransformation:
    rate: optax.ScalarOrSchedule = config.g_learning_rate
    if config.schedule == "cosine":
        rate = optax.warmup_cosine_decay_schedule(
            0.0, config.g_learning_rate, config.warmup_steps, config.steps
        )
    clip = optax.clip_by_global_norm(config.clip_norm) if config.clip_norm else optax.identity()
    return optax.chain(clip, optax.adam(rate))


def _discriminator_optimizer(config: TrainConfig) -> optax.GradientTransformation:
    return optax.adam(config.d_learning_rate)
