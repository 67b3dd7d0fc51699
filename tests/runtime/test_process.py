import os
import platform
import subprocess
import sys

import jax
import pytest

from neurosym_jax.runtime.process import cache_folder

# A program with 80 MB of buffers of its own, so 20,000 pages that a call touches anew or not. At
# first aligned memory that is free often does not fit and new pages are taken; later it nearly
# always does, so the median of later calls counts.
SCRIPT = """
import resource, sys
import jax, jax.numpy as jnp
from neurosym_jax.runtime.process import tune
if sys.argv[1] == "tuned":
    tune()
program = jax.jit(lambda x: (x + 1).T @ x[:, :8])
x = jnp.ones((2500, 8000))
faults = []
for _ in range(41):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    program(x).block_until_ready()
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
print(sorted(faults[20:])[10])
"""


def page_faults(how, **environment):
    clean = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("MALLOC_", "GLIBC_T"))
    }
    said = subprocess.run(
        [sys.executable, "-c", SCRIPT, how],
        env={**clean, "JAX_PLATFORMS": "cpu", **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return int(said.stdout)


@pytest.mark.slow
@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's malloc is what is tuned")
def test_a_tuned_process_keeps_the_memory_of_its_programs():
    assert page_faults("tuned") < 1000 < 10_000 < page_faults("as it is")
    assert page_faults("tuned", MALLOC_ARENA_MAX="8") > 10_000  # Somebody said otherwise.


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
