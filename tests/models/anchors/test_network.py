"""Anchors: what a person's forecast depends on, and what it does not."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.models.anchors.network import (
    AnchorConfig,
    AnchorNetwork,
    AnchorTable,
    AnchorTableConfig,
)
from tests.networks import random_params

SMALL = AnchorConfig(pred_len=6, samples=4, points=3, hidden=8, symbols=True)
VALID = np.ones(6, bool)


@pytest.fixture(scope="module")
def people():
    rng = np.random.default_rng(0)
    velocity = rng.normal(size=(6, 1, 2)) * 0.4
    observed = rng.normal(size=(6, 1, 2)) * 2 + velocity * np.arange(8)[:, None]
    return (observed + rng.normal(size=observed.shape) * 0.02).astype(np.float32)


@pytest.fixture(scope="module")
def network(people):
    """`apply` of a small network whose parameters are all far from 0, and another's with them."""
    params = random_params(AnchorNetwork(SMALL), people, VALID, std=0.2, seed=0)
    return jax.jit(lambda *inputs: AnchorNetwork(SMALL).apply(params, *inputs)), params


def test_padding_changes_nothing_and_people_have_no_order(network, people):
    apply, _ = network
    forecast, log_probability, points = map(np.asarray, apply(people, VALID))
    order = np.array([3, 1, 5, 0, 2, 4])
    padded = np.concatenate([people[order], np.full((2, 8, 2), 7.0, np.float32)])
    permuted, same, points_too = apply(padded, np.arange(8) < 6)
    permuted, points_too = np.asarray(permuted), np.asarray(points_too)
    np.testing.assert_allclose(permuted[:, :6], forecast[:, order], atol=1e-4)
    np.testing.assert_allclose(points_too[:, :6], points[:, order], atol=1e-4)
    assert points.shape == (3, 6, 6, 2)
    assert np.abs(points[0] - points[1]).max() > 0.1
    np.testing.assert_allclose(same, log_probability, atol=1e-5)
    np.testing.assert_allclose(np.exp(log_probability).sum(), 1, rtol=1e-5)
    assert np.ptp(log_probability) > 0.1


def test_neighbours_that_are_listed_are_those_of_all_pairs(network, people):
    apply, _ = network
    present = np.arange(6) < 5
    others = ~np.eye(6, dtype=bool)
    near = np.array([np.flatnonzero(row) for row in others])
    listed, complete = (
        jax.tree.map(np.asarray, apply(people, present, *inputs))
        for inputs in ((None, 0.0, near), ())
    )
    np.testing.assert_allclose(
        listed.samples[:, :5], complete.samples[:, :5], atol=1e-4
    )
    np.testing.assert_allclose(listed.points[:, :5], complete.points[:, :5], atol=1e-4)


@pytest.mark.slow
def test_untrained_samples_scatter_about_constant_velocity_and_are_almost_straight():
    walk = jnp.array([[0.0, 0.4, 0.8, 1.2, 1.6, 2.0, 2.4, 3.1]])[..., None] * jnp.array(
        [1.0, 0.0]
    )
    table = AnchorTable(AnchorTableConfig(samples=1000))
    forecast = jax.jit(lambda key: table.init_with_output(key, walk)[0][0])(
        jax.random.key(0)
    )[:, 0]
    # 0.8 of the last step and 0.2 of the mean of three.
    np.testing.assert_allclose(
        forecast[0, :, 0] - 3.1, 0.66 * np.arange(1, 9), rtol=1e-3
    )
    deviation = np.hypot(0.25 * 0.5 * 8, 0.1)
    np.testing.assert_allclose(jnp.std(forecast[:, -1], axis=0), deviation, rtol=0.1)
    network = AnchorNetwork(AnchorConfig(samples=1000, hidden=8, geometry=False))
    params = jax.jit(network.init)(jax.random.key(1), walk, VALID[:1])["params"]
    for name, scale in (("anchor", 0.25), ("still", 0.1)):
        np.testing.assert_array_equal(params[name][0], 0)
        size = jnp.std(params[name], axis=(0, 2)) / scale
        np.testing.assert_allclose(size, [1, 0.1, 0.1, 0.1, 0.1], rtol=0.1)


def test_forecasts_move_with_the_scene_and_those_of_walkers_turn_with_it(
    network, people
):
    apply, params = network
    shift = np.array([5.0, -3.0], np.float32)
    shifted, unmoved = apply(people + shift, VALID), apply(people, VALID)
    for moved, before in (
        (shifted.samples, unmoved.samples),
        (shifted.points, unmoved.points),
    ):
        np.testing.assert_allclose(moved, np.asarray(before) + shift, atol=2e-4)
    # What standing people may do is learned in the scene's axes.
    scene_axes = {"still": (4, 5, 2), "point_still": (3, 5, 2)}
    still = {name: np.zeros(shape, "f4") for name, shape in scene_axes.items()}
    params = {"params": params["params"] | still}
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]], np.float32)
    walkers = jax.jit(AnchorNetwork(SMALL).apply)
    forecast, log_probability, points = map(np.asarray, walkers(params, people, VALID))
    turned, same, turned_points = walkers(params, people @ turn, VALID)
    np.testing.assert_allclose(turned, forecast @ turn, atol=1e-3)
    np.testing.assert_allclose(turned_points, points @ turn, atol=1e-3)
    np.testing.assert_allclose(same, log_probability, atol=1e-4)


