"""What must not change a forecast: padding, order, batches, the map's origin, the number type."""

import functools

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.commands.evaluate import Options, run
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.models.disk import load_model, save_model
from neurosym_jax.models.forecast import (
    Model,
    SceneForecaster,
    batch_noise,
    forecast_batch,
    predict,
    predict_representatives,
    predict_scenes,
    unpacked,
)
from neurosym_jax.models.sgan.network import GeneratorConfig
from neurosym_jax.scene import make_scene, pad_scene
from neurosym_jax.symbolic import Quantised
from tests.networks import random_model
from tests.repository import exhaustive

UTM = np.array([4e5, 5e6])
POOL_NET = {"pooling": "pool_net,hidden_dim=32"}
DESCRIBED = {"pooling": "as_described,hidden_dim=32"}
CONFIGS = {
    "pool_net": POOL_NET,
    "none": {"pooling": "none"},
    "social": {"pooling": "social,grid_size=4"},
    "every step": {**POOL_NET, "pool_every_timestep": True},
    "noise of agents": {**POOL_NET, "noise_mix_type": "ped"},
    "uniform noise": {**POOL_NET, "noise_type": "uniform"},
    "as_described": DESCRIBED,
    "ros": {"pooling": "neurosym_ros,hidden_dim=32", "weighting": "cnd_shipped"},
    # Symbols of predicted steps, too.
    "symbols, every step": {
        **DESCRIBED,
        "pool_every_timestep": True,
        "weighting": "quantised",
    },
}
QUICK = ("pool_net", "symbols, every step", "noise of agents")
COVERED = ("every step", "as_described")
"""Networks whose parts \"symbols, every step\" has too."""
K = 3


@functools.cache
def model_of(name: str) -> Model:
    return random_model(GeneratorConfig(obs_len=4, pred_len=4, **CONFIGS[name]))


