"""Scalars of SGAN's and NeuroSyM's training, and their gradients over one training batch.

The variety loss depends on the best of k samples only, and so does its gradient: all k
are decoded without a gradient, then the best (and the one that the discriminator
scores) again with one. Encoding and pooling are done once: pooling is mapped over each
group's scenes, encoder and decoder take all slots of all groups together.
"""

import functools
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from neurosym_jax.models.sgan.config import GeneratorConfig
from neurosym_jax.models.sgan.forecast import decode_scene, interact_scene
from neurosym_jax.models.sgan.network import Discriminator, Generator
from neurosym_jax.models.sgan.recipe import GeneratorRecipe
from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.symbolic.soft import safe_root
from neurosym_jax.training.batches import Groups, merge, split

__all__ = ["Scalars", "adversarial_loss", "decode_groups", "discriminator_gradient"]
__all__ += [
    "distance_errors",
    "draw_group_noise",
    "encode_groups",
    "generator_gradient",
]
__all__ += [
    "safe_norm",
    "squared_displacement_errors",
    "warn_if_no_gradient",
    "with_leak",
]

LEAK = 0.1
"""Gentle pooling's share of the gradients that raise a unit, where the unit is below 0."""
Scalars = dict[str, Array]
"""Losses and norms of gradients by name."""


def discriminator_gradient(
    generator_config: GeneratorConfig,
    recipe: GeneratorRecipe,
    generator: Any,
    discriminator: Any,
    groups: Groups,
    noises: Sequence[Array],
    *,
    label_real: Array | float,
    label_fake: Array | float,
) -> tuple[Any, Scalars]:
    """Gradient with respect to the parameters `discriminator`; `noises` [1, ...], one sample."""
    contexts = encode_groups(generator_config, generator, groups)
    fakes = decode_groups(generator_config, generator, contexts, groups, noises)
    valid = merge([scene.valid for scene in groups])

    # Real and fake trajectories as twice as many scenes, scored at once.
    twice = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), groups)
    futures = [
        jnp.concatenate([scene.known_future, fake[0]])
        for scene, fake in zip(groups, fakes)
    ]

    def loss(params: Any) -> Array:
        halves = [
            jnp.split(part, 2) for part in _scores(recipe, params, twice, futures)
        ]
        real, fake = map(merge, zip(*halves))
        return adversarial_loss(real, label_real, valid) + adversarial_loss(
            fake, label_fake, valid
        )

    value, gradient = jax.value_and_grad(loss)(discriminator)
    return gradient, {"d_loss": value}


def generator_gradient(
    generator_config: GeneratorConfig,
    recipe: GeneratorRecipe,
    generator: Any,
    discriminator: Any,
    groups: Groups,
    noises: Sequence[Array],
    *,
    label: Array | float,
) -> tuple[Any, Scalars]:
    """Gradient with respect to the parameters `generator`, not clipped, and the loss's terms.

    `noises` [k, ...] are those of k samples of each group, see `draw_group_noise`.
    Without adversarial term `discriminator` is (); with one, `label` is what the
    forecasts should get.
    """
    decode = functools.partial(decode_groups, generator_config)

    def loss(params: Any) -> tuple[Array, Scalars]:
        params = with_leak(params) if recipe.gentle_pooling else params
        contexts = encode_groups(generator_config, params, groups)
        trials = decode(*jax.lax.stop_gradient((params, contexts)), groups, noises)
        take = jax.vmap(
            lambda scene_noise, index: scene_noise[index], in_axes=(1, 0), out_axes=1
        )
        chosen = [
            take(noise, criterion_errors(recipe, scene, future).argmin(axis=-1))
            for noise, scene, future in zip(noises, groups, trials)
        ]
        best = len(chosen[0])
        if recipe.adversarial_weight:
            # The discriminator scores the last sample, as SGAN's generator step does.
            chosen = [
                jnp.concatenate([best_noise, noise[-1:]])
                for best_noise, noise in zip(chosen, noises)
            ]
        futures = decode(params, contexts, groups, chosen)
        variety = variety_loss(recipe, groups, [future[:best] for future in futures])
        terms, total = {"g_variety": variety}, recipe.variety_weight * variety
        if recipe.adversarial_weight:
            last = [future[-1] for future in futures]
            scores = merge(_scores(recipe, discriminator, groups, last))
            valid = merge([scene.valid for scene in groups])
            terms["g_adversarial"] = adversarial_loss(scores, label, valid)
            total += recipe.adversarial_weight * terms["g_adversarial"]
        return total, terms | {"g_loss": total}

    gradient, metrics = jax.grad(loss, has_aux=True)(generator)
    return gradient, metrics | {"g_gradient_norm": optax.tree.norm(gradient)}