@pytest.mark.slow
def test_neighbours_are_seen_within_the_radius_only(network, people):
    apply, _ = network
    alone = np.asarray(apply(people[:2], np.array([True, False]))[0])[:, 0]

    def beside(metres, alpha=1.0):
        pair = np.stack([people[0], people[0] + np.array([metres, 0.0], "f4")])
        weights = np.full((2, 2), alpha, np.float32)
        return np.asarray(apply(pair, VALID[:2], weights)[0])[:, 0]

    # Beyond 10 m people are counted, beyond 20 m nothing is left of them.
    np.testing.assert_array_equal(beside(20.0), alone)
    np.testing.assert_allclose(beside(19.9), alone, atol=1e-2)
    np.testing.assert_array_equal(beside(10.0), beside(10.0, alpha=0.0))
    assert 0 < np.abs(beside(9.9) - beside(9.9, alpha=0.0)).max() < 1e-2
    assert np.abs(beside(1.0) - alone).max() > 0.05


def test_features_of_a_pair_by_hand():
    """One person walks at 1 m/s along x; another stands 9 m ahead, 1 m to the left."""
    observed = np.zeros((2, 8, 2), np.float32)
    observed[0, :, 0] = 0.4 * np.arange(-7, 1)
    observed[1] = [9.0, 1.0]
    velocity = np.array([[0.4, 0.0], [0.0, 0.0]], np.float32)
    config = AnchorConfig(symbols=False)
    features, near, crowd = map(
        np.asarray,
        jax.jit(AnchorConfig.pair_features, static_argnums=0)(
            config, observed, velocity, velocity / 0.4, VALID[:2], None
        ),
    )
    metres = np.hypot(9, 1)
    place = [9 / metres, 1 / metres, -1, 0]
    distance = [1, np.exp(-metres), metres / 10, 1 / (metres + 0.3)]
    # They are closest in 9 s; 5 s ahead, where the search ends, they are 4 m and 1 m
    # apart.
    approach = [5, np.exp(-2 * np.hypot(4, 1) - 5), 1, 0]
    np.testing.assert_allclose(
        features[0, 1], [*place, *distance, *approach], atol=2e-3
    )
    np.testing.assert_array_equal(features[[0, 1], [0, 1]], 0)
    np.testing.assert_allclose(near[0, 1], (1 - metres**2 / 100) ** 2, rtol=1e-5)
    np.testing.assert_allclose(crowd, (1 - metres**2 / 400) ** 2, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("geometry", "symbols"), [(0, 0), (0, 1), (1, 0)])
def test_what_the_attention_sees(people, geometry, symbols):
    """With symbols alone a neighbour's speed is unseen; with neither, the neighbour."""
    config = dataclasses.replace(SMALL, geometry=bool(geometry), symbols=bool(symbols))
    network = AnchorNetwork(config)
    pair = np.stack([people[0], people[0] + np.array([3.0, 1.0], np.float32)])
    params = random_params(network, pair, VALID[:2], std=0.2)
    apply = jax.jit(
        lambda observed: network.apply(params, observed, VALID[:2])[0][:, 0]
    )
    last = pair[1, -1]
    effects = []
    for factor in (1.05, 0.0):
        other = pair.copy()
        other[1] = last + (pair[1] - last) * factor
        effects.append(np.abs(np.asarray(apply(other)) - np.asarray(apply(pair))).max())
    speed_effect, state_effect = effects
    assert (speed_effect > 1e-4) == bool(geometry)
    assert (state_effect > 1e-4) == bool(geometry or symbols)


@pytest.mark.parametrize(
    "network",
    [AnchorNetwork(SMALL), AnchorTable(AnchorTableConfig(pred_len=6, samples=4))],
    ids=["anchors", "table"],
)
def test_gradients_are_finite_where_people_stand_on_one_spot(network):
    observed = np.zeros((3, 8, 2), np.float32)
    valid = np.array([True, True, False])
    params = random_params(network, observed, valid, std=0.2)

    def loss(params, observed):
        samples, log_probability, points = network.apply(params, observed, valid)
        return (
            sum(jnp.square(part - 1).sum() for part in (samples, points))
            + log_probability[0]
        )

    gradients = jax.jit(jax.grad(loss, (0, 1)))(params, observed)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))
    assert np.abs(np.asarray(gradients[1])[:2]).max() > 0
