"""What must not change a forecast: padding, order, batches, the map's origin, the number type."""

import functools
from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.batched import forecast_batch, predict_scenes, unpacked
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.noise import draw_noise
from neurosym_jax.models import Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import make_scene, pad_scene
from neurosym_jax.symbolic import Quantised

UTM = np.array([4e5, 5e6])
LENGTHS: dict[str, Any] = {"obs_len": 4, "pred_len": 4, "pooling": "pool_net,hidden_dim=32"}
CONFIGS = {
    "pool_net": GeneratorConfig(**LENGTHS),
    "none": GeneratorConfig(**{**LENGTHS, "pooling": "none"}),
    "social": GeneratorConfig(**{**LENGTHS, "pooling": "social,grid_size=4"}),
    "every step": GeneratorConfig(pool_every_timestep=True, **LENGTHS),
    "noise of agents": GeneratorConfig(noise_mix_type="ped", **LENGTHS),
    "uniform noise": GeneratorConfig(noise_type="uniform", **LENGTHS),
}
EACH = pytest.mark.parametrize("name", list(CONFIGS))
K = 3


@functools.cache
def random_model(name: str) -> Model:
    """Weights of the size that torch would draw, the same for every test."""
    config = CONFIGS[name]
    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    shapes = jax.eval_shape(
        Generator(config).init, jax.random.key(0), scene, np.zeros(config.noise_dim)
    )
    rng = np.random.default_rng(1)
    params = jax.tree.map(
        lambda leaf: rng.normal(0, leaf.shape[0] ** -0.5, leaf.shape).astype(np.float32), shapes
    )
    return Model(config, params)


@functools.cache
def crowd(recording: str = "crowd", shift: tuple[float, float] = (0.0, 0.0)) -> Tracks:
    """Fourteen frames of up to nine people who come and go; coordinates have 4 decimals."""
    rng = np.random.default_rng(len(recording))
    walks = rng.uniform(-2, 2, (9, 1, 2)) + rng.normal(0, 0.3, (9, 14, 2)).cumsum(axis=1)
    # On a coarse grid, so that neighbours lie on the social grid's lines.
    walks[:4] = np.round(walks[:4] * 4) / 4
    walks = np.round(walks, 4) + np.array(shift)
    first, last = rng.integers(0, 4, 9), rng.integers(9, 15, 9)
    first[0], last[0] = 0, 14
    present = (np.arange(14) >= first[:, None]) & (np.arange(14) < last[:, None])
    agent, frame = np.nonzero(present)
    return make_tracks(recording, frame * 0.4, agent, walks[agent, frame])


def cut(*recordings: Tracks) -> Windows:
    return cut_windows(recordings, 4, 4, min_agents=1)


def forecasts(model: Model, windows: Windows, slots: int = 256, samples: int = K):
    """By the evaluation's own path: scene identity to `[k, N, pred_len, 2]` of its agents."""
    found = {}
    for batch in make_batches(windows, slots):
        scenes = batch.scene.bare()
        noise = draw_noise(
            model.forecaster.noise, 0, scenes.identity, samples, scenes.valid.shape[1]
        )
        futures, _ = forecast_batch(model.forecaster, model.params, scenes, noise)
        forecast = unpacked(futures, scenes.valid)
        assert np.isfinite(forecast).all()
        for row, number in enumerate(batch.index):
            if number >= 0:
                agents = windows.sizes[number]
                found[tuple(windows.identity[number])] = forecast[:, row, :agents]
    assert len(found) == windows.scenes
    return found


def assert_same(found, wanted, atol=1e-5):
    assert found.keys() == wanted.keys()
    for identity, forecast in wanted.items():
        assert_allclose(found[identity], forecast, rtol=0, atol=atol)


@functools.cache
def reference(name: str):
    windows = cut(crowd())
    assert {windows.sizes.min(), windows.sizes.max()} == {1, 6}  # Two buckets.
    return forecasts(random_model(name), windows)


@EACH
def test_order_of_scenes_and_company(name):
    """Another recording before it puts every scene elsewhere in its batch."""
    windows = cut(crowd("others"), crowd())
    found = forecasts(random_model(name), windows)
    mine = {identity: found[identity] for identity in reference(name)}
    assert_same(mine, reference(name))


@pytest.mark.parametrize("name", ["pool_net", "every step", "noise of agents"])
def test_predict_is_the_evaluation_of_one_scene(name):
    windows = cut(crowd())
    model = random_model(name)
    for number in (0, windows.scenes - 1):
        part = slice(*windows.bounds[number : number + 2])
        observed = windows.position[part, :4]
        identity = windows.identity[number]
        arguments = {"samples": K, "recording": "crowd", "frame": int(identity[1])}
        forecast = predict(model, observed, **arguments)
        origin = make_scene(observed).origin
        assert forecast.dtype == np.float64
        wanted = reference(name)[tuple(identity)]
        assert_allclose(forecast - origin, wanted, rtol=0, atol=1e-5)
        away = predict(model, observed + UTM, **arguments)
        assert_allclose(away - UTM - origin, wanted, rtol=0, atol=1e-5)


