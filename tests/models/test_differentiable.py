"""`forecast` is `predict`, and its gradients are those of finite differences."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.errors import InputError
from neurosym_jax.models.forecast import forecast, predict
from neurosym_jax.models.forecaster import NoiseSpec, draw_noise, with_weighting
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.scene import scene_identity
from neurosym_jax.symbolic import Soft
from tests.networks import random_model

LENGTHS = {"obs_len": 5, "pred_len": 3}
OBSERVED = 5.0 + np.random.default_rng(0).normal(0.3, 0.15, (3, 5, 2)).cumsum(axis=1)


FORECAST = jax.jit(forecast, static_argnums=0)


def model_of(weighting):
    pooling = "as_described" if weighting else "pool_net"
    config = GeneratorConfig(
        pooling=f"{pooling},hidden_dim=16", weighting=weighting, **LENGTHS
    )
    model = random_model(config, std=0.3)
    assert ("weighting" in model.params) == bool(weighting)
    return dataclasses.replace(
        model, params=with_weighting(model.params, config.weighting)
    )


@pytest.fixture(scope="module")
def soft():
    return model_of(Soft(learned=True))


NOISE = draw_noise(NoiseSpec(8), 0, scene_identity("", 0)[None], 4, 1)[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize("weighting", [None, Soft(learned=True)])
def test_it_is_predict_and_padding_and_a_batch_change_nothing(weighting):
    model = model_of(weighting)
    network = model.config, model.params
    forecast = FORECAST(*network, OBSERVED, NOISE)
    assert_allclose(forecast, predict(model, OBSERVED, samples=4), atol=1e-5)
    padded, valid = (
        np.concatenate([OBSERVED, np.full((2, 5, 2), 1e6)]),
        np.arange(5) < 3,
    )
    assert_allclose(
        FORECAST(*network, padded, NOISE, valid=valid)[:, :3], forecast, atol=1e-5
    )
    pair = np.stack([OBSERVED, OBSERVED + 2.0])
    each = jax.vmap(lambda observed: FORECAST(*network, observed, NOISE))
    batch = jax.jit(each)(pair)
    assert_allclose(batch, np.stack([forecast, forecast + 2.0]), atol=1e-5)


def test_predict_in_a_trace_names_the_function_for_it(soft):
    with pytest.raises(InputError, match="under jit, vmap and grad call nj"):
        jax.jit(lambda observed: predict(soft, observed))(OBSERVED)


@pytest.mark.slow
@pytest.mark.parametrize("given", [False, True], ids=["own", "given"])
def test_gradients(soft, given):
    """Gradients by all parameters (or by a given alpha), positions and noise."""
    rng = np.random.default_rng(2)
    with jax.enable_x64(True):
        params = jax.tree.map(jnp.float64, soft.params)
        first = rng.uniform(0.2, 1, (3, 3, 5)) if given else params
        arguments = jax.tree.map(jnp.float64, (first, OBSERVED, NOISE))
        along = jax.tree.map(
            lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), arguments
        )

        def value(step):
            first, observed, noise = jax.tree.map(
                lambda a, b: a + step * b, arguments, along
            )
            how = (
                (params, observed, noise, first) if given else (first, observed, noise)
            )
            return (FORECAST(soft.config, *how) ** 2).mean()

        value = jax.jit(value)
        slope = jax.jit(jax.grad(value))(0.0)
        assert abs(slope) > 1e-4
        assert_allclose(slope, (value(1e-6) - value(-1e-6)) / 2e-6, rtol=1e-4)
