import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.models.config import DiscriminatorConfig
from neurosym_jax.training.gradients import (
    decode_groups,
    discriminator_gradient,
    draw_group_noise,
    encode_groups,
    generator_gradient,
)
from neurosym_jax.training.losses import distance_errors, squared_displacement_errors
from neurosym_jax.training.step import TrainState, clipping, initial_state, train_step, update
from neurosym_jax.training.stream import SceneStream
from tests.networks import drawing

ALL_TERMS = {
    "adversarial_weight": 1.0,
    "criterion": "squared_displacement",
    "discriminator": DiscriminatorConfig("global", 4, 6, 8, 8),
}


@pytest.fixture(scope="module")
def groups(batch):
    """Three buckets of one batch, the second without anybody in it."""
    groups = batch(6)
    return (groups[0], jax.tree.map(np.zeros_like, groups[1]), *groups[2:])


def start(run, groups, **changes) -> tuple[Any, TrainState, list[jax.Array]]:
    """The state before the first step, with parameters that numpy draws: it compiles nothing."""
    recipe = dataclasses.replace(run.recipe, **changes)
    shapes = jax.eval_shape(lambda: initial_state(run.network, recipe, jax.random.key(0)))
    draw = drawing(seed=0)

    state = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
    params, discriminator = (
        jax.tree.map(lambda leaf: jnp.asarray(draw(leaf.shape)), part)
        for part in (shapes.params, shapes.discriminator)
    )
    average = params if recipe.ema else ()
    state = state._replace(params=params, average=average, discriminator=discriminator)
    return recipe, state, draw_group_noise(run.network, groups, jax.random.key(1), recipe.best_k)


def with_positions(groups, change):
    """The groups with `change(scene, values)` of all positions and moves."""
    names = ("observed", "displacement", "future")
    return tuple(
        scene.replace(**{name: change(scene, getattr(scene, name)) for name in names})
        for scene in groups
    )


def literal_loss(generator, recipe, params, groups, noises):
    """The minimum over all k samples, each decoded with its gradient."""
    contexts = encode_groups(generator, params, groups)
    futures = decode_groups(generator, params, contexts, groups, noises)
    distance = recipe.criterion == "distance"

    def of_scene(observed, truth, valid, made):
        if distance:
            ade, fde = distance_errors(made, truth, valid).min(axis=1)
            return ade + recipe.fde_weight * fde, valid.sum()
        last = observed[:, -1:]
        moves = jnp.diff(made, axis=2, prepend=jnp.broadcast_to(last, made[:, :, :1].shape))
        true = jnp.diff(truth, axis=1, prepend=last)
        return squared_displacement_errors(moves, true, valid).min(), valid.any()

    parts = [
        jax.vmap(of_scene, (0, 0, 0, 1))(scene.observed, scene.future, scene.valid, future)
        for scene, future in zip(groups, futures)
    ]
    values, shares = (jnp.concatenate(part) for part in zip(*parts))
    total = (values * shares).sum()
    return total / shares.sum() if distance else total


@pytest.mark.slow
@pytest.mark.parametrize("criterion", ["distance", "squared_displacement"])
def test_the_gradient_is_that_of_the_minimum_over_all_samples(run, groups, criterion):
    config, state, noises = start(run, groups, criterion=criterion)
    ours, metrics = jax.jit(
        lambda params: generator_gradient(
            run.network, config, params, (), groups, noises, label=1.0
        )
    )(state.params)
    value, wanted = jax.jit(
        jax.value_and_grad(lambda params: literal_loss(run.network, config, params, groups, noises))
    )(state.params)
    assert metrics["g_loss"] == pytest.approx(float(value), rel=1e-5)
    assert metrics["g_gradient_norm"] > 0
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=2e-6, rtol=1e-4), ours, wanted)


@pytest.mark.slow
def test_gradients_stay_finite_where_everybody_stands_on_one_spot(run, groups):
    groups = groups[:1]
    still = with_positions(groups, lambda scene, values: np.zeros_like(values))
    generator = dataclasses.replace(
        run.network, pooling="as_described,bottleneck_dim=4,hidden_dim=16", weighting="cnd"
    )
    config, state, noises = start(dataclasses.replace(run, network=generator), groups, **ALL_TERMS)
    fakes = draw_group_noise(generator, groups, jax.random.key(2), 1)
    both = state.params, state.discriminator

    def step(both):
        of_g, _ = generator_gradient(generator, config, *both, still, noises, label=0.9)
        of_d, _ = discriminator_gradient(
            generator, config, *both, still, fakes, label_real=0.9, label_fake=0.0
        )
        return of_g, of_d

    for leaf in jax.tree.leaves(jax.jit(step)(both)):
        assert np.isfinite(leaf).all()


