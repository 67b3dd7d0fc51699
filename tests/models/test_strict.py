"""JAX's strict modes, all at once, for forecasts, gradients and training of every family."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax import GeneratorConfig
from neurosym_jax.data import Windows
from neurosym_jax.models.anchors.network import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.forecaster import forecaster_of
from neurosym_jax.training.run import recipes_of
from tests.networks import random_model

SIZES = {"obs_len": 4, "pred_len": 3}
SMALL = {
    **SIZES,
    "embedding_dim": 4,
    "encoder_h_dim": 8,
    "decoder_h_dim": 8,
    "mlp_dim": 8,
}
POOLED = "bottleneck_dim=4,hidden_dim=16"
CONFIGS = {
    "no pooling": GeneratorConfig(**SMALL, noise_dim=2, pooling="none"),
    "SGAN": GeneratorConfig(**SMALL, noise_dim=2, pooling=f"pool_net,{POOLED}"),
    "social pooling": GeneratorConfig(**SMALL, noise_dim=2, pooling="social"),
    "NeuroSyM": GeneratorConfig(**SMALL, noise_dim=2, pooling=f"as_described,{POOLED}"),
    "NeuroSyM, soft": GeneratorConfig(
        **SMALL,
        noise_dim=2,
        pooling=f"as_described,{POOLED}",
        weighting="soft,learned=true",
    ),
    "NeuroSyM, every step": GeneratorConfig(
        **SMALL,
        noise_dim=2,
        pooling=f"as_described,{POOLED}",
        weighting="quantised,learned=true",
        pool_every_timestep=True,
    ),
    "NeuroSyM, robot package": GeneratorConfig(
        **SMALL, noise_dim=2, pooling=f"neurosym_ros,{POOLED}", weighting="shuffled"
    ),
    "anchor table": AnchorTableConfig(**SIZES, samples=3),
    "anchors": AnchorConfig(**SIZES, samples=3, hidden=8),
    "anchors, symbols": AnchorConfig(
        **SIZES, samples=3, hidden=8, symbols=True, weighting="cnd"
    ),
}


@pytest.fixture(autouse=True)
def strict():
    with (  # All that JAX can refuse.
        jax.numpy_rank_promotion("raise"),
        jax.numpy_dtype_promotion("strict"),
        jax.debug_key_reuse(True),
    ):
        yield


WALKS = (
    np.random.default_rng(0)
    .normal(0.2, 0.3, (3, 4, 2))
    .cumsum(axis=1)
    .astype(np.float32)
)


def noise_of(model, samples=2):
    dim = model.forecaster.noise.dim
    return jnp.asarray(np.ones((samples, dim)), jnp.float32) if dim else None


@pytest.mark.slow
@pytest.mark.parametrize("name", CONFIGS)
def test_initialisation_forecast_and_gradients(name):
    config, observed = CONFIGS[name], jnp.asarray(WALKS)
    model = random_model(config)
    jax.eval_shape(model.forecaster.init, jax.random.key(0))
    noise, params = noise_of(model), jax.tree.map(jnp.asarray, model.params)

    def total(params, observed):
        return nj.forecast(config, params, observed, noise).sum()

    gradients = jax.eval_shape(jax.grad(total, argnums=(0, 1)), params, observed)
    assert gradients[1].shape == observed.shape


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SGAN", "NeuroSyM, soft", "anchors", "anchor table"])
@pytest.mark.parametrize("schedule", ["cosine", "constant"])
def test_a_training_step(name, schedule):
    """Losses, gradients, clipping, Adam and the average; the adversarial ones too."""
    forecaster = forecaster_of(CONFIGS[name])
    recipe = dataclasses.replace(
        next(iter(recipes_of(type(forecaster)).values())),
        schedule=schedule, ema=0.9, batch_scenes=2, scale=0.1, jitter=0.01, steps=9,
    )  # fmt: skip
    if hasattr(recipe, "adversarial_weight"):
        recipe = dataclasses.replace(recipe, adversarial_weight=1.0, best_k=2)
    position = np.concatenate([WALKS, WALKS[:, :3] + 1], axis=1).astype(np.float64)
    windows = Windows(
        position, np.arange(3), np.array([0, 3]), np.zeros((1, 2), np.uint32), 4
    )
    advance = forecaster.rounds(windows, recipe, jax.random.key(1))
    state = jax.eval_shape(lambda: forecaster.init_state(recipe, jax.random.key(0)))
    after, metrics = jax.eval_shape(lambda state: advance(state, 0, 2), state)
    assert jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), after) == jax.tree.map(
        lambda leaf: (leaf.shape, leaf.dtype), state
    )
    assert {values.shape for values in metrics.values()} == {(2,)}


@pytest.mark.parametrize("name", ["NeuroSyM", "anchors"])
def test_prediction_on_the_host(name):
    forecast = nj.predict(random_model(CONFIGS[name]), WALKS, samples=3)
    assert forecast.shape == (3, 3, 3, 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["no pooling", "NeuroSyM", "anchors"])
def test_positions_of_half_the_bits_are_forecast_in_float32(name):
    config = CONFIGS[name]
    model = random_model(config)
    params = jax.tree.map(jnp.asarray, model.params)
    coarse = jnp.asarray(WALKS).astype(jnp.bfloat16)
    forecast = jax.jit(nj.forecast, static_argnums=0)
    forecasts = [
        forecast(config, params, observed, noise_of(model))
        for observed in (coarse, coarse.astype(jnp.float32))
    ]
    assert forecasts[0].dtype == jnp.float32
    np.testing.assert_array_equal(*forecasts)
