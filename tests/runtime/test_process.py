import os

import jax
import pytest

from neurosym_jax.runtime.process import cache_folder


# A program with 80 MB of buffers of its own, so 20,000 pages that a call touches anew or not. At
# first aligned memory that is free often does not fit and new pages are taken; later it nearly
# always does, so the median of later calls counts.
@pytest.mark.parametrize("given", ["", "--xla_cpu_enable_fast_math=false"])
def test_vectors_are_wide_unless_somebody_said_otherwise(monkeypatch, given):
    from neurosym_jax.runtime import process as runtime

    monkeypatch.setenv("MALLOC_ARENA_MAX", "2")  # Leaves this process's memory alone.
    monkeypatch.setenv("XLA_FLAGS", given)
    runtime.tune()
    known = jax.__version_info__[:2] == (0, 10)
    assert os.environ["XLA_FLAGS"].startswith(given)
    assert ("--xla_cpu_prefer_vector_width=512" in os.environ["XLA_FLAGS"]) == known
    said = "--xla_cpu_prefer_vector_width=256"
    monkeypatch.setenv("XLA_FLAGS", said)
    runtime.tune()
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