def test_padding_and_empty_scenes_change_no_gradient(run, groups):
    config, state, noises = start(run, groups, **ALL_TERMS)
    groups, noises = (groups[0], groups[2]), [noises[0], noises[2]]
    wild = with_positions(
        groups, lambda scene, values: np.where(scene.valid[..., None, None], values, 50.0)
    )
    both = state.params, state.discriminator

    @jax.jit
    def gradient(groups):
        return generator_gradient(run.network, config, *both, groups, noises, label=0.9)

    (plain, metrics), (padded, _) = gradient(groups), gradient(wild)
    assert metrics["g_adversarial"] > 0
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), plain, padded)


def test_the_average_follows_its_decay(run, groups):
    recipe, state, _ = start(run, groups, ema=0.5, schedule="constant", clip_norm=0.0)
    ones = jax.tree.map(jnp.ones_like, state.params)
    step = jax.jit(lambda state: update(recipe, state, ones))
    # At the first step the average is nine tenths of the new parameters.
    for done, share in ((0, 0.1), (1000, 0.5)):
        after = step(state._replace(step=jnp.asarray(done)))
        assert int(after.step) == done + 1
        parts = (jax.tree.leaves(part) for part in (state.params, after.params, after.average))
        for old, new, average in zip(*parts):
            np.testing.assert_allclose(average, share * old + (1 - share) * new, atol=1e-7)


def test_the_rate_warms_up_and_falls_to_zero(run, groups):
    rates = {"warmup_steps": 10, "learning_rate": 0.1, "clip_norm": 0.0, "ema": 0.0}
    recipe, state, _ = start(run, groups, steps=100, **rates)
    ones = jax.tree.map(jnp.ones_like, state.params)
    step = jax.jit(lambda state: update(recipe, state, ones))

    def bias(state):
        return float(state.params["params"]["decoder"]["hidden2pos"]["bias"][0])

    moves = []
    for _ in range(101):
        before, state = bias(state), step(state)
        moves.append(before - bias(state))  # Adam moves by the rate: the gradient is constant.
    wanted = [0.1 * t / 10 for t in range(10)]
    wanted += [0.05 * (1 + np.cos(np.pi * (t - 10) / 90)) for t in range(10, 101)]
    np.testing.assert_allclose(moves, wanted, atol=1e-5)


def test_clipping(run):
    ones = {"a": jnp.ones((3, 4)), "b": jnp.ones(4)}
    for norm, wanted in ((2.0, 0.5), (8.0, 1.0), (0.0, 1.0)):
        clip = clipping(dataclasses.replace(run.recipe, clip_norm=norm))
        for leaf in jax.tree.leaves(clip.update(ones, clip.init(ones))[0]):
            np.testing.assert_allclose(leaf, wanted, rtol=1e-6)


@pytest.mark.slow
def test_a_step_trains_both_networks_and_leaves_randomness_to_the_key(run, make_windows):
    batches = SceneStream(make_windows([3] * 6), 6, seed=0).steps(0, 2)  # One class to compile.
    groups = jax.tree.map(lambda leaf: leaf[0], batches)
    config, state, _ = start(run, groups, schedule="constant", **ALL_TERMS)
    # Scores end in a ReLU, which may be shut at first; a shut one teaches nothing.
    state.discriminator["params"]["classifier"]["layer_1"]["bias"] += 0.5
    with jax.debug_key_reuse(True):
        step = jax.jit(lambda key: train_step(run.network, config, state, batches, key))
        (one, metrics), (again, _), (other, _) = (step(jax.random.key(s)) for s in (1, 1, 2))
    terms = {"g_variety", "g_adversarial"}
    assert set(metrics) == {"d_loss", "g_loss", "g_gradient_norm", *terms}
    jax.tree.map(np.testing.assert_array_equal, one, again)
    assert int(one.step) == 1
    for name in ("params", "discriminator"):
        before, after, else_ = (jax.tree.leaves(getattr(s, name)) for s in (state, one, other))
        assert any((a != b).any() for a, b in zip(before, after))
        assert any((a != b).any() for a, b in zip(after, else_))
