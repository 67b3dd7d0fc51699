import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.scene import make_scene, pad_scene
from neurosym_jax.symbolic.forecast import symbolic_forecast
from neurosym_jax.symbolic.qtc import qtc_c1
from neurosym_jax.training.losses import (
    LossOptions,
    adversarial_loss,
    distance_errors,
    safe_norm,
    squared_displacement_errors,
    symbol_log_scores,
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


def test_squared_displacement_errors_by_hand(scene):
    forecast, truth, valid = scene
    wanted = [((forecast[k, :3] - truth[:3]) ** 2).sum() / (3 * T) for k in range(K)]
    errors = squared_displacement_errors(jnp.array(forecast), jnp.array(truth), valid)
    assert errors.shape == (1, K)
    np.testing.assert_allclose(errors[0], wanted, rtol=1e-5)


def test_distance_errors_by_hand(scene):
    forecast, truth, valid = scene
    distance = np.linalg.norm(forecast[:, :3] - truth[:3], axis=-1)
    errors = distance_errors(jnp.array(forecast), jnp.array(truth), valid)
    np.testing.assert_allclose(errors[0], distance.mean(axis=(1, 2)), rtol=1e-5)
    np.testing.assert_allclose(errors[1], distance[:, :, -1].mean(axis=1), rtol=1e-5)


@pytest.mark.parametrize("criterion", [squared_displacement_errors, distance_errors])
def test_padding_and_empty_scenes_add_nothing(scene, criterion):
    forecast, truth, valid = (jnp.array(part) for part in scene)
    wild = forecast.at[:, 3].set(1e6)
    np.testing.assert_array_equal(criterion(forecast, truth, valid), criterion(wild, truth, valid))
    gradient = jax.grad(lambda f: criterion(f, truth, valid).sum())(forecast)
    assert not gradient[:, 3].any()
    nobody = jnp.zeros(N, bool)
    assert not np.asarray(criterion(forecast, truth, nobody)).any()
    assert not np.asarray(jax.grad(lambda f: criterion(f, truth, nobody).sum())(forecast)).any()


def test_a_perfect_forecast_has_a_finite_gradient(scene):
    _, truth, valid = (jnp.array(part) for part in scene)
    gradient = jax.grad(lambda f: distance_errors(f, truth, valid).sum())(truth[None])
    assert not np.asarray(gradient).any()
    with jax.debug_nans(False):
        assert np.isnan(safe_norm(jnp.array([np.nan, 4.0])))
    assert safe_norm(jnp.array([3.0, 4.0])) == 5
    np.testing.assert_allclose(jax.grad(safe_norm)(jnp.array([3.0, 4.0])), [0.6, 0.8], rtol=1e-6)


def encounters():
    """A scene of people who walk with a wobble, what they do next, and forecasts of it."""
    rng = np.random.default_rng(1)
    walk = np.cumsum(rng.normal(0.3, 0.2, (N, 4 + T, 2)), axis=1)
    scene = make_scene(walk[:, :4], walk[:, 4:])
    steps = rng.normal(0.3, 0.2, (K, N, T, 2))
    return scene, scene.observed[:, -1:] + np.cumsum(steps, axis=2).astype(np.float32)


def test_cold_symbols_are_scored_as_a_symbolic_forecast_says():
    scene, samples = encounters()
    options = LossOptions(symbols_temperature=1e-5, symbols_reach=1e3)
    scores, there = symbol_log_scores(options, scene, samples)
    assert scores.shape == (N * (N - 1) // 2, T, 4)
    assert there.all()
    # The threshold in metres a second, of steps of 0.4 s.
    said = symbolic_forecast(samples, scene.observed, speed=0.05 / 0.4).symbols
    truth = np.concatenate([scene.observed[:, -1:], scene.known_future], axis=1)
    for pair, (i, j) in enumerate(zip(*np.triu_indices(N, 1))):
        states = np.asarray(
            qtc_c1(truth[i], truth[j], quantisation_factor=0.05, side_quantisation_factor=0.05)
        )
        wanted = np.take_along_axis(np.asarray(said[i, j]), states[..., None] + 1, axis=-1)
        np.testing.assert_allclose(scores[pair], -np.log(wanted[..., 0]), rtol=1e-4)


def test_whom_the_symbols_are_of():
    scene, samples = encounters()
    i, j = np.triu_indices(N, 1)
    apart = np.linalg.norm(scene.observed[i, -1] - scene.observed[j, -1], axis=-1)
    options = LossOptions(symbols_reach=float(np.median(apart)))
    scores, there = symbol_log_scores(options, scene, samples)
    assert list(there) == list(apart <= np.median(apart))
    assert 0 < there.sum() < len(there)
    wild = np.concatenate([samples, np.full((K, 1, T, 2), 1e6, np.float32)], axis=1)
    more, whom = symbol_log_scores(options, pad_scene(scene, N + 1), wild)
    assert whom.sum() == there.sum()
    np.testing.assert_allclose(more[whom], scores[there], rtol=1e-6)


def test_symbols_teach_even_where_everybody_stands_on_one_spot():
    scene, samples = encounters()

    def loss(samples):
        return symbol_log_scores(LossOptions(), scene, samples)[0].mean()

    before, gradient = jax.value_and_grad(loss)(samples)
    assert loss(samples - 0.02 * gradient / jnp.abs(gradient).max()) < before
    assert np.isfinite(jax.grad(loss)(jnp.zeros_like(samples))).all()
