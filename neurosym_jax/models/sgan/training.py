"""Training of SGAN and NeuroSyM: recipes, losses, and a step of both networks."""

import dataclasses
import functools
import math
import sys
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from neurosym_jax.configuration import Count, Interval, NotNegative, Positive
from neurosym_jax.data.windows import Windows
from neurosym_jax.models.sgan.network import (
    Discriminator,
    DiscriminatorConfig,
    Generator,
    GeneratorConfig,
    decode_scene,
    init_generator,
    interact_scene,
)
from neurosym_jax.runtime.programs import full_precision, program
from neurosym_jax.scene import AnyArray, Scene
from neurosym_jax.symbolic.soft import safe_root
from neurosym_jax.training.batches import Groups, SceneStream, augment, merge, split
from neurosym_jax.training.recipe import Recipe
from neurosym_jax.training.state import TrainState, new_state, optimizer_step, update

__all__ = [
    "RECIPES",
    "Adversary",
    "GeneratorRecipe",
    "Scalars",
    "adversarial_loss",
    "batch_loss",
    "decode_groups",
    "discriminator_gradient",
    "distance_errors",
    "draw_batch",
    "draw_group_noise",
    "encode_groups",
    "generator_gradient",
    "generator_loss",
    "generator_rounds",
    "init_adversary",
    "init_gentle_pooling",
    "init_state",
    "learn",
    "safe_norm",
    "scale_pooling_updates",
    "squared_displacement_errors",
    "train_step",
    "train_steps",
    "warn_if_no_gradient",
    "with_leak",
]


# Recipes of SGAN and NeuroSyM: `ours` (docs/training.md), and `sgan`, the published
# procedure.


@dataclasses.dataclass(frozen=True)
class GeneratorRecipe(Recipe):
    """A recipe of SGAN and NeuroSyM."""

    max_agents: Count | None = 16
    """Larger scenes are cropped to a random agent and its nearest neighbours, drawn each time."""
    best_k: Count = 20
    """Samples of the variety loss, which learns from the best one."""
    variety_weight: NotNegative = 1.0
    """Weight of the variety loss; 0 leaves the adversarial loss only."""
    criterion: Literal["squared_displacement", "distance"] = "distance"
    """The variety loss and what is best by it: SGAN's squared displacements, a sum over scenes; or
    ADE and FDE, each with its own best, a mean over people as in the test."""
    adversarial_weight: NotNegative = 0.0
    """Weight of the adversarial loss; 0 trains no discriminator."""
    label_real: Interval = (0.7, 1.2)
    """Range of the smoothed label of real trajectories, drawn once a step."""
    label_fake: Interval = (0.0, 0.3)
    """Range of the label of forecasts, drawn once a step."""
    d_learning_rate: Positive = 1e-3
    """Learning rate of the discriminator."""
    discriminator_steps: Count = 1
    """Steps of the discriminator before each step of the generator, each on a batch of its own."""
    gentle_pooling: bool = False
    """Train the pooling slowly, from a small start, so that its units do not die: see
    `models.sgan.step`."""
    discriminator: DiscriminatorConfig = DiscriminatorConfig()  # noqa: RUF009 (frozen)


RECIPES = {
    "ours": GeneratorRecipe(rotate=0.5, scale=0.3, jitter=0.04, gentle_pooling=True),
    "sgan": GeneratorRecipe(
        max_agents=None,
        steps=8400,
        criterion="squared_displacement",
        adversarial_weight=1.0,
        # The released code smooths zeros by multiplying them by the random number: they
        # stay 0.
        label_fake=(0.0, 0.0),
        clip_epsilon=1e-6,
        learning_rate=1e-4,
        schedule="constant",
        warmup_steps=0,
        rotate=0.0,
        select_by="ade",
    ),
}


# Scalars of SGAN's and NeuroSyM's training, and their gradients over one training
# batch.
#
# The variety loss depends on the best of k samples only, and so does its gradient: all k
# are decoded without a gradient, then the best (and the one that the discriminator
# scores) again with one. Encoding and pooling are done once: pooling is mapped over each
# group's scenes, encoder and decoder take all slots of all groups together.

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
    futures = []
    for scene, fake in zip(groups, fakes):
        futures.append(jnp.concatenate([scene.known_future, fake[0]]))

    def loss(params: Any) -> Array:
        scores = _scores(recipe, params, twice, futures)
        halves = [jnp.split(part, 2) for part in scores]
        real, fake = map(merge, zip(*halves))
        real_loss = adversarial_loss(real, label_real, valid)
        return real_loss + adversarial_loss(fake, label_fake, valid)

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

    def loss(params: Any) -> tuple[Array, Scalars]:
        networks = params, discriminator
        return generator_loss(
            generator_config, recipe, *networks, groups, noises, label=label
        )

    return _gradient_of(loss, recipe, generator)


