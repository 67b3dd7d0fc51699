"""What cannot fit is refused before it is tried, in words that say what to lower."""

import numpy as np
import pytest

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.baselines import ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.model import Model, predict
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.runtime import memory
from neurosym_jax.simulation.scenarios import synthetic_tracks


def test_the_machine_says_what_it_has():
    assert 1e8 < memory.available_memory() < 1e14


def test_a_forecast_of_too_many_samples():
    model = Model(GeneratorConfig(), {})
    with pytest.raises(InputError, match=r"2 people with 1000000000 samples .* fewer samples"):
        predict(model, np.zeros((2, 8, 2)), samples=10**9)


def test_an_evaluation_of_too_many_samples():
    batches = make_batches(cut_windows([synthetic_tracks("cross-path", 0)], 8, 8))
    with pytest.raises(InputError, match="ask for fewer samples"):
        score_forecaster(ConstantVelocitySampled(Lengths()), (), batches, samples=10**9, seed=0)


def test_memory_grows_with_pairs_where_there_are_symbols():
    plain, symbolic = (
        GeneratorForecaster(GeneratorConfig(pooling=pooling))
        for pooling in ("pool_net", "as_described")
    )
    assert plain.scene_bytes(20, 512) == 2 * plain.scene_bytes(20, 256) < 2e9
    assert symbolic.scene_bytes(20, 512) > 3 * symbolic.scene_bytes(20, 128)
    assert symbolic.scene_bytes(20, 512) < 2e9