def windows_of(recording: str, shift: np.ndarray | float = 0.0) -> Windows:
    """Fourteen frames of up to nine people who come and go; coordinates have 4 decimals."""
    rng = np.random.default_rng(len(recording))
    walks = rng.uniform(-2, 2, (9, 1, 2)) + rng.normal(0, 0.3, (9, 14, 2)).cumsum(
        axis=1
    )
    # On a coarse grid, so that neighbours lie on the social grid's lines.
    walks[:4] = np.round(walks[:4] * 4) / 4
    first, last = rng.integers(0, 4, 9), rng.integers(9, 15, 9)
    agent, frame = np.nonzero(
        (np.arange(14) >= first[:, None]) & (np.arange(14) < last[:, None])
    )
    position = np.round(walks, 4)[agent, frame] + shift
    return cut_windows(
        [make_tracks(recording, frame * 0.4, agent, position)], 4, 4, min_agents=1
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else exhaustive(name) for name in CONFIGS],
)
def test_many_scenes_are_forecast_as_each_alone(name):
    """Other scenes, another recording before them, another origin: nothing changes a forecast."""
    model, parts = model_of(name), (windows_of("crowd", UTM), windows_of("others"))
    scenes = []
    for windows in parts:
        scenes += np.split(windows.position[:, :4], windows.bounds[1:-1])
    assert len({len(scene) for scene in scenes}) > 2
    frames = np.concatenate([windows.identity[:, 1].astype(int) for windows in parts])
    forecasts = predict_scenes(
        model, scenes, samples=K, seed=5, recording="crowd", frames=frames
    )
    assert len(forecasts) == len(scenes)
    for number in (0, len(scenes) // 3, len(scenes) - 1):
        options = {
            "samples": K,
            "seed": 5,
            "recording": "crowd",
            "frame": frames[number],
        }
        alone, likely = predict_representatives(model, scenes[number], **options)
        assert likely.tolist() == [1 / K] * K
        assert alone.dtype == np.float64
        assert_allclose(forecasts[number], alone, rtol=0, atol=1e-5)
        assert_allclose(
            predict(model, scenes[number] - UTM, **options) + UTM,
            alone,
            rtol=0,
            atol=1e-5,
        )
    scene = make_scene(scenes[number], recording="crowd", frame=frames[number])
    forecaster = SceneForecaster(model.forecaster, model.params, samples=K, seed=5)
    np.testing.assert_array_equal(forecaster(scene), alone)
    for change in ({"seed": 1}, {"recording": "a"}, {"frame": 1}):
        other = predict(model, scenes[-1], **{**options, **change})
        assert np.abs(other - alone).max() > 1e-3
    assert np.abs(alone[0] - alone[1]).max() > 1e-3
    # By default they are those of the first frames.
    forecasts, alone = predict_scenes(model, scenes[:2], samples=K), scenes[1]
    assert_allclose(forecasts[1], predict(model, alone, samples=K, frame=1), atol=1e-5)
    assert predict_scenes(model, []) == []


def test_agents_are_decoded_in_parts(monkeypatch):
    model, scenes = model_of("pool_net"), [np.zeros((5, 4, 2)), np.ones((6, 4, 2))]
    complete = predict_scenes(model, scenes, samples=K)
    monkeypatch.setattr("neurosym_jax.models.forecast.PART", 4)
    for part_forecast, expected in zip(
        predict_scenes(model, scenes, samples=K), complete
    ):
        assert_allclose(part_forecast, expected, atol=1e-6)


@pytest.mark.parametrize(
    "name",
    [
        exhaustive(name) if name in COVERED else name
        for name in CONFIGS
        if name != "uniform noise"
    ],
)
def test_padding_and_permutation(name):
    """Order of agents: the noise of an agent goes with its slot, so only global noise permutes."""
    model = model_of(name)
    observed = windows_of("crowd").position[:3, :4]
    order = np.array([2, 0, 1])

    def forecast(positions, slots=3):
        scene = pad_scene(make_scene(positions, recording="r"), slots).bare()
        scene = jax.tree.map(lambda array: array[None], scene)
        noise = batch_noise(model.forecaster, scene, K, 0)
        futures, _ = forecast_batch(model.forecaster, model.params, scene, noise)
        return unpacked(futures, scene.valid)[:, 0, :3]

    plain = forecast(observed)
    assert_allclose(forecast(observed, 64), plain, rtol=0, atol=1e-5)
    if not model.forecaster.noise.per_agent:
        assert_allclose(forecast(observed[order]), plain[:, order], rtol=0, atol=1e-5)


def test_a_model_shows_itself_in_five_lines():
    weighting = Quantised(speed=0.25)
    config = GeneratorConfig(pooling="as_described", weighting=weighting, pred_len=12)
    model = Model(
        config, {"layer": {"kernel": np.zeros((40, 50)), "bias": np.zeros(50)}}, "zara1"
    )
    assert repr(model).splitlines() == [
        "Model NeuroSyM, quantised,speed=0.25",
        "  family: generator",
        "  to be tested on: zara1",
        "  config: GeneratorConfig(pred_len=12, pooling=as_described, "
        "weighting=quantised,speed=0.25)",
        "  params: 2,050 numbers",
    ]


GOOD, PAIR = np.zeros((1, 4, 2)), np.zeros((2, 4, 2))


@pytest.mark.parametrize(
    ("forecast", "observed", "how", "message"),
    [
        (
            predict,
            np.zeros((2, 8, 2)),
            {},
            "observed has 8 steps; the model observes 4",
        ),
        (predict, PAIR + np.nan, {}, "agent 0, step 0 is not finite"),
        (predict, PAIR[0], {}, "observed must be"),
        (predict, PAIR, {"samples": 0}, "samples must be at least 1, not 0"),
        (predict, PAIR, {"samples": 2.5}, "samples must be a whole number, not 2.5"),
        (predict, PAIR, {"seed": -1}, r"seed must lie in \[0, 2\*\*32\), not -1"),
        (
            predict_scenes,
            [GOOD, np.zeros((1, 5, 2))],
            {},
            r"observed\[1\] has 5 steps; the model",
        ),
        (predict_scenes, [GOOD, GOOD + np.inf], {}, r"observed\[1\]: agent 0, step 0"),
        (
            predict_scenes,
            [GOOD, GOOD[:0]],
            {},
            r"observed\[1\]: a scene needs at least one agent",
        ),
        (
            predict_scenes,
            [GOOD] * 2,
            {"frames": [0]},
            "1 frames are given for 2 scenes",
        ),
        (
            predict_scenes,
            [GOOD],
            {"frames": [0.5]},
            r"frame must be a whole number, not array\(",
        ),
        (predict, PAIR, {"frame": "a"}, "frame must be a whole number, not 'a'"),
        (predict, PAIR, {"frame": 1.5}, "frame must be a whole number, not 1.5"),
        (predict, PAIR, {"recording": 3}, "recording must be text, not 3"),
        (predict, PAIR, {"seed": None}, r"seed must be a whole number, not None"),
        (
            predict,
            PAIR,
            {"seed": 10**400},
            "seed must be a whole number, not an integer of 1329",
        ),
        (predict, PAIR, {"samples": 10**9}, "people at once .* GB are free: ask for"),
        (
            predict_scenes,
            [PAIR],
            {"samples": 10**9},
            "2 people at once .* GB are free: ask for",
        ),
    ],
)
def test_refusals(forecast, observed, how, message):
    with pytest.raises(InputError, match=message):
        forecast(model_of("none"), observed, **how)


def test_the_earlier_release_forecasts_nothing_but_parity_cases(tmp_path):
    model = random_model(GeneratorConfig(pooling="neurosym_ijcnn", pred_len=4))
    with pytest.raises(InputError, match="does not weight pairs"):
        predict(model, np.zeros((2, 8, 2)))
    save_model(tmp_path / "m", model)
    assert load_model(tmp_path / "m").config == model.config
    with pytest.raises(InputError, match="m: neurosym_ijcnn does not weight pairs"):
        run(Options(model=(str(tmp_path / "m"),), json=tmp_path / "r"))
