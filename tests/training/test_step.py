"""Losses by hand, their gradients, and steps: rates, clipping, averages, randomness."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.models.sgan.network import DiscriminatorConfig
from neurosym_jax.models.sgan.training import (
    adversarial_loss,
    decode_groups,
    distance_errors,
    draw_group_noise,
    encode_groups,
    generator_gradient,
    init_adversary,
    init_gentle_pooling,
    init_state,
    safe_norm,
    scale_pooling_updates,
    squared_displacement_errors,
    train_step,
    warn_if_no_gradient,
    with_leak,
)
from neurosym_jax.training.batches import SceneStream
from neurosym_jax.training.state import (
    TrainState,
    clipping,
    new_state,
    update,
    warmup_of,
)
from tests.networks import drawing
from tests.repository import exhaustive

ALL_TERMS = {
    "adversarial_weight": 1.0,
    "criterion": "squared_displacement",
    "discriminator": DiscriminatorConfig("global", 4, 6, 8, 8),
}


@pytest.fixture(scope="module")
def groups(batch):
    """Three buckets of one batch; the second has no people."""
    groups = batch(6)
    return (groups[0], jax.tree.map(np.zeros_like, groups[1]), *groups[2:])


def start(run, groups, **changes) -> tuple[Any, TrainState, list[jax.Array]]:
    """The state before the first step, with parameters that numpy draws."""
    recipe = dataclasses.replace(run.recipe, **changes)
    shapes = jax.eval_shape(lambda: init_state(run.config, recipe, jax.random.key(0)))
    draw = drawing(seed=0)

    def drawn(part):
        return jax.tree.map(lambda leaf: jnp.asarray(draw(leaf.shape)), part)

    params = drawn(shapes.params)
    extra = init_adversary(recipe, drawn(shapes.extra.params)) if shapes.extra else ()
    noise = draw_group_noise(run.config, groups, jax.random.key(1), recipe.best_k)
    return recipe, new_state(recipe, params, extra), noise


def test_adversarial_loss_is_binary_cross_entropy():
    scores, label = np.array([-3.0, 0.0, 0.5, 40.0]), 0.9
    probability = 1 / (1 + np.exp(-scores[:3]))
    expected = -(label * np.log(probability) + (1 - label) * np.log(1 - probability))
    valid = np.array([True, True, True, False])
    assert adversarial_loss(scores, label, valid) == pytest.approx(
        expected.mean(), rel=1e-6
    )
    assert adversarial_loss(scores[3:], 1.2, valid[:1]) == pytest.approx(
        40 - 48, rel=1e-6
    )


def test_errors_by_hand_and_gradients_of_a_perfect_forecast():
    rng = np.random.default_rng(0)
    forecast, truth = rng.normal(size=(5, 4, 3, 2)), rng.normal(size=(4, 3, 2))
    valid = np.array([True, True, True, False])
    distance = np.linalg.norm(forecast[:, :3] - truth[:3], axis=-1)
    ade, fde = jax.jit(distance_errors)(forecast, truth, valid)
    np.testing.assert_allclose(ade, distance.mean(axis=(1, 2)), rtol=1e-5)
    np.testing.assert_allclose(fde, distance[:, :, -1].mean(axis=1), rtol=1e-5)
    (squared,) = jax.jit(squared_displacement_errors)(forecast, truth, valid)
    np.testing.assert_allclose(squared, (distance**2).mean(axis=(1, 2)), rtol=1e-5)
    total = jax.jit(jax.grad(lambda f: distance_errors(f, truth, valid).sum()))
    gradient = total(jnp.array(truth[None]))
    assert not np.asarray(gradient).any()
    with jax.debug_nans(False):
        assert np.isnan(jax.jit(safe_norm)(np.array([np.nan, 4.0])))
    norm, slope = jax.jit(jax.value_and_grad(safe_norm))(np.array([3.0, 4.0]))
    assert norm == 5
    np.testing.assert_allclose(slope, [0.6, 0.8], rtol=1e-6)


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
        moves = jnp.diff(
            made, axis=2, prepend=jnp.broadcast_to(last, made[:, :, :1].shape)
        )
        true = jnp.diff(truth, axis=1, prepend=last)
        return squared_displacement_errors(moves, true, valid).min(), valid.any()

    parts = [
        jax.vmap(of_scene, (0, 0, 0, 1))(
            scene.observed, scene.future, scene.valid, future
        )
        for scene, future in zip(groups, futures)
    ]
    values, shares = (jnp.concatenate(part) for part in zip(*parts))
    total = (values * shares).sum()
    return total / shares.sum() if distance else total


@pytest.mark.slow
@pytest.mark.parametrize("criterion", ["distance", exhaustive("squared_displacement")])
def test_the_gradient_is_that_of_the_minimum_over_all_samples(run, groups, criterion):
    config, state, noises = start(run, groups, criterion=criterion)
    gradient, metrics = jax.jit(
        lambda params: generator_gradient(
            run.config, config, params, (), groups, noises, label=1.0
        )
    )(state.params)
    value, expected = jax.jit(
        jax.value_and_grad(
            lambda params: literal_loss(run.config, config, params, groups, noises)
        )
    )(state.params)
    assert metrics["g_loss"] == pytest.approx(float(value), rel=1e-5)
    assert metrics["g_gradient_norm"] > 0
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=2e-6, rtol=1e-4),
        gradient,
        expected,
    )


@pytest.mark.parametrize("mix", ["global", "ped"])
def test_futures_have_a_sample_axis_first_also_where_they_pool_at_every_step(
    run, groups, mix
):
    config = dataclasses.replace(
        run.config, pool_every_timestep=True, noise_mix_type=mix
    )
    samples = 1 + max(len(scene.valid) for scene in groups)

    def futures(key):
        params = init_state(config, run.recipe, key).params
        contexts = encode_groups(config, params, groups)
        noises = draw_group_noise(config, groups, key, samples)
        return decode_groups(config, params, contexts, groups, noises)

    shapes = [leaf.shape for leaf in jax.eval_shape(futures, jax.random.key(0))]
    assert shapes == [
        (samples, *scene.valid.shape, config.pred_len, 2) for scene in groups
    ]


def test_padding_and_empty_scenes_change_no_gradient(run, groups):
    config, state, noises = start(run, groups, **ALL_TERMS)
    groups, noises = (groups[0], groups[2]), [noises[0], noises[2]]

    def far(scene, name):
        return np.where(scene.valid[..., None, None], getattr(scene, name), 50.0)

    names = ("observed", "displacement", "future")
    wild = []
    for scene in groups:
        wild.append(scene.replace(**{name: far(scene, name) for name in names}))
    wild = tuple(wild)
    params = state.params, state.extra.params

    @jax.jit
    def gradient(groups):
        return generator_gradient(
            run.config, config, *params, groups, noises, label=0.9
        )

    (plain, metrics), (padded, _) = gradient(groups), gradient(wild)
    assert metrics["g_adversarial"] > 0
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, atol=1e-6), plain, padded
    )


@pytest.mark.exhaustive
def test_the_average_follows_its_decay(run, groups):
    recipe, state, _ = start(run, groups, ema=0.5, schedule="constant", clip_norm=0.0)
    ones = jax.tree.map(jnp.ones_like, state.params)
    step = jax.jit(lambda state: update(recipe, state, ones))
    # At the first step the average is nine tenths of the new parameters.
    for done, share in ((0, 0.1), (1000, 0.5)):
        after = step(state._replace(step=jnp.asarray(done)))
        assert int(after.step) == done + 1
        parts = (
            jax.tree.leaves(part)
            for part in (state.params, after.params, after.average)
        )
        for old, new, average in zip(*parts):
            np.testing.assert_allclose(
                average, share * old + (1 - share) * new, atol=1e-7
            )


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
        moves.append(
            before - bias(state)
        )  # Adam moves by the rate: the gradient is constant.
    expected = [0.1 * t / 10 for t in range(10)]
    expected += [0.05 * (1 + np.cos(np.pi * (t - 10) / 90)) for t in range(10, 101)]
    np.testing.assert_allclose(moves, expected, atol=1e-5)
    short = dataclasses.replace(recipe, steps=12)
    assert warmup_of(short) == 6  # Half of a run that is shorter than two warm-ups.


def test_clipping(run):
    ones = {"a": jnp.ones((3, 4)), "b": jnp.ones(4)}
    for norm, expected in ((2.0, 0.5), (8.0, 1.0), (0.0, 1.0)):
        clip = clipping(dataclasses.replace(run.recipe, clip_norm=norm))
        for leaf in jax.tree.leaves(clip.update(ones, clip.init(ones))[0]):
            np.testing.assert_allclose(leaf, expected, rtol=1e-6)


@pytest.mark.slow
def test_a_step_trains_both_networks_and_leaves_randomness_to_the_key(
    run, make_windows
):
    batches = SceneStream(make_windows([3] * 6), 6, seed=0).steps(
        0, 2
    )  # One class to compile.
    groups = jax.tree.map(lambda leaf: leaf[0], batches)
    config, state, _ = start(run, groups, schedule="constant", **ALL_TERMS)
    # Scores end in a ReLU, which may be shut at first; a shut one teaches nothing.
    state.extra.params["params"]["classifier"]["layer_1"]["bias"] += 0.5
    with jax.debug_key_reuse(True):
        step = jax.jit(
            lambda key: train_step(run.forecaster, config, state, batches, key)
        )
        (first, metrics), (again, _), (other, _) = (
            step(jax.random.key(s)) for s in (1, 1, 2)
        )
    terms = {"g_variety", "g_adversarial"}
    assert set(metrics) == {"d_loss", "g_loss", "g_gradient_norm", *terms}
    jax.tree.map(np.testing.assert_array_equal, first, again)
    assert int(first.step) == 1
    for params in (lambda s: s.params, lambda s: s.extra.params):
        before, after, else_ = (
            jax.tree.leaves(params(s)) for s in (state, first, other)
        )
        assert any((a != b).any() for a, b in zip(before, after))
        assert any((a != b).any() for a, b in zip(after, else_))


@pytest.mark.exhaustive
def test_each_discriminator_step_has_a_batch_of_its_own(run, make_windows):
    batches = SceneStream(make_windows([3] * 6), 6, seed=0).steps(0, 3)
    groups = jax.tree.map(lambda leaf: leaf[0], batches)
    changes = {"jitter": 0.0, "discriminator_steps": 2, **ALL_TERMS}
    config, state, _ = start(run, groups, **changes)
    state.extra.params["params"]["classifier"]["layer_1"]["bias"] += 0.5
    step = jax.jit(
        lambda batches: train_step(run.forecaster, config, state, batches, key)[0]
    )
    key = jax.random.key(1)

    def trained(number=None):
        """The discriminator's parameters after a step, the scenes of one batch stretched."""
        factor = np.where(np.arange(3) == number, 1.5, 1.0)[:, None, None, None, None]
        moved = []
        for scene in batches:
            observed, future = factor * scene.observed, factor * scene.known_future
            moved.append(scene.replace(observed=observed, future=future))
        return step(tuple(moved))

    usual = trained()
    assert int(usual.step) == 1
    assert int(usual.extra.optimizer[0].count) == 2
    others = [trained(number).extra.params for number in range(3)]
    equal = [
        all(map(np.array_equal, *map(jax.tree.leaves, (usual.extra.params, other))))
        for other in others
    ]
    assert equal == [False, False, True]


