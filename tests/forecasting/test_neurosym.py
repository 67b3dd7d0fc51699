"""NeuroSyM through everything a model goes through: batches, folders, evaluation, figures."""

import dataclasses
import functools
import json
from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.commands.evaluate import Options, run
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.batched import forecast_batch, unpacked
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.forecasting.noise import draw_noise
from neurosym_jax.models import Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.scene import make_scene, pad_scene

CONFIGS = {
    name: GeneratorConfig(pooling=f"{name},hidden_dim=32", weighting=weighting, pred_len=4)
    for name, weighting in (("as_described", "cnd"), ("neurosym_ros", "cnd_shipped"))
}
# Symbols of predicted steps, too.
CONFIGS["every_step"] = dataclasses.replace(
    CONFIGS["as_described"], pool_every_timestep=True, weighting="quantised"
)
EACH = pytest.mark.parametrize("name", list(CONFIGS))
K = 3


def random_params(config: GeneratorConfig) -> dict[str, Any]:
    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    pairs = (1,) if "alpha_rows" in config.pooling.inputs else (1, 1)
    alpha = np.zeros((*pairs, config.obs_len))
    noise = np.zeros(config.noise_dim)
    shapes = jax.eval_shape(
        lambda key: Generator(config).init(key, scene, noise, alpha, lambda *_: alpha),
        jax.random.key(0),
    )
    rng = np.random.default_rng(1)
    return jax.tree.map(
        lambda leaf: rng.normal(0, leaf.shape[0] ** -0.5, leaf.shape).astype(np.float32), shapes
    )


@functools.cache
def random_model(name: str, weighting: str | None = None) -> Model:
    config = CONFIGS[name]
    if weighting is not None:
        config = GeneratorConfig(**{**vars(config), "weighting": weighting})
    return Model(config, random_params(config))


@functools.cache
def walks(agents: int = 5) -> np.ndarray:
    """People on a grid of 1/8 m, so that symbols of 0 occur, one of whom stands still."""
    rng = np.random.default_rng(3)
    positions = rng.integers(-16, 17, (agents, 1, 2)) + rng.integers(-2, 3, (agents, 8, 2)).cumsum(
        1
    )
    positions[-1] = positions[-1, :1]
    return positions / 8


def by_batch(model: Model, observed: np.ndarray, slots: int, batch: int = 1) -> np.ndarray:
    """`[K, N, pred_len, 2]` relative to the origin, as the evaluation forecasts."""
    scene = pad_scene(make_scene(observed, recording="r"), slots).replace(origin=None)
    scenes = jax.tree.map(lambda array: np.stack([array] * batch), scene)
    noise = draw_noise(model.forecaster.noise, 0, scenes.identity, K, slots)
    futures, _ = forecast_batch(model.forecaster, model.params, scenes, noise)
    return unpacked(futures, scenes.valid)[:, -1, : len(observed)]


@EACH
def test_padding_batch_order_and_place(name):
    model, observed = random_model(name), walks()
    plain = by_batch(model, observed, 5)
    assert plain.shape == (K, 5, 4, 2)
    assert np.abs(plain[0] - plain[1]).max() > 1e-3
    assert_allclose(by_batch(model, observed, 16, batch=3), plain, rtol=0, atol=1e-5)
    order = np.array([3, 0, 4, 2, 1])
    assert_allclose(by_batch(model, observed[order], 5), plain[:, order], rtol=0, atol=1e-5)
    utm = np.array([4e5, 5e6])
    away = predict(model, observed + utm, samples=K, recording="r") - utm
    assert_allclose(away - make_scene(observed).origin, plain, rtol=0, atol=1e-5)


def test_the_earlier_release_forecasts_nothing_but_parity_cases(tmp_path):
    config = GeneratorConfig(pooling="neurosym_ijcnn", pred_len=4)
    model = Model(config, random_params(config))
    with pytest.raises(InputError, match="does not weight pairs"):
        predict(model, walks())
    save_model(tmp_path / "m", model)
    assert load_model(tmp_path / "m").config == config
    with pytest.raises(InputError, match="m: neurosym_ijcnn does not weight pairs"):
        run(Options(checkpoint=(str(tmp_path / "m"),), json=tmp_path / "r"))


@EACH
def test_a_folder_names_variant_and_weighting(tmp_path, sign, name):
    folder, model = tmp_path / "m", random_model(name)
    save_model(folder, model)
    fields = json.loads((folder / "config.json").read_text())["config"]
    pooling, weighting = model.config.pooling, model.config.weighting
    assert fields["pooling"] == {"kind": POOLINGS.name_of(pooling), **vars(pooling)}
    assert fields["weighting"] == {"kind": weighting.title, **vars(weighting)}
    loaded = load_model(folder)
    assert loaded.config == model.config
    jax.tree.map(assert_array_equal, loaded.params, model.params)
    other = "neurosym_ros" if name == "as_described" else "as_described"
    for broken, message in (
        ({"weighting": {"kind": "cnd", "tabel": "cnd"}}, "unknown field 'tabel'"),
        ({"pooling": "pool_net"}, "has no symbols for a weighting"),
        ({"pooling": f"{other},hidden_dim=31"}, "describes another network"),
    ):
        sign(folder, lambda all, broken=broken: all.update(config={**fields, **broken}))
        with pytest.raises(InputError, match=message):
            load_model(folder)
