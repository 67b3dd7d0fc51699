"""Gradients of the generator's and the discriminator's loss over one training batch.

The variety loss depends on the best of k samples only, and so does its gradient: all k are decoded
without a gradient, then the best (and the one that the discriminator scores) again with one.
Encoding and pooling are done once.
"""

import functools
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax
from jax import Array

from neurosym_jax.models import Discriminator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import AnyArray
from neurosym_jax.training.gentle_pooling import with_leak
from neurosym_jax.training.groups import Groups
from neurosym_jax.training.losses import (
    Forecasts,
    adversarial_loss,
    criterion_errors,
    displacements,
    generator_loss,
)
from neurosym_jax.training.recipe import TrainConfig
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
    """Gradient with respect to the parameters `discriminator`; `noises` [1, ...], one sample."""
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
        noises: for each group, [k, ...] of k samples, see `draw_group_noise`.
        label: the discriminator's label that the forecasts should get.

    Returns:
        The gradient, and `g_loss`, `g_gradient_norm` and each term of the loss (`g_variety`, ...).
    """
    decode = functools.partial(decode_groups, generator_config)

    def loss(params: Any) -> tuple[Array, Metrics]:
        params = with_leak(params) if config.gentle_pooling else params
        contexts = encode_groups(generator_config, params, groups)
        trials = decode(*jax.lax.stop_gradient((params, contexts)), groups, noises)
        chosen = [
            _take_samples(noise, criterion_errors(config, scene, future).argmin(axis=-1))
            for noise, scene, future in zip(noises, groups, trials)
        ]
        best, scores = len(chosen[0]), None
        if config.adversarial_weight:
            # The discriminator scores the last sample, as SGAN's generator step does.
            chosen = [jnp.concatenate([some, all_[-1:]]) for some, all_ in zip(chosen, noises)]
        futures = decode(params, contexts, groups, chosen)
        if config.adversarial_weight:
            last = [future[-1] for future in futures]
            scores = _slots(_scores(config, discriminator, groups, last))
        made = Forecasts(groups, [future[:best] for future in futures], scores, label)
        total, terms = generator_loss(config, made)
        return total, {f"g_{name}": value for name, value in terms.items()} | {"g_loss": total}

    gradient, metrics = jax.grad(loss, has_aux=True)(generator)
    return gradient, metrics | {"g_gradient_norm": optax.tree.norm(gradient)}


def _take_samples(noise: Array, best: Array) -> Array:
    """Samples `best [scenes, criteria]` of `noise [k, scenes, ...]`: [criteria, scenes, ...]."""
    return jax.vmap(lambda of_scene, index: of_scene[index], in_axes=(1, 0), out_axes=1)(
        noise, best
    )


def _scores(
    config: TrainConfig, params: Any, groups: Groups, futures: Sequence[Array]
) -> list[Array]:
    """Discriminator scores `[scenes, slots]` of `futures [scenes, slots, pred_len, 2]`."""
    apply = functools.partial(Discriminator(config.discriminator).apply, params)
    moves = [
        jnp.concatenate(
            [scene.displacement, displacements(scene.observed[:, :, -1:], future)], axis=2
        )
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