@pytest.mark.parametrize("name", ["pool_net", "every step", "noise of agents"])
def test_many_scenes_are_forecast_as_each_alone(name):
    windows, model = cut(crowd(shift=tuple(UTM))), random_model(name)
    scenes = [part[:, :4] for part in np.split(windows.position, windows.bounds[1:-1])]
    assert len({len(scene) for scene in scenes}) > 2
    frames = windows.identity[:, 1].astype(int)
    found = predict_scenes(model, scenes, samples=K, seed=5, recording="crowd", frames=frames)
    assert len(found) == len(scenes)
    for forecast, scene, frame in zip(found, scenes, frames):
        alone = predict(model, scene, samples=K, seed=5, recording="crowd", frame=frame)
        assert_allclose(forecast, alone, rtol=0, atol=1e-5)
    # By default they are those of the first frames.
    found, alone = predict_scenes(model, scenes[:2], samples=K), scenes[1]
    assert_allclose(found[1], predict(model, alone, samples=K, frame=1), atol=1e-5)


def test_what_many_scenes_refuse():
    model, good = random_model("none"), np.zeros((1, 4, 2))
    assert predict_scenes(model, []) == []
    for scenes, frames, message in (
        ([good, np.zeros((1, 5, 2))], None, r"observed\[1\] has 5 steps; the model observes 4"),
        ([good, np.full((1, 4, 2), np.inf)], None, r"observed\[1\]: agent 0, step 0"),
        ([good, good[:0]], None, r"observed\[1\]: a scene needs at least one agent"),
        ([good, good], [0], "1 frames are given for 2 scenes"),
    ):
        with pytest.raises(InputError, match=message):
            predict_scenes(model, scenes, frames=frames)


@pytest.mark.parametrize("name", ["none", "social", "every step", "noise of agents"])
def test_padding_and_permutation(name):
    """Order of agents: the noise of an agent goes with its slot, so only global noise permutes."""
    model = random_model(name)
    observed = cut(crowd()).position[:3, :4]
    order = np.array([2, 0, 1])

    def forecast(positions, slots):
        scene = pad_scene(make_scene(positions, recording="r"), slots).replace(origin=None)
        scenes = jax.tree.map(lambda array: array[None], scene)
        noise = draw_noise(model.forecaster.noise, 0, scenes.identity, K, slots)
        return forecast_batch(model.forecaster, model.params, scenes, noise)[0]

    plain = forecast(observed, 3)
    assert_allclose(forecast(observed, 64), plain, rtol=0, atol=1e-5)
    if not model.forecaster.noise.per_agent:
        assert_allclose(forecast(observed[order], 3), plain[:, order], rtol=0, atol=1e-5)


def test_seed_and_identity_act():
    observed = cut(crowd()).position[:1, :4]
    model = random_model("pool_net")
    base = predict(model, observed, samples=K)
    assert_array_equal(predict(model, observed, samples=K), base)
    for change in ({"seed": 1}, {"recording": "a"}, {"frame": 1}):
        assert np.abs(predict(model, observed, samples=K, **change) - base).max() > 1e-3


def test_a_model_shows_itself_in_five_lines():
    weighting = Quantised(quantisation_factor=0.1)
    config = GeneratorConfig(pooling="as_described", weighting=weighting, pred_len=12)
    model = Model(config, {"layer": {"kernel": np.zeros((40, 50)), "bias": np.zeros(50)}}, "zara1")
    assert repr(model).splitlines() == [
        "Model NeuroSyM, quantised,quantisation_factor=0.1",
        "  kind: generator",
        "  to be tested on: zara1",
        "  config: GeneratorConfig(pred_len=12, pooling=as_described, "
        "weighting=quantised,quantisation_factor=0.1)",
        "  params: 2,050 numbers",
    ]


@pytest.mark.parametrize(
    ("observed", "how", "message"),
    [
        (np.zeros((2, 8, 2)), {}, "observed has 8 steps; the model observes 4"),
        (np.full((2, 4, 2), np.nan), {}, "agent 0, step 0 is not finite"),
        (np.zeros((4, 2)), {}, "observed must be"),
        (np.zeros((2, 4, 2)), {"samples": 0}, "samples must be at least 1, not 0"),
        (np.zeros((2, 4, 2)), {"samples": 2.5}, "samples must be a whole number, not 2.5"),
        (np.zeros((2, 4, 2)), {"seed": -1}, r"seed must lie in \[0, 2\*\*32\), not -1"),
    ],
)
def test_predict_refuses(observed, how, message):
    with pytest.raises(InputError, match=message):
        predict(random_model("pool_net"), observed, **how)
