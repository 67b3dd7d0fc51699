import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.training.losses import (
    adversarial_loss,
    distance_errors,
    safe_norm,
    squared_displacement_errors,
)

K, N, T = 5, 4, 3


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(0)
    valid = np.array([True, True, True, False])
    return rng.normal(size=(K, N, T, 2)), rng.normal(size=(N, T, 2)), valid


def test_adversarial_loss_is_binary_cross_entropy():
    scores, label = np.array([-3.0, 0.0, 0.5, 40.0]), 0.9
    probability = 1 / (1 + np.exp(-scores[:3]))
    wanted = -(label * np.log(probability) + (1 - label) * np.log(1 - probability))
    valid = np.array([True, True, True, False])
    assert adversarial_loss(scores, label, valid) == pytest.approx(wanted.mean(), rel=1e-6)
    assert adversarial_loss(scores[3:], 1.2, valid[:1]) == pytest.approx(40 - 48, rel=1e-6)


def test_errors_by_hand(scene):
    forecast, truth, valid = scene
    apart = np.linalg.norm(forecast[:, :3] - truth[:3], axis=-1)
    ade, fde = distance_errors(jnp.array(forecast), jnp.array(truth), valid)
    np.testing.assert_allclose(ade, apart.mean(axis=(1, 2)), rtol=1e-5)
    np.testing.assert_allclose(fde, apart[:, :, -1].mean(axis=1), rtol=1e-5)
    (squared,) = squared_displacement_errors(jnp.array(forecast), jnp.array(truth), valid)
    np.testing.assert_allclose(squared, (apart**2).mean(axis=(1, 2)), rtol=1e-5)


def test_a_perfect_forecast_has_a_finite_gradient(scene):
    _, truth, valid = (jnp.array(part) for part in scene)
    gradient = jax.grad(lambda f: distance_errors(f, truth, valid).sum())(truth[None])
    assert not np.asarray(gradient).any()
    with jax.debug_nans(False):
        assert np.isnan(safe_norm(jnp.array([np.nan, 4.0])))
    assert safe_norm(jnp.array([3.0, 4.0])) == 5
    np.testing.assert_allclose(jax.grad(safe_norm)(jnp.array([3.0, 4.0])), [0.6, 0.8], rtol=1e-6)
