"""Encounter pooling: whom it hears, what alpha does to that, and what turning a scene does."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.models.encounter import _EncounterNetwork
from tests.networks import random_params

N, T, B = 6, 5, 8
RNG = np.random.default_rng(0)
OBSERVED = (RNG.normal(0, 2, (N, 1, 2)) + RNG.normal(0, 0.4, (N, T, 2)).cumsum(axis=1)).astype("f4")
ALPHA = RNG.uniform(0.1, 1, (N, N, T)).astype("f4")
ALL = np.ones(N, bool)
MODULE = _EncounterNetwork(12, B)


@pytest.fixture(scope="module")
def pool():
    """`(observed, valid, alpha) -> [N, B]` with random parameters."""
    params = random_params(MODULE, OBSERVED, ALL, ALPHA)
    apply = jax.jit(MODULE.apply)

    def pool(observed=OBSERVED, valid=ALL, alpha=ALPHA):
        return np.asarray(apply(params, observed, valid, alpha))

    return pool


def test_order_of_agents_is_the_order_of_results(pool):
    order = np.array([3, 0, 5, 1, 4, 2])
    permuted = pool(OBSERVED[order], ALL, ALPHA[np.ix_(order, order)])
    assert_allclose(permuted, pool()[order], atol=1e-6)
    assert np.ptp(pool(), axis=0).min() > 0.01


def test_somebody_alone_hears_nothing_and_gradients_are_finite(pool):
    assert_array_equal(pool(valid=np.arange(N) == 2)[2], 0)
    standing, params = np.zeros_like(OBSERVED), random_params(MODULE, OBSERVED, ALL, ALPHA)

    def total(observed, alpha, valid):
        return jnp.square(MODULE.apply(params, observed, valid, alpha)).sum()

    gradients = jax.jit(jax.grad(total, argnums=(0, 1)))
    for valid in (ALL, np.arange(N) == 2):
        for gradient in gradients(standing, ALPHA, valid):
            assert np.isfinite(gradient).all()


def test_alpha_is_of_the_pair_and_of_the_last_step(pool):
    changed = ALPHA.copy()
    changed[2, 4, :-1] = 9
    assert_array_equal(pool(alpha=changed), pool())
    changed[2, 4, -1] *= 5
    difference = np.abs(pool(alpha=changed) - pool()).max(axis=1)
    assert difference[2] > 1e-3
    assert_array_equal(difference[np.arange(N) != 2], 0)


def test_a_turned_scene_has_turned_pushes_and_the_same_numbers(pool):
    turn = np.array([[0.6, -0.8], [0.8, 0.6]], "f4")
    turned = pool(OBSERVED @ turn.T + np.float32(3))
    pushes = pool()[:, : B // 2].reshape(N, -1, 2) @ turn.T
    assert_allclose(turned[:, : B // 2].reshape(pushes.shape), pushes, atol=1e-4)
    assert_allclose(turned[:, B // 2 :], pool()[:, B // 2 :], atol=1e-4)
