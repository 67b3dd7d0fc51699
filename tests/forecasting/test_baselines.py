import jax
import numpy as np
from numpy.testing import assert_allclose

from neurosym_jax.forecasting.baselines import (
    HEADING_STD,
    ConstantVelocity,
    ConstantVelocitySampled,
)
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.noise import NoiseSpec
from neurosym_jax.scene import make_scene

OBSERVED = np.random.default_rng(0).normal(size=(3, 8, 2)).cumsum(axis=1)
SCENE = make_scene(OBSERVED).replace(origin=None)


def test_constant_velocity_repeats_the_last_step():
    forecaster = ConstantVelocity(Lengths(pred_len=5))
    assert forecaster.noise == NoiseSpec()
    forecast = forecaster.forecast((), SCENE, np.zeros((1, 0)))
    step = OBSERVED[:, -1] - OBSERVED[:, -2]
    wanted = SCENE.observed[:, None, -1] + step[:, None] * np.arange(1, 6)[:, None]
    assert_allclose(forecast, wanted[None], atol=1e-5)


def test_sampled_heading():
    forecaster = ConstantVelocitySampled(Lengths(pred_len=4))
    noise = np.random.default_rng(1).normal(size=(20_000, 3, 1)).astype(np.float32)
    forecast = (
        np.asarray(jax.jit(forecaster.forecast)((), SCENE, noise)) - SCENE.observed[:, None, -1]
    )
    step = (OBSERVED[:, -1] - OBSERVED[:, -2])[:, None]
    # The pace is kept, the path is straight, the heading varies by 25 degrees.
    pace = np.linalg.norm(step, axis=-1) * np.arange(1, 5)
    assert_allclose(np.linalg.norm(forecast, axis=-1) / pace, 1, rtol=1e-4)
    turned = forecast[..., 1] * step[..., 0] - forecast[..., 0] * step[..., 1]
    along = (forecast * step).sum(axis=-1)
    angle = np.arctan2(turned, along)
    assert_allclose(angle, angle[..., :1] * np.ones(4), atol=1e-4)
    assert np.degrees(HEADING_STD) == 25
    assert_allclose(np.degrees(angle[..., 0].std(axis=0)), 25, rtol=0.02)
    assert_allclose(angle[..., 0].mean(axis=0), 0, atol=0.02)
    # Each agent turns by its own.
    assert np.abs(np.corrcoef(angle[..., 0].T) - np.eye(3)).max() < 0.03
    assert_allclose(angle[..., 0], HEADING_STD * noise[..., 0], atol=1e-4)
