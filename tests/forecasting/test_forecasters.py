"""A forecaster of one's own beside those of the package, whose errors `test_scoring` has."""

import dataclasses
from unittest import mock

import jax.numpy as jnp
import numpy as np
from numpy.testing import assert_allclose

from neurosym_jax.forecasting.forecaster import (
    FORECASTERS,
    Forecaster,
    Lengths,
    register_forecaster,
)
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model, save_model

OBSERVED = np.random.default_rng(0).normal(0.3, 0.15, size=(3, 8, 2)).cumsum(axis=1)


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
    assert (model.family, model.config, model.dataset) == ("damped", config, "zara1")
    assert model.params["scale"].shape == ()
    last, step = OBSERVED[:, -1], OBSERVED[:, -1] - OBSERVED[:, -2]
    expected = last[:, None] + np.arange(1, 5)[:, None] * step[:, None]
    assert_allclose(predict(model, OBSERVED)[0], expected, atol=1e-5)
    assert model.name == "x0.5"
    assert model.weighting is None
