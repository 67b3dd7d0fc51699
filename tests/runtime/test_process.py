import json
import os

import jax
import pytest

from neurosym_jax.data.sources import Synthetic
from neurosym_jax.data.windows import cut_windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.forecasters import ConstantVelocitySampled
from neurosym_jax.runtime.process import (
    available_memory,
    cache_folder,
    code_version,
    run_environment,
    tune,
)


@pytest.mark.parametrize("given", ["", "--xla_cpu_enable_fast_math=false"])
def test_vectors_are_wide_unless_somebody_said_otherwise(monkeypatch, given):
    monkeypatch.setenv("MALLOC_ARENA_MAX", "2")  # Leaves this process's memory alone.
    monkeypatch.setenv("XLA_FLAGS", given)
    tune()
    known = jax.__version_info__[:2] == (0, 10)
    assert os.environ["XLA_FLAGS"].startswith(given)
    assert ("--xla_cpu_prefer_vector_width=512" in os.environ["XLA_FLAGS"]) == known
    said = "--xla_cpu_prefer_vector_width=256"
    monkeypatch.setenv("XLA_FLAGS", said)
    tune()
    assert os.environ["XLA_FLAGS"] == said


def test_without_a_home_nothing_is_kept(monkeypatch, tmp_path):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr("pathlib.Path.home", lambda: tmp_path)
    assert cache_folder() == tmp_path / ".cache/neurosym_jax"

    def nobody():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr("pathlib.Path.home", nobody)
    assert cache_folder() is None
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert cache_folder() is None


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
