"""The neighbour effect tells living poolings from dead ones."""

import jax
import numpy as np
import pytest

from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.forecasters import ConstantVelocitySampled, GeneratorForecaster
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.step import initial_state

OBS, PRED = 4, 3
NAMES = ("neighbour_share", "neighbour_near", "neighbour_move")


def windows(sizes) -> Windows:
    """Random walks, each agent's start 1.5 m from the one before, the last agent far away."""
    rng = np.random.default_rng(0)
    position = np.cumsum(rng.normal(0.1, 0.02, (sum(sizes), OBS + PRED, 2)), axis=1)
    bounds = np.concatenate([[0], np.cumsum(sizes)])
    position[..., 0] += 1.5 * (np.arange(len(position)) - np.repeat(bounds[:-1], sizes))[:, None]
    position[bounds[1:] - 1] += 50
    identity = np.stack([np.zeros(len(sizes)), np.arange(len(sizes))], axis=1).astype(np.uint32)
    return Windows(position, np.arange(len(position)), bounds, identity, OBS)


WINDOWS = windows([3, 4, 1, 5, 4, 3])
BATCHES = make_batches(WINDOWS)


def effect(bias: float, **changes):
    config = GeneratorConfig(obs_len=OBS, pred_len=PRED, **changes)
    params = initial_state(config, TrainConfig(), jax.random.key(0)).params
    layer = params["params"]["pooling"]["mlp"]["layer_1"]
    layer["bias"] = layer["bias"] + bias
    forecaster = GeneratorForecaster(config)
    found = score_forecaster(forecaster, params, BATCHES, samples=3, seed=0, metrics=NAMES)
    assert found.scores["neighbour_share"].count.sum() == 19  # Nobody of the scene of one.
    assert found.scores["neighbour_near"].count.sum() == 14  # Nor the last of each scene.
    return [found.mean(name) for name in NAMES]


@pytest.mark.parametrize("changes", [{"pooling": "as_described"}, {"noise_mix_type": "ped"}])
def test_a_living_pooling_moves_people_and_a_dead_one_nobody(changes):
    share, near, move = effect(10.0, **changes)
    assert min(share, near) > 0.8
    assert move > 0.01
    share, near, move = effect(-1e4, **changes)
    assert share == near == 0
    assert move < 1e-5


def test_a_baseline_sees_nobody():
    forecaster = ConstantVelocitySampled(Lengths(OBS, PRED))
    found = score_forecaster(forecaster, (), BATCHES, samples=3, seed=0, metrics=NAMES)
    assert [found.mean(name) for name in NAMES] == [0, 0, 0]