@pytest.mark.slow
@pytest.mark.parametrize("weight", [0.0, exhaustive(1.0)])
def test_without_the_variety_loss_the_true_future_changes_no_gradient(
    run, groups, weight
):
    config, state, noises = start(run, groups, variety_weight=weight, **ALL_TERMS)
    state.extra.params["params"]["classifier"]["layer_1"]["bias"] += 0.5
    gradient = jax.jit(
        lambda groups: generator_gradient(
            run.config,
            config,
            state.params,
            state.extra.params,
            groups,
            noises,
            label=1.0,
        )[0]
    )
    other = tuple(scene.replace(future=2 * scene.known_future) for scene in groups)
    leaves, others = (jax.tree.leaves(gradient(scenes)) for scenes in (groups, other))
    assert any(leaf.any() for leaf in leaves)
    assert all(map(np.array_equal, leaves, others)) == (weight == 0)


def generator_params(layers=2):
    mlp = {
        f"layer_{i}": {"kernel": jnp.ones((3, 2)), "bias": jnp.zeros(2)}
        for i in range(layers)
    }
    decoder = {"pooling": {"mlp": mlp}, "mlp": {"kernel": jnp.ones(4)}}
    return {"params": {"pooling": {"mlp": mlp}, "decoder": decoder}}