def _gradient_of(
    loss: Callable[[Any], tuple[Array, Scalars]], recipe: GeneratorRecipe, params: Any
) -> tuple[Any, Scalars]:
    """Gradient of `loss(params)`, in which gentle pooling leaks, and its terms and norm."""

    def leaking(params: Any) -> tuple[Array, Scalars]:
        return loss(with_leak(params) if recipe.gentle_pooling else params)

    (value, terms), gradient = jax.value_and_grad(leaking, has_aux=True)(params)
    norm = optax.tree.norm(gradient)
    return gradient, {**terms, "g_loss": value, "g_gradient_norm": norm}


def generator_loss(
    generator_config: GeneratorConfig,
    recipe: GeneratorRecipe,
    generator: Any,
    discriminator: Any,
    groups: Groups,
    noises: Sequence[Array],
    *,
    label: Array | float,
) -> tuple[Array, Scalars]:
    """[] loss of a batch, and its terms []; arguments are those of `generator_gradient`."""
    decode = functools.partial(decode_groups, generator_config)
    contexts = encode_groups(generator_config, generator, groups)
    fixed = jax.lax.stop_gradient((generator, contexts))
    trials = decode(*fixed, groups, noises)
    take = jax.vmap(
        lambda scene_noise, index: scene_noise[index], in_axes=(1, 0), out_axes=1
    )
    best = []
    for noise, scene, future in zip(noises, groups, trials):
        errors = criterion_errors(recipe, scene, future)
        best.append(take(noise, errors.argmin(axis=-1)))
    chosen = best
    if recipe.adversarial_weight:
        # The discriminator scores the last sample, as SGAN's generator step does.
        pairs = zip(best, noises)
        chosen = [jnp.concatenate([own, noise[-1:]]) for own, noise in pairs]
    futures = decode(generator, contexts, groups, chosen)
    rows = len(best[0])
    variety = variety_loss(recipe, groups, [future[:rows] for future in futures])
    terms = {"g_variety": variety}
    total = recipe.variety_weight * variety
    if recipe.adversarial_weight:
        last = [future[-1] for future in futures]
        scores = merge(_scores(recipe, discriminator, groups, last))
        valid = merge([scene.valid for scene in groups])
        terms["g_adversarial"] = adversarial_loss(scores, label, valid)
        total += recipe.adversarial_weight * terms["g_adversarial"]
    return total, terms


def with_leak(generator: Any) -> Any:
    """The variables `generator` for a loss, see `bottleneck_relu`."""
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
    squared = (forecast - truth[None]) ** 2
    squared = jnp.where(valid[None, :, None, None], squared, 0)
    squared = squared.sum(axis=(1, 2, 3))
    agents = jnp.maximum(valid.sum(dtype=squared.dtype), 1)
    return (squared / (agents * truth.shape[1]))[None]


def distance_errors(forecast: AnyArray, truth: AnyArray, valid: AnyArray) -> Array:
    """[2, k] metres: ADE and FDE of each sample of one scene, means over its `valid` [N] agents.

    `forecast` [k, N, pred_len, 2] and `truth` [N, pred_len, 2] are positions.
    """
    distance = safe_norm(forecast - truth[None])
    distance = jnp.where(valid[None, :, None], distance, 0)
    agents = jnp.maximum(valid.sum(dtype=distance.dtype), 1)
    ade = distance.mean(axis=-1).sum(axis=-1) / agents
    fde = distance[..., -1].sum(axis=-1) / agents
    return jnp.stack([ade, fde])


def steps_after(last: AnyArray, future: AnyArray) -> Array:
    """Displacements of `future [..., pred_len, 2]` after the position `last [..., 1, 2]`."""
    start = jnp.broadcast_to(last, (*future.shape[:-2], 1, 2))
    path = jnp.concatenate([start, future], axis=-2)
    return jnp.diff(path, axis=-2)


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
        errors = criterion_errors(recipe, scene, future)
        best = jnp.diagonal(errors, axis1=1, axis2=2)
        people = scene.valid.sum(axis=1).astype(best.dtype)
        if recipe.criterion == "distance":
            weighted = best[:, 0] + recipe.fde_weight * best[:, 1]
            scores = weighted * people
        else:
            scores = jnp.where(people > 0, best[:, 0], 0)
        total += scores.sum()
    if recipe.criterion == "distance":
        sizes = [scene.valid.sum(axis=1) for scene in groups]
        total /= jnp.concatenate(sizes).sum(dtype=total.dtype)
    return total


