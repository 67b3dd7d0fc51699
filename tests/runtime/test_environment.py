import json

import jax
import pytest

from neurosym_jax.data.sources import Synthetic
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.forecasters import ConstantVelocitySampled
from neurosym_jax.runtime.process import available_memory, code_version, run_environment


def test_the_environment_is_json_and_knows_the_threads(monkeypatch):
    monkeypatch.delenv("PJRT_NPROC", raising=False)
    monkeypatch.setenv("NPROC", "3")
    environment = run_environment()
    assert json.loads(json.dumps(environment)) == environment
    assert (environment["threads"], environment["jax"]) == (3, jax.__version__)
    commit = code_version()
    assert commit is None or commit == commit.strip() != ""


def test_an_evaluation_of_too_many_samples_names_what_to_lower():
    assert 1e8 < available_memory() < 1e14
    batches = make_batches(cut_windows(Synthetic().recordings("cross-path"), 8, 8))
    with pytest.raises(InputError, match="ask for fewer samples"):
        score_forecaster(ConstantVelocitySampled(Lengths()), (), batches, samples=10**9, seed=0)
