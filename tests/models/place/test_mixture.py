"""Mixtures: their energy scores, and how often draws take what is remembered."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.evaluation.metrics import energy_score
from neurosym_jax.models.place.memory import Recall
from neurosym_jax.models.place.mixture import (
    DRAWN,
    Remembered,
    distances_apart,
    energy,
    errors,
    remembered,
)
from neurosym_jax.scene import make_scene


@pytest.fixture
def drawn():
    """Offsets of the network's points, what two kernels recall, and the truth."""
    rng = np.random.default_rng(0)
    offsets = rng.normal(0, 1, (6, 3, 5, 2)).astype(np.float32)
    onward = rng.normal(1, 1, (3, 4, 5, 2)).astype(np.float32)
    weight = rng.uniform(0, 1, (3, 2, 4))
    weight *= np.array([[[1.0], [0.4]]]) / weight.sum(2, keepdims=True)
    mean_part = jnp.array([0.0, 1.0, 0.5, 1.0])
    recall = Recall(jnp.asarray(onward), jnp.asarray(weight, jnp.float32), mean_part)
    return jnp.asarray(offsets), recall, rng.normal(0, 1, (3, 5, 2)).astype(np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("shares", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.2, 0.3]])
def test_energy_is_that_of_the_points_with_their_probabilities(drawn, shares):
    offsets, recall, truth = drawn
    shares = np.tile(shares, (3, 1))
    given = energy(
        shares,
        np.asarray(errors(offsets, recall, truth)),
        np.asarray(distances_apart(offsets, recall)),
    )
    memory = remembered(recall, jnp.asarray(shares, jnp.float32), jnp.zeros((3, 2)))
    points, weight = memory.beside(offsets, 0, 1)
    for person in range(3):
        scene = make_scene(np.zeros((1, 2, 2)), truth[person][None])
        wanted = energy_score(points[:, person, None], scene, weight[person])
        assert given[person] == pytest.approx(float(wanted), abs=2e-4)


def test_draws_take_what_is_remembered_as_often_as_its_share_says():
    draws = jnp.zeros((400, 2, 3, 2))
    future = jnp.arange(1.0, 4)[:, None, None, None] * jnp.ones((3, 2, 3, 2))
    share = jnp.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.5]])
    scene = make_scene(np.zeros((2, 2, 2)))
    memory = Remembered(future, share, jnp.zeros((3, 2)))
    among = jax.jit(Remembered.among, static_argnums=4)
    mixed = np.asarray(among(memory, draws, scene, jax.random.key(0), 400))[..., 0, 0]
    for person in range(2):
        counts = np.bincount(mixed[:, person].astype(int), minlength=4)
        assert counts[1:] == pytest.approx(400 * np.asarray(share[:, person]), abs=1)


def test_of_many_ways_the_most_probable_are_drawn_with_the_probability_of_all():
    ways = 2 * DRAWN
    weight = np.arange(1.0, ways + 1) / sum(range(1, ways + 1))
    recall = Recall(
        onward=jnp.arange(float(ways))[None, :, None, None] * jnp.ones((1, 1, 3, 2)),
        weight=jnp.asarray(weight)[None, None],
        mean_part=(jnp.arange(ways) % 2 == 0) / 1.0,
    )
    memory = remembered(recall, jnp.array([[0.5, 0.5]]), jnp.full((1, 2), 100.0))
    number = np.arange(ways)[: DRAWN - 1 : -1]
    assert memory.mean_part[:, 0].tolist() == (number % 2 == 0).tolist()
    start = np.where(number % 2 == 0, 0, 100)
    assert_allclose(memory.future[:, 0, 0, 0], number + start)
    drawn = weight[number] / weight[number].sum()
    assert_allclose(memory.share[:, 0], drawn / 2, rtol=1e-5)


@pytest.mark.slow
def test_errors_are_added_to_what_the_network_expects():
    """Somebody 10 m ahead on average, of whom others were forecast 2 m short here."""
    points = jnp.array([8.0, 12.0])[:, None, None, None] * jnp.ones((2, 1, 3, 2))
    recall = Recall(
        onward=2 * jnp.ones((1, 1, 3, 2)),
        weight=jnp.ones((1, 1, 1)),
        mean_part=jnp.array([1.0]),
    )
    last = jnp.array([[100.0, 0.0]])
    memory = remembered(recall, jnp.array([[0.5, 0.5]]), last)
    both, weight = memory.beside(last[:, None] + points, 0, 1)
    assert_allclose(both[2, 0], [[112.0, 12.0]] * 3)
    assert_allclose(weight, [[0.25, 0.25, 0.5]])
    scene = make_scene(np.zeros((1, 2, 2)))
    mixed = memory.among(last[:, None] + points, scene, jax.random.key(0), 40)
    ahead = np.unique(np.asarray(mixed[:, 0, 0, 0]), return_counts=True)
    assert_allclose(ahead[0], [108.0, 112.0])
    # Half of 40, and the half of the network's that lies there, too.
    assert_allclose(ahead[1], [10, 30], atol=3)
    # Of a truth that is 12 m ahead they are right.
    assert_allclose(errors(points, recall, 12 * jnp.ones((1, 3, 2))), [[2**1.5, 0]])


def test_halfway_lies_between_a_way_and_what_the_network_expects():
    """Somebody 10 m ahead on average, while others went 20 m from here."""
    points = jnp.array([8.0, 12.0])[:, None, None, None] * jnp.ones((2, 1, 3, 2))
    way = 20 * jnp.ones((1, 1, 3, 2))
    recall = Recall(way / 2, jnp.ones((1, 1, 1)), jnp.array([0.5]))
    last = jnp.array([[100.0, 0.0]])
    memory = remembered(recall, jnp.array([[0.0, 1.0]]), last)
    both, _ = memory.beside(last[:, None] + points, 0, 1)
    assert_allclose(both[2, 0], [[115.0, 15.0]] * 3)
    error = errors(points, recall, 15 * jnp.ones((1, 3, 2)))
    assert_allclose(error[:, 1], [0])


def test_each_part_of_a_distribution_has_the_whole_share():
    points = jnp.zeros((5, 2, 3, 2))
    future = jnp.arange(4.0)[:, None, None, None] * jnp.ones((4, 2, 3, 2))
    share = jnp.array([[0.1, 0.0], [0.2, 0.0], [0.1, 0.0], [0.2, 0.6]])
    memory = Remembered(future, share, jnp.zeros((4, 2)))
    beside = jax.jit(Remembered.beside, static_argnums=(2, 3))
    for part in range(2):
        both, weight = map(np.asarray, beside(memory, points, part, 2))
        assert both.shape == (7, 2, 3, 2)
        assert weight.shape == (2, 7)
        assert weight.sum(1) == pytest.approx(1)
        assert both[5:, 0, 0, 0].tolist() == [part, part + 2]
        assert weight[0, 5:].sum() == pytest.approx(0.6)
    # Somebody whose share has no point in this part has the network alone there.
    both, weight = map(np.asarray, beside(memory, points, 0, 2))
    assert weight[1, :5].sum() == pytest.approx(1)