def adversarial_loss(scores: Array, label: Array | float, valid: AnyArray) -> Array:
    """Binary cross-entropy of `scores [A]` (logits) with one smoothed label, mean over valid `[A]`.

    The stable form `max(s, 0) - s y + log(1 + exp(-|s|))`.
    """
    rest = jnp.log1p(jnp.exp(-jnp.abs(scores)))
    loss = jnp.maximum(scores, 0) - scores * label + rest
    loss = jnp.where(valid, loss, 0)
    return loss.sum() / valid.sum(dtype=loss.dtype)


def warn_if_no_gradient(gradient: Any, by: str) -> None:
    """Print a warning if a gradient by weights, called `by`, is 0 in every entry."""
    leaves = jax.tree.leaves(gradient)
    if not any(np.any(leaf) for leaf in leaves):
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


@full_precision
def encode_groups(config: GeneratorConfig, params: Any, groups: Groups) -> list[Array]:
    """Contexts `[scenes, slots, C]` of each group."""
    observe = functools.partial(
        Generator(config).apply, params, method=Generator.observe
    )
    hidden = _over_slots(observe, [scene.displacement for scene in groups])
    interact = jax.vmap(
        lambda hidden, scene: interact_scene(config, params, hidden, scene)
    )
    contexts = []
    for part, scene in zip(hidden, groups):
        # `vmap` hands numpy on; pooling cannot take it.
        scene = jax.tree.map(jnp.asarray, scene)
        contexts.append(interact(part, scene.replace(future=None)))
    return contexts


@full_precision
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
    slot_noises = []
    for noise, shape in zip(noises, shapes):
        if config.noise_mix_type == "global":
            size = (len(noise), *shape, config.noise_dim)
            noise = jnp.broadcast_to(noise[:, :, None], size)
        slot_noises.append(noise.reshape(len(noise), -1, config.noise_dim))
    scene = jax.tree.map(lambda *parts: merge(parts), *futureless)
    noise = jnp.concatenate(slot_noises, axis=1)
    futures = decode(merge(contexts), scene, noise)
    return split(futures, shapes, axis=1)


def _over_slots(
    function: Callable[[Array], Any], parts: Sequence[AnyArray]
) -> list[Array]:
    """Apply `function`, of all slots together `[A, ...]`, to parts `[scenes, slots, ...]`."""
    shapes = [part.shape[:2] for part in parts]
    return split(function(merge(parts)), shapes)


@full_precision
def _scores(
    recipe: GeneratorRecipe, params: Any, groups: Groups, futures: Sequence[Array]
) -> list[Array]:
    """Discriminator scores `[scenes, slots]` of `futures [scenes, slots, pred_len, 2]`."""
    apply = functools.partial(Discriminator(recipe.discriminator).apply, params)
    moves = []
    for scene, future in zip(groups, futures):
        ahead = steps_after(scene.observed[:, :, -1:], future)
        moves.append(jnp.concatenate([scene.displacement, ahead], axis=2))
    hidden = _over_slots(functools.partial(apply, method=Discriminator.observe), moves)
    score: Any = jax.vmap(functools.partial(apply, method=Discriminator.score))
    scores = []
    for part, scene, future in zip(hidden, groups, futures):
        track = jnp.concatenate([scene.observed, future], axis=2)
        scores.append(score(part, track, jnp.asarray(scene.valid)))
    return scores


# One training step as a pure function `(state, batch, key) -> (state, metrics)`.
#
# Gentle pooling keeps the units of SGAN's and NeuroSyM's poolings alive. Such a pooling
# ends in a layer of 512 inputs, a maximum over neighbours and a ReLU. A unit that is
# never above 0 has no gradient and stays so. The layer's first values are large
# (positions are in metres), so a loss shuts units at once, and one Adam step of size r
# moves a unit by up to 512 r times its inputs. So the layer starts small and above 0,
# learns slowly, and a unit below 0 gets a share of the gradients that raise it
# (`gradients.with_leak`). Forecasts of given parameters do not change.

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
    network = Discriminator(recipe.discriminator)
    observed = jnp.zeros((1, 1, 2))
    discriminator = network.init(
        discriminator_key, observed, observed, jnp.ones(1, bool)
    )
    return new_state(recipe, params, init_adversary(recipe, discriminator))


