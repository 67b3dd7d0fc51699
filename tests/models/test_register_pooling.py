"""What a plugin registers is a pooling like the package's own."""

import dataclasses
from typing import ClassVar
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import linen as nn

from neurosym_jax.configuration import from_json, to_json
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.models import Generator, Pooling, register_pooling
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS, pooling_names
from neurosym_jax.scene import make_scene
from neurosym_jax.training.network import named_generator

OBSERVED = np.random.default_rng(0).normal(0, 0.3, (4, 8, 2)).cumsum(axis=1)


class MeanNetwork(nn.Module):
    width: int

    @nn.compact
    def __call__(self, hidden, track, valid, alpha=None):
        share = valid / jnp.maximum(valid.sum(), 1)
        moved = track - track[:, :1]
        if alpha is not None:
            moved = jnp.einsum("ijt,jtc->itc", alpha, moved)
        both = jnp.concatenate([hidden, moved.reshape(len(hidden), -1)], axis=-1)
        return nn.Dense(self.width)(jnp.broadcast_to(share @ both, both.shape))


@dataclasses.dataclass(frozen=True)
class Mean(Pooling):
    title: ClassVar = "Mean"
    inputs: ClassVar = frozenset({"hidden", "track"})
    bottleneck_dim: int = 8

    def network(self, h_dim, *, obs_len, embedding_dim):
        return MeanNetwork(self.bottleneck_dim)


class Weighted(Mean):
    title: ClassVar = "Weighted mean"
    inputs: ClassVar = frozenset({"hidden", "track", "alpha"})


@pytest.fixture
def registered():
    with mock.patch.dict(POOLINGS):
        register_pooling("mean", Mean)
        register_pooling("weighted", Weighted)
        yield


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"pooling": "mean"}, "Mean"),
        ({"model": "neurosym", "pooling": "weighted"}, "Weighted mean, cnd"),
    ],
)
def test_it_is_chosen_saved_loaded_and_forecasts(tmp_path, options, name):
    config = named_generator(**options)
    assert from_json(GeneratorConfig, to_json(config)) == config
    arguments = (make_scene(OBSERVED), np.zeros(8), np.zeros((4, 4, 8)))
    params = jax.jit(Generator(config).init)(jax.random.key(0), *arguments)
    save_model(tmp_path / "model", Model(config, params))
    model = load_model(tmp_path / "model")
    assert model.name == name
    forecast = predict(model, OBSERVED, samples=2)
    np.testing.assert_array_equal(forecast, predict(Model(config, params), OBSERVED, samples=2))
    # It sees the whole observation, not the last position alone.
    params["params"]["pooling"]["Dense_0"]["kernel"] = (
        params["params"]["pooling"]["Dense_0"]["kernel"].at[config.encoder_h_dim :].mul(3)
    )
    assert np.abs(predict(Model(config, params), OBSERVED, samples=2) - forecast).max() > 1e-4


@pytest.mark.usefixtures("registered")
def test_what_is_refused():
    assert pooling_names(symbolic=False) == ("none", "pool_net", "social", "mean")
    assert pooling_names(symbolic=True) == ("as_described", "neurosym_ros", "encounter", "weighted")
    for pooling in ("weighted", "neurosym_ros"):
        with pytest.raises(InputError, match="sgan has none, pool_net, social, mean"):
            named_generator(pooling=pooling)
    with pytest.raises(InputError, match="another pooling 'mean' already"):
        register_pooling("mean", Weighted)
