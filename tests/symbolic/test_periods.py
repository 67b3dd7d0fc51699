"""Thresholds in seconds and m/s mean the same at every period, in weightings, events and scores."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.models.forecast import forecast
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.scene import make_scene
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import symbolic_events
from neurosym_jax.symbolic.weighting import (
    Quantised,
    Soft,
    initial_parameters,
    make_weighting,
    register_weighting,
)
from tests.networks import random_model
from tests.repository import exhaustive

PERIODS = (0.1, 0.2, 0.4)
pytestmark = pytest.mark.usefixtures("allowing")


@pytest.fixture
def allowing():
    with jax.numpy_rank_promotion("allow"):
        yield


def walkers(period, seconds=4.8):
    """Three people [3, T, 2] on straight ways at 0.1, 0.4 and 1.2 m/s, a step each `period`."""
    time = period * np.arange(round(seconds / period) + 1)[:, None]
    starts, speeds = [[0, 0], [5, 0.5], [-4, 1]], [[0.1, 0], [-0.4, 0], [1.2, 0.1]]
    return np.array(starts)[:, None] + time * np.array(speeds)[:, None]


@pytest.mark.parametrize(
    "text",
    [exhaustive("quantised"), "quantised,speed=0.3", "cnd,speed=0.3,side_speed=0.3"],
)
def test_weights_of_straight_walks_do_not_hang_on_the_period(text):
    alphas = {}
    for period in PERIODS:
        alpha = np.asarray(
            jax.jit(make_weighting(text, period=period))(walkers(period))
        )
        alphas[period] = alpha[..., -1]
    np.testing.assert_array_equal(alphas[0.1], alphas[0.4])
    np.testing.assert_array_equal(alphas[0.2], alphas[0.4])
    # At another period than the recording's the slow walker stands, or the fast one
    # does not.
    wrong = np.asarray(jax.jit(make_weighting(text, period=0.4))(walkers(0.1)))[..., -1]
    assert (wrong != alphas[0.1]).any()


@pytest.mark.slow
def test_a_soft_and_a_learned_threshold_are_speeds_too():
    for weighting in (Soft(), Soft(learned=True), Quantised(learned=True)):
        parameters = initial_parameters(weighting)
        alpha = jax.jit(weighting.alpha, static_argnames="period")
        alphas = [
            np.asarray(alpha(parameters, walkers(period), period=period))[..., -1]
            for period in (0.2, 0.4)
        ]
        np.testing.assert_allclose(*alphas, atol=3e-3)
    table = initial_parameters(Quantised(learned=True))
    assert table["log_speed"] == pytest.approx(math.log(0.125))


@pytest.mark.slow
def test_a_model_weights_by_its_own_period():
    """A forecast with alpha at the model's period is that of the model, of other alpha is not."""
    forecasts = {}
    for period in (0.4, 0.1):
        config = GeneratorConfig(
            pooling="as_described", weighting="quantised", period=period
        )
        config = dataclasses.replace(config, obs_len=8, pred_len=3)
        params = random_model(config, std=0.5).params
        observed, noise = (
            jnp.asarray(walkers(0.1)[:, :8], jnp.float32),
            np.ones((2, 8), np.float32),
        )
        forecasts[period] = np.asarray(forecast(config, params, observed, noise))
        alpha = jax.jit(make_weighting("quantised", period=period))(observed)
        stated = np.asarray(forecast(config, params, observed, noise, alpha))
        np.testing.assert_allclose(forecasts[period], stated, atol=1e-6)
    assert np.abs(forecasts[0.1] - forecasts[0.4]).max() > 1e-4


@pytest.mark.slow
def test_events_of_a_resampled_recording_have_the_same_times():
    """Half the period, the same seconds: later by less than the two steps that a state may need."""
    draw = np.random.default_rng(3)
    compared = np.zeros(len(EVENTS))
    for _ in range(40):
        starts, velocity = draw.uniform(-3, 3, (2, 2)), draw.normal(0, 1, (2, 2))
        times = []
        for period in (0.4, 0.2):
            steps = period * np.arange(round(4.8 / period) + 1)[:, None]
            paths = starts[:, None] + steps * velocity[:, None]
            samples, observed = paths[None, :, 1:], paths[:, :1]
            events = symbolic_events(samples, observed, period=period, smoothing=0.0)
            times.append(np.asarray(events.seconds[:, 0, 1, 1]))
        coarse, fine = times
        seen = np.isfinite(coarse)
        compared += seen
        assert (fine[seen] <= coarse[seen] + 1e-5).all()
        assert (coarse[seen] - fine[seen] < 0.8 + 1e-5).all()
    assert (compared > 0).all()


def test_scores_of_symbols_are_by_the_scenes_period():
    """Two people approach at 0.4 m/s; forecasts of them standing are wrong at every period."""
    for period in PERIODS:
        path = walkers(period)[:2] - [0, 0.25]
        path[0], path[1, :, 1] = [0, 0], 0
        path[0, :, 0] = 0.4 * period * np.arange(path.shape[1])
        scene = make_scene(path[:, :8], path[:, 8:], period=period)
        standing = jnp.repeat(
            jnp.asarray(scene.observed)[None, :, -1:], path.shape[1] - 8, axis=2
        )
        score_of = jax.jit(METRICS["state_log"].compute)
        score, pairs = score_of(standing, scene)
        assert pairs == 2
        # The true state, - - 0 0, has none of one sample: p = (0 + 1 / 81) / (1 + 1).
        assert float(score) == pytest.approx(math.log(2 * 81), rel=1e-5)
        walking = jnp.asarray(scene.future)[None]
        right = score_of(walking, scene)[0]
        assert float(right) == pytest.approx(-math.log((1 + 1 / 81) / 2), rel=1e-5)


@pytest.mark.slow
def test_a_function_gets_the_period_if_it_asks_for_it():
    @register_weighting("pace")
    def pace(positions, valid, period):
        step = jnp.linalg.norm(positions[:, -1] - positions[:, -2], axis=-1)
        return (
            jnp.broadcast_to((step / period)[:, None], (3, 3))[..., None]
            * jnp.ones(positions.shape[1])[None, None]
        )

    for period in PERIODS:
        alpha = np.asarray(make_weighting("pace", period=period)(walkers(period)))
        np.testing.assert_allclose(
            alpha[:, :, -1][[0, 1, 2], [1, 2, 0]], [0.1, 0.4, 1.204], rtol=1e-3
        )
