"""Mixtures: their energy scores, and how often draws take what is remembered."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.evaluation.metrics import energy_score
from neurosym_jax.models.place.memory import Recall
from neurosym_jax.models.place.mixture import (
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
    recall = Recall(jnp.asarray(onward), jnp.asarray(weight, jnp.float32))
    return jnp.asarray(offsets), recall, rng.normal(0, 1, (3, 5, 2)).astype(np.float32)


@pytest.mark.parametrize("shares", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.2, 0.3]])
def test_energy_is_that_of_the_points_with_their_probabilities(drawn, shares):
    offsets, recall, truth = drawn
    given = energy(
        np.array([shares]),
        np.asarray(errors(offsets, recall, truth)),
        np.asarray(distances_apart(offsets, recall)),
    )
    memory = remembered(recall, jnp.array(shares), jnp.zeros((3, 2)))
    for person in range(3):
        share = np.asarray(memory.share[:, person])
        own = np.full(6, (1 - share.sum()) / 6)
        points = np.concatenate([offsets[:, person], memory.future[:, person]])
        scene = make_scene(np.zeros((1, 2, 2)), truth[person][None])
        wanted = energy_score(points[:, None], scene, np.concatenate([own, share]))
        assert given[person, 0] == pytest.approx(float(wanted), abs=2e-4)


def test_draws_take_what_is_remembered_as_often_as_its_share_says():
    draws = jnp.zeros((400, 2, 3, 2))
    future = jnp.arange(1.0, 4)[:, None, None, None] * jnp.ones((3, 2, 3, 2))
    share = jnp.array([[0.1, 0.0], [0.2, 0.0], [0.3, 0.5]])
    scene = make_scene(np.zeros((2, 2, 2)))
    memory = Remembered(future, share)
    mixed = memory.among(draws, scene, jax.random.key(0), 400)[:, :, 0, 0]
    for person in range(2):
        counts = np.bincount(np.asarray(mixed[:, person], int), minlength=4)
        assert counts[1:] == pytest.approx(400 * np.asarray(share[:, person]), abs=1)


def test_each_part_of_a_distribution_has_the_whole_share():
    points = jnp.zeros((5, 2, 3, 2))
    future = jnp.arange(4.0)[:, None, None, None] * jnp.ones((4, 2, 3, 2))
    share = jnp.array([[0.1, 0.0], [0.2, 0.0], [0.1, 0.0], [0.2, 0.6]])
    for part in range(2):
        both, weight = Remembered(future, share).beside(points, part, 2)
        assert both.shape == (7, 2, 3, 2)
        assert weight.shape == (2, 7)
        assert np.asarray(weight).sum(1) == pytest.approx(1)
        assert both[5:, 0, 0, 0].tolist() == [part, part + 2]
        assert weight[0, 5:].sum() == pytest.approx(0.6)
    # Somebody whose share has no point in this part has the network alone there.
    both, weight = Remembered(future, share).beside(points, 0, 2)
    assert weight[1, :5].sum() == pytest.approx(1)