def init_adversary(recipe: GeneratorRecipe, params: Any) -> Adversary:
    """The discriminator with these parameters, before its first step."""
    return Adversary(params, optax.adam(recipe.d_learning_rate).init(params))


def generator_rounds(
    forecaster: Any, windows: Windows, recipe: GeneratorRecipe, key: Array
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
        return train_steps(forecaster, recipe, key, state, groups)

    return advance


@program((0, 1), donate_argnums=3)
def train_steps(
    forecaster: Any,
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
        step_key = jax.random.fold_in(key, state.step)
        return train_step(forecaster, recipe, state, batches, step_key)

    return jax.lax.scan(step, state, batches)


def train_step(
    forecaster: Any,
    recipe: GeneratorRecipe,
    state: TrainState,
    batches: Groups,
    key: Array,
) -> tuple[TrainState, Scalars]:
    """Discriminator steps (where there is one), then a generator step, each on the next batch.

    `forecaster` is a `GeneratorForecaster`; without a discriminator its `loss` is
    what the generator learns. `batches` are groups with a leading axis: a batch for
    each step. `key` is consumed.
    """
    if not recipe.adversarial_weight:
        batch = jax.tree.map(lambda leaf: leaf[-1], batches)

        def loss(params: Any) -> tuple[Array, Scalars]:
            return forecaster.loss(params, batch, key, recipe)

        grads, metrics = _gradient_of(loss, recipe, state.params)
        return _updated(recipe, state, grads, metrics), metrics
    config = forecaster.config
    earlier = recipe.discriminator_steps - 1
    keys = jax.random.split(key, 7 + 4 * earlier)

    def drawn(batch: int, keys: Array, samples: int) -> Drawn:
        groups = jax.tree.map(lambda leaf: leaf[batch], batches)
        return draw_batch(config, recipe, groups, keys, samples)

    def real_label(key: Array) -> Array:
        low, high = recipe.label_real
        return jax.random.uniform(key, (), minval=low, maxval=high)

    def fake_label(key: Array) -> Array:
        low, high = recipe.label_fake
        return jax.random.uniform(key, (), minval=low, maxval=high)

    for batch, own in enumerate(keys[7:].reshape(earlier, 4)):
        labels = real_label(own[2]), fake_label(own[3])
        first = drawn(batch, own[:2], 1)
        state, *_ = learn_discriminator(config, recipe, state, first, *labels)
    state, metrics, _ = learn(
        config,
        recipe,
        state,
        drawn(-2, keys[:2], 1),
        drawn(-1, keys[3:5], recipe.best_k),
        real=(real_label(keys[2]), real_label(keys[5])),
        fake=fake_label(keys[6]),
    )
    return state, metrics


def _updated(
    recipe: GeneratorRecipe, state: TrainState, grads: Any, metrics: Scalars
) -> TrainState:
    """The state after an Adam step of the generator."""
    loss = metrics["g_loss"]
    if recipe.gentle_pooling:
        return update(recipe, state, grads, scale_pooling_updates, loss)
    return update(recipe, state, grads, value=loss)


def batch_loss(
    config: GeneratorConfig,
    recipe: GeneratorRecipe,
    params: Any,
    batch: Groups,
    key: Array,
) -> tuple[Array, Scalars]:
    """[] variety loss of a batch, augmented, and its terms []; consumes `key`."""
    # The keys that a step with a discriminator leaves for this batch.
    keys = jax.random.split(key, 7)[3:5]
    groups, noises = draw_batch(config, recipe, batch, keys, recipe.best_k)
    alone = dataclasses.replace(recipe, adversarial_weight=0.0)
    return generator_loss(config, alone, params, (), groups, noises, label=0.0)


def draw_batch(
    config: GeneratorConfig,
    recipe: GeneratorRecipe,
    groups: Groups,
    keys: Array,
    samples: int,
) -> Drawn:
    """The augmented groups, and noises of `samples` samples; consumes `keys` [2]."""
    groups = augment(groups, keys[0], recipe)
    return groups, draw_group_noise(config, groups, keys[1], samples)


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
    state = _updated(recipe, state, grads, terms)
    return state, metrics | terms, (discriminator_grads, grads)


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
    changed = {}
    for name, part in tree.items():
        is_pooling = name == "pooling" and "layer_1" in part.get("mlp", ())
        changed[name] = (
            change(part) if is_pooling else _map_pooling_params(part, change)
        )
    return changed
