"""The baselines, and a forecaster of one's own beside those of the package."""

import dataclasses
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose

from neurosym_jax.forecasting.forecaster import Forecaster, Lengths, NoiseSpec
from neurosym_jax.forecasting.forecasters import (
    FORECASTERS,
    ConstantVelocitySampled,
    register_forecaster,
)
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.scene import make_scene

OBSERVED = np.random.default_rng(0).normal(size=(3, 8, 2)).cumsum(axis=1)
SCENE = make_scene(OBSERVED).replace(origin=None)


@dataclasses.dataclass(frozen=True)
class Damped(Lengths):
    rate: float = 0.5
    weights: tuple[float, float] = (1.0, 0.0)


class DampedForecaster(Forecaster):
    """Every agent's last step times a parameter."""

    Config = Damped

    @property
    def title(self):
        return f"x{self.config.rate}"

    def forecast(self, params, scene, noise):
        step = self.config.rate * params["scale"] * scene.displacement[:, -1]
        steps = jnp.arange(1, self.pred_len + 1)[:, None]
        return (scene.observed[:, -1, None] + steps * step[:, None])[None]


@mock.patch.dict(FORECASTERS)  # What is registered is forgotten afterwards.
def test_a_model_of_ones_own_forecasts_and_is_saved(tmp_path):
    register_forecaster("damped")(DampedForecaster)
    config = Damped(pred_len=4, weights=(2.0, 3.0))
    save_model(tmp_path / "own", Model(config, {"scale": np.float32(2)}, "zara1", "damped"))
    model = load_model(tmp_path / "own")
    assert (model.kind, model.config, model.dataset) == ("damped", config, "zara1")
    assert model.params["scale"].shape == ()
    last, step = OBSERVED[:, -1], OBSERVED[:, -1] - OBSERVED[:, -2]
    expected = last[:, None] + np.arange(1, 5)[:, None] * step[:, None]
    assert_allclose(predict(model, OBSERVED)[0], expected, atol=1e-5)
    assert model.name == "x0.5"
    assert model.weighting is None


def test_constant_velocity_repeats_the_last_step(tmp_path):
    save_model(tmp_path / "model", Model(Lengths(pred_len=5), {}, kind="constant_velocity"))
    model = load_model(tmp_path / "model")
    assert model.forecaster.noise == NoiseSpec()
    step = OBSERVED[:, -1] - OBSERVED[:, -2]
    wanted = OBSERVED[:, None, -1] + step[:, None] * np.arange(1, 6)[:, None]
    assert_allclose(predict(model, OBSERVED), wanted[None], atol=1e-5)


def test_sampled_heading():
    """The pace is kept, the path is straight, each agent's heading turns by its own angle."""
    forecaster = ConstantVelocitySampled(Lengths(pred_len=4))
    noise = np.random.default_rng(1).normal(size=(200, 3, 1)).astype(np.float32)
    forecast = np.asarray(jax.jit(forecaster.forecast)((), SCENE, noise))
    forecast = forecast - SCENE.observed[:, None, -1]
    step = (OBSERVED[:, -1] - OBSERVED[:, -2])[:, None]
    pace = np.linalg.norm(step, axis=-1) * np.arange(1, 5)
    assert_allclose(np.linalg.norm(forecast, axis=-1) / pace, 1, rtol=1e-4)
    turned = forecast[..., 1] * step[..., 0] - forecast[..., 0] * step[..., 1]
    angle = np.arctan2(turned, (forecast * step).sum(axis=-1))
    assert forecaster.noise == NoiseSpec(1, per_agent=True)
    # Angles beyond half a turn come back as smaller ones; none of these noises is that large.
    assert_allclose(np.degrees(angle), 25 * noise * np.ones(4), atol=1e-2)
