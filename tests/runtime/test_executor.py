"""Real processes: single-threaded, with the caller's plugins, and ended with the caller."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.plugins import load_plugin
from neurosym_jax.runtime.executor import executor

ROOT = Path(__file__).parents[2]


def threads_and_process(_):
    return os.environ["NPROC"], os.getpid()


def test_tasks_run_in_single_threaded_processes():
    with executor(jobs=2) as pool:
        found = list(pool.map(threads_and_process, range(4)))
    assert {threads for threads, _ in found} == {"1"}
    assert os.getpid() not in {process for _, process in found}


def test_a_task_has_the_plugins_of_its_caller(tmp_path, monkeypatch):
    plugin = tmp_path / "doubling.py"
    plugin.write_text("def double(x):\n    return 2 * x\n")
    monkeypatch.setattr("neurosym_jax.plugins._loaded", {})
    load_plugin(str(plugin))
    double = next(m for n, m in sys.modules.items() if n.startswith("doubling_")).double
    with executor(jobs=1) as pool:
        assert pool.submit(double, 21).result() == 42


def test_an_error_ends_running_tasks():
    def fail():
        with executor(jobs=1) as pool:
            assert pool.submit(abs, -1).result() == 1
            pool.submit(time.sleep, 60)
            raise KeyError

    began = time.monotonic()
    with pytest.raises(KeyError):
        fail()
    assert time.monotonic() - began < 30


CALLER = """
import time
from neurosym_jax.runtime.executor import executor

if __name__ == "__main__":
    with executor(jobs=1) as pool:
        print(pool.submit(__import__("os").getpid).result(), flush=True)
        pool.submit(time.sleep, 60).result()
"""


def test_processes_end_with_a_caller_that_is_killed(tmp_path):
    script = tmp_path / "caller.py"
    script.write_text(CALLER)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    caller = subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, env=environment)
    assert caller.stdout is not None
    process = int(caller.stdout.readline())
    caller.send_signal(signal.SIGKILL)
    caller.wait()
    end = time.monotonic() + 20
    while Path(f"/proc/{process}").exists() and time.monotonic() < end:
        time.sleep(0.1)
    assert not Path(f"/proc/{process}").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"jobs": 0}, "--jobs must be at least 1, not 0"),
        ({"jobs": 1, "cluster": "tcp://127.0.0.1:1"}, "--jobs and --cluster"),
        ({"cluster": "nowhere"}, "--cluster nowhere: no Dask scheduler answers"),
    ],
)
def test_refusals(options, message):
    if "jobs" not in options:
        pytest.importorskip("distributed")
    with pytest.raises(InputError, match=message), executor(**options):
        pass
