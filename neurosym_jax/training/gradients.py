"""Gradients of the generator's and the discriminator's loss over one training batch.

The variety loss learns from the best of k samples alone, so its gradient needs only that one: all k
are decoded without a gradient, then the best (and the one that the discriminator scores) again
with one. Encoding and pooling are done once. Nothing here knows of optimisers or of steps.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.config import GeneratorConfig, TrainConfig
from neurosym_jax.models import Discriminator
from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.training.groups import Groups
from neurosym_jax.training.losses import (
    adversarial_loss,
    distance_errors,
    squared_displacement_errors,
)
from neurosym_jax.training.rollout import decode_groups, encode_groups, over_slots

__all__ = ["Metrics", "discriminator_gradient", "generator_gradient"]

Metrics = dict[str, Array]
"""Scalars by name."""


def discriminator_gradient(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    generator: Any,
    discriminator: Any,
    groups: Groups,
    noises: Sequence[Array],
    *,
    label_real: Array | float,
    label_fake: Array | float,
) -> tuple[Any, Metrics]:
    """Gradient with respect to the parameters `discriminator`; `noises` are of one sample."""
    contexts = encode_groups(generator_config, generator, groups)
    fakes = decode_groups(generator_config, generator, contexts, groups, noises)
    valid = _slots([scene.valid for scene in groups])

    # Real and fake trajectories as twice as many scenes, scored at once.
    twice = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), groups)
    futures = [jnp.concatenate([scene.known_future, fake[0]]) for scene, fake in zip(groups, fakes)]

    def loss(params: Any) -> Array:
        halves = [jnp.split(part, 2) for part in _scores(config, params, twice, futures)]
        real, fake = (_slots(half) for half in zip(*halves))
        return adversarial_loss(real, label_real, valid) + adversarial_loss(fake, label_fake, valid)

    value, gradient = jax.value_and_grad(loss)(discriminator)
    return gradient, {"d_loss": value}


def generator_gradient(
    generator_config: GeneratorConfig,
    config: TrainConfig,
    generator: Any,
    discriminator: Any,
    groups: Groups,
    noises: Sequence[Array],
    *,
    label: Array | float,
) -> tuple[Any, Metrics]:
    """Gradient with respect to the parameters `generator`, not clipped.

    Args:
        generator_config: the generator.
        config: the recipe.
        generator: its parameters.
        discriminator: its parameters; () where the recipe has no adversarial term.
        groups: the batch.
        noises: for each group, of k samples.
        label: what the discriminator is to take the forecasts for.

    Returns:
        The gradient, and `g_variety`, `g_loss`, `g_gradient_norm` and, with an adversarial term,
        `g_adversarial`.
    """
    criterion = functools.partial(_errors, config)
    decode = functools.partial(decode_groups, generator_config)

    def loss(params: Any) -> tuple[Array, Metrics]:
        contexts = encode_groups(generator_config, params, groups)
        trials = decode(*jax.lax.stop_gradient((params, contexts)), groups, noises)
        chosen = [
            _take_samples(noise, criterion(scene, future).argmin(axis=-1))
            for noise, scene, future in zip(noises, groups, trials)
        ]
        if config.adversarial_weight:
            # The discriminator scores the last sample, as SGAN's generator step does.
            chosen = [jnp.concatenate([some, all_[-1:]]) for some, all_ in zip(chosen, noises)]
        futures = decode(params, contexts, groups, chosen)
        variety = _variety_loss(config, criterion, groups, futures)
        metrics = {"g_variety": variety}
        total = config.l2_weight * variety
        if config.adversarial_weight:
            last = [future[-1] for future in futures]
            scores = _slots(_scores(config, discriminator, groups, last))
            valid = _slots([scene.valid for scene in groups])
            metrics["g_adversarial"] = adversarial_loss(scores, label, valid)
            total = total + config.adversarial_weight * metrics["g_adversarial"]
        return total, metrics | {"g_loss": total}

    gradient, metrics = jax.grad(loss, has_aux=True)(generator)
    return gradient, metrics | {"g_gradient_norm": optax.tree.norm(gradient)}


def _errors(config: TrainConfig, scene: Scene, futures: Array) -> Array:
    """[scenes, criteria, k] of one group's `futures [k, scenes, slots, pred_len, 2]`."""
    truth, last = scene.known_future, scene.observed[:, :, -1:]
    if config.criterion == "distance":
        return jax.vmap(distance_errors, in_axes=(1, 0, 0))(futures, truth, scene.valid)
    return jax.vmap(squared_displacement_errors, in_axes=(1, 0, 0))(
        _steps(last, futures), _steps(last, truth), scene.valid
    )


def _steps(last: AnyArray, future: AnyArray) -> Array:
    """Displacements of `future [..., pred_len, 2]` after the position `last [..., 1, 2]`."""
    start = jnp.broadcast_to(last, (*future.shape[:-2], 1, 2))
    return jnp.diff(jnp.concatenate([start, future], axis=-2), axis=-2)


def _take_samples(noise: Array, best: Array) -> Array:
    """Samples `best [scenes, criteria]` of `noise [k, scenes, ...]`: [criteria, scenes, ...]."""
    return jax.vmap(lambda of_scene, index: of_scene[index], in_axes=(1, 0), out_axes=1)(
        noise, best
    )


def _variety_loss(config: TrainConfig, criterion, groups: Groups, futures: list[Array]) -> Array:
    """The loss of the chosen samples: sample c was the best by criterion c."""
    total = jnp.zeros(())
    by_agents = config.weigh_scenes == "by_agents"
    for scene, future in zip(groups, futures):
        errors = criterion(scene, future)
        count = errors.shape[1]
        best = jnp.diagonal(errors[:, :, :count], axis1=1, axis2=2)
        value = best[:, 0] + (config.fde_weight * best[:, 1] if count > 1 else 0.0)
        agents = scene.valid.sum(axis=1).astype(value.dtype)
        share = agents if by_agents else (agents > 0).astype(value.dtype)
        total = total + (value * share).sum()
    # SGAN's loss is a sum over scenes; a mean keeps `distance` in metres, whatever the batch.
    if config.criterion == "squared_displacement":
        return total
    sizes = jnp.concatenate([scene.valid.sum(axis=1) for scene in groups])
    return total / (sizes.sum() if by_agents else (sizes > 0).sum())


def _scores(
    config: TrainConfig, params: Any, groups: Groups, futures: Sequence[Array]
) -> list[Array]:
    """Discriminator scores `[scenes, slots]` of `futures [scenes, slots, pred_len, 2]`."""
    apply = functools.partial(Discriminator(config.discriminator).apply, params)
    moves = [
        jnp.concatenate([scene.displacement, _steps(scene.observed[:, :, -1:], future)], axis=2)
        for scene, future in zip(groups, futures)
    ]
    hidden = over_slots(functools.partial(apply, method=Discriminator.observe), moves)
    score: Any = jax.vmap(functools.partial(apply, method=Discriminator.score))
    return [
        score(part, jnp.concatenate([scene.observed, future], axis=2), jnp.asarray(scene.valid))
        for part, scene, future in zip(hidden, groups, futures)
    ]


def _slots(parts: Sequence[AnyArray]) -> Array:
    """`[scenes, slots]` of each group as one `[A]`."""
    return jnp.concatenate([part.reshape(-1) for part in parts])