def with_leak(generator: Any) -> Any:
    """The variables `generator` for a loss, see `models.pooling.bottleneck_relu`."""
    leak = {"pooling": {"leak": jnp.float32(LEAK)}}
    return {**generator, "training": {**leak, "decoder": leak}}


def squared_displacement_errors(
    forecast: AnyArray, truth: AnyArray, valid: AnyArray
) -> Array:
    """[1, k] square metres: SGAN's criterion of one scene, one value a sample.

    The squared error of the displacements `forecast` [k, N, pred_len, 2] from `truth`
    [N, pred_len, 2], summed over agents, steps and coordinates, by the number of
    `valid` [N] agents and steps.
    """
    squared = jnp.where(
        valid[None, :, None, None], (forecast - truth[None]) ** 2, 0
    ).sum(axis=(1, 2, 3))
    agents = jnp.maximum(valid.sum(dtype=squared.dtype), 1)
    return (squared / (agents * truth.shape[1]))[None]


def distance_errors(forecast: AnyArray, truth: AnyArray, valid: AnyArray) -> Array:
    """[2, k] metres: ADE and FDE of each sample of one scene, means over its `valid` [N] agents.

    `forecast` [k, N, pred_len, 2] and `truth` [N, pred_len, 2] are positions.
    """
    distance = jnp.where(valid[None, :, None], safe_norm(forecast - truth[None]), 0)
    agents = jnp.maximum(valid.sum(dtype=distance.dtype), 1)
    ade = distance.mean(axis=-1).sum(axis=-1) / agents
    return jnp.stack([ade, distance[..., -1].sum(axis=-1) / agents])


def steps_after(last: AnyArray, future: AnyArray) -> Array:
    """Displacements of `future [..., pred_len, 2]` after the position `last [..., 1, 2]`."""
    start = jnp.broadcast_to(last, (*future.shape[:-2], 1, 2))
    return jnp.diff(jnp.concatenate([start, future], axis=-2), axis=-2)


def safe_norm(vector: AnyArray) -> Array:
    """Euclidean norm over the last axis of `vector [..., D]`, its gradient zero at zero.

    NaN stays NaN; as zero it would be the best of all errors.
    """
    return safe_root((vector**2).sum(axis=-1))


def criterion_errors(recipe: GeneratorRecipe, scenes: Scene, futures: Array) -> Array:
    """[scenes, C, k] of one group's `futures [k, scenes, slots, pred_len, 2]`.

    Each of the criterion's C rows has a best forecast of its own.
    """

    def of_scene(scene: Scene, future: Array) -> Array:
        if recipe.criterion == "distance":
            return distance_errors(future, scene.known_future, scene.valid)
        last = scene.observed[:, -1:]
        moves = steps_after(last, future), steps_after(last, scene.known_future)
        return squared_displacement_errors(*moves, scene.valid)

    return jax.vmap(of_scene, in_axes=(0, 1))(scenes, futures)


def variety_loss(
    recipe: GeneratorRecipe, groups: Groups, futures: Sequence[Array]
) -> Array:
    """[] the criterion of the best forecasts: SGAN's summed over scenes, distances' mean of people.

    `futures [C, scenes, slots, pred_len, 2]` of each group are the best by each row, in
    metres.
    """
    total = jnp.zeros(())
    for scene, future in zip(groups, futures):
        best = jnp.diagonal(criterion_errors(recipe, scene, future), axis1=1, axis2=2)
        people = scene.valid.sum(axis=1).astype(best.dtype)
        if recipe.criterion == "distance":
            total += ((best[:, 0] + recipe.fde_weight * best[:, 1]) * people).sum()
        else:
            total += jnp.where(people > 0, best[:, 0], 0).sum()
    if recipe.criterion == "distance":
        sizes = [scene.valid.sum(axis=1) for scene in groups]
        total /= jnp.concatenate(sizes).sum(dtype=total.dtype)
    return total


