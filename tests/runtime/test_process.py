import os

import jax
import pytest

from neurosym_jax.runtime.process import cache_folder, tune


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