@pytest.mark.slow
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("gentle", [True, False])
def test_only_gradients_that_raise_a_dead_unit_leak(run, gentle, sign):
    module = run.config.pooling.network(8, obs_len=4, embedding_dim=4)
    rng = np.random.default_rng(0)
    hidden, position = (
        rng.normal(size=shape).astype(np.float32) for shape in ((4, 8), (4, 2))
    )
    inputs = hidden, position, np.ones(4, bool)
    params = module.init(jax.random.key(0), *inputs)["params"]
    layer = params["mlp"]["layer_1"]
    layer["bias"] = layer["bias"].at[0].set(-1e3)

    def pooled(params):
        variables = {"params": {"pooling": params}}
        training = with_leak(variables)["training"]["pooling"] if gentle else {}
        return module.apply({"params": params, "training": training}, *inputs)

    assert (pooled(params) == module.apply({"params": params}, *inputs)).all()
    gradient = jax.grad(lambda params: sign * pooled(params).sum())(params)
    leaked, alive = gradient["mlp"]["layer_1"]["bias"][:2]
    assert leaked == pytest.approx(-0.4 if gentle and sign < 0 else 0)
    assert alive == pytest.approx(4 * sign)


def test_poolings_with_a_bottleneck_start_small_and_learn_slowly():
    params = init_gentle_pooling(generator_params())["params"]
    for part in (params, params["decoder"]):
        layer = part["pooling"]["mlp"]["layer_1"]
        assert layer["bias"].tolist() == [0.5, 0.5]
        assert float(layer["kernel"].max()) == pytest.approx(0.3)
    slow = scale_pooling_updates(generator_params())["params"]
    assert float(slow["pooling"]["mlp"]["layer_0"]["kernel"].max()) == pytest.approx(
        0.05
    )
    assert (slow["decoder"]["mlp"]["kernel"] == 1).all()
    social = generator_params(layers=1)
    jax.tree.map(
        np.testing.assert_array_equal,
        init_gentle_pooling(scale_pooling_updates(social)),
        social,
    )


def test_a_gradient_that_is_zero_everywhere_is_said(capsys):
    warn_if_no_gradient({"table": np.zeros(3), "scale": np.ones(1)}, "the weights")
    assert capsys.readouterr().err == ""
    warn_if_no_gradient({"table": np.zeros(3)}, "the weights")
    assert "the gradient by the weights is 0 in every entry" in capsys.readouterr().err