def adversarial_loss(scores: Array, label: Array | float, valid: AnyArray) -> Array:
    """Binary cross-entropy of `scores [A]` (logits) with one smoothed label, mean over valid `[A]`.

    The stable form `max(s, 0) - s y + log(1 + exp(-|s|))`.
    """
    loss = (
        jnp.maximum(scores, 0) - scores * label + jnp.log1p(jnp.exp(-jnp.abs(scores)))
    )
    return jnp.where(valid, loss, 0).sum() / valid.sum(dtype=loss.dtype)


def warn_if_no_gradient(gradient: Any, by: str) -> None:
    """Print a warning if a gradient by weights, called `by`, is 0 in every entry."""
    if not any(np.any(leaf) for leaf in jax.tree.leaves(gradient)):
        dead = "is 0 in every entry: the network is dead to its neighbours"
        print(f"warning: the gradient by {by} {dead}", file=sys.stderr)


def draw_group_noise(
    config: GeneratorConfig, groups: Groups, key: Array, samples: int
) -> list[Array]:
    """Noise of each group [k, scenes, dim], per agent [k, scenes, slots, dim]; consumes `key`."""
    axes = 2 if config.noise.per_agent else 1
    shapes = [scene.valid.shape[:axes] for scene in groups]
    # One draw for all groups: each draw adds a second of compiling to the step.
    noise = config.noise.draw(
        key, (samples, sum(map(math.prod, shapes)), config.noise_dim)
    )
    return split(noise, shapes, axis=1)


def encode_groups(config: GeneratorConfig, params: Any, groups: Groups) -> list[Array]:
    """Contexts `[scenes, slots, C]` of each group."""
    observe = functools.partial(
        Generator(config).apply, params, method=Generator.observe
    )
    hidden = _over_slots(observe, [scene.displacement for scene in groups])
    interact = jax.vmap(
        lambda hidden, scene: interact_scene(config, params, hidden, scene)
    )
    groups = jax.tree.map(
        jnp.asarray, groups
    )  # `vmap` hands numpy on; pooling cannot take it.
    return [
        interact(part, scene.replace(future=None))
        for part, scene in zip(hidden, groups)
    ]


def decode_groups(
    config: GeneratorConfig,
    params: Any,
    contexts: Sequence[Array],
    groups: Groups,
    noises: Sequence[Array],
) -> list[Array]:
    """Futures `[k, scenes, slots, pred_len, 2]` of each group, metres relative to its origins."""
    futureless = [scene.replace(future=None) for scene in groups]
    decode = functools.partial(decode_scene, config, params)
    if config.pool_every_timestep:
        over_scenes = jax.vmap(decode, in_axes=(0, 0, 1), out_axes=1)
        return [over_scenes(*group) for group in zip(contexts, futureless, noises)]
    shapes = [scene.valid.shape for scene in groups]
    if config.noise_mix_type == "global":
        noises = [
            jnp.broadcast_to(noise[:, :, None], (len(noise), *shape, config.noise_dim))
            for noise, shape in zip(noises, shapes)
        ]
    slot_noises = [noise.reshape(len(noise), -1, config.noise_dim) for noise in noises]
    scene = jax.tree.map(lambda *parts: merge(parts), *futureless)
    futures = decode(merge(contexts), scene, jnp.concatenate(slot_noises, axis=1))
    return split(futures, shapes, axis=1)


def _over_slots(
    function: Callable[[Array], Any], parts: Sequence[AnyArray]
) -> list[Array]:
    """Apply `function`, of all slots together `[A, ...]`, to parts `[scenes, slots, ...]`."""
    return split(function(merge(parts)), [part.shape[:2] for part in parts])


def _scores(
    recipe: GeneratorRecipe, params: Any, groups: Groups, futures: Sequence[Array]
) -> list[Array]:
    """Discriminator scores `[scenes, slots]` of `futures [scenes, slots, pred_len, 2]`."""
    apply = functools.partial(Discriminator(recipe.discriminator).apply, params)
    moves = [
        jnp.concatenate(
            [scene.displacement, steps_after(scene.observed[:, :, -1:], future)], axis=2
        )
        for scene, future in zip(groups, futures)
    ]
    hidden = _over_slots(functools.partial(apply, method=Discriminator.observe), moves)
    score: Any = jax.vmap(functools.partial(apply, method=Discriminator.score))
    return [
        score(
            part,
            jnp.concatenate([scene.observed, future], axis=2),
            jnp.asarray(scene.valid),
        )
        for part, scene, future in zip(hidden, groups, futures)
    ]
