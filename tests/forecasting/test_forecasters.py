"""A forecaster of one's own beside those of the package."""

import dataclasses
from unittest import mock

import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import Forecaster, Lengths
from neurosym_jax.forecasting.forecasters import FORECASTERS, register_forecaster
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model, save_model

OBSERVED = np.random.default_rng(0).normal(size=(3, 8, 2))


@pytest.fixture
def registry():
    """What a test registers is forgotten afterwards."""
    with mock.patch.dict(FORECASTERS):
        yield


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


def test_a_model_of_ones_own_forecasts_and_is_saved(registry, tmp_path):
    register_forecaster("damped")(DampedForecaster)
    config = Damped(pred_len=4, weights=(2.0, 3.0))
    save_model(tmp_path / "own", Model(config, {"scale": np.float32(2)}, "zara1", "damped"))
    model = load_model(tmp_path / "own")
    assert (model.kind, model.config, model.dataset) == ("damped", config, "zara1")
    assert model.params["scale"].shape == ()
    last, step = OBSERVED[:, -1], OBSERVED[:, -1] - OBSERVED[:, -2]
    expected = last[:, None] + np.arange(1, 5)[:, None] * step[:, None]
    np.testing.assert_allclose(predict(model, OBSERVED)[0], expected, atol=1e-5)
    assert model.name == "x0.5"
    assert model.weighting is None


@pytest.mark.parametrize("kind", ["constant_velocity", "constant_velocity_sampled"])
def test_the_baselines_are_models_without_parameters(tmp_path, kind):
    save_model(tmp_path / "model", Model(Lengths(pred_len=5), {}, kind=kind))
    model = load_model(tmp_path / "model")
    assert predict(model, OBSERVED, samples=3).shape[1:] == (3, 5, 2)
    assert model.name.startswith("constant velocity")


def test_refusals(registry):
    with pytest.raises(InputError, match="unknown forecaster 'nobody'"):
        _ = Model(Lengths(), {}, kind="nobody").forecaster
    with pytest.raises(InputError, match="another forecaster 'generator' already"):
        register_forecaster("generator", DampedForecaster)
    with pytest.raises(InputError, match="pred_len must be"):
        Lengths(pred_len=0)
