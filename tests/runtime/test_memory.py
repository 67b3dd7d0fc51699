"""What cannot fit is refused before it is tried, in words that say what to lower."""

import pytest

from neurosym_jax.data.batching import make_batches
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.baselines import ConstantVelocitySampled
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.runtime import environment
from neurosym_jax.simulation.scenarios import synthetic_tracks


def test_the_machine_says_what_it_has():
    assert 1e8 < environment.available_memory() < 1e14


def test_an_evaluation_of_too_many_samples():
    batches = make_batches(cut_windows([synthetic_tracks("cross-path", 0)], 8, 8))
    with pytest.raises(InputError, match="ask for fewer samples"):
        score_forecaster(ConstantVelocitySampled(Lengths()), (), batches, samples=10**9, seed=0)
