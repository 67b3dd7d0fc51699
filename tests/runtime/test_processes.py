"""Several processes give what one gives, to the last bit."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.processes import Processes, is_first, join, share, sum_over_processes

ROOT = Path(__file__).parents[2]

# Groups so small that both processes have some of every test set.
EVALUATE = """
from neurosym_jax.commands._running import run_command
from neurosym_jax.evaluation import scoring
from neurosym_jax.commands.evaluate import Options, run
scoring.GROUP = 2**9
run_command(Options, run)
"""


def start(command, *arguments):
    return subprocess.Popen(
        [sys.executable, *map(str, (*command, *arguments))],
        env={**os.environ, "NPROC": "1", "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def start_two(command, *arguments, of_first=()):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    together = ("--processes.coordinator", address, "--processes.count", 2, "--processes.index")
    each = (of_first, ())
    return [start(command, *arguments, *together, index, *each[index]) for index in range(2)]


def finish(running):
    """What each has printed and its status, once they have ended; none is left over."""
    try:
        return [(process.communicate(timeout=200)[0], process.returncode) for process in running]
    finally:
        for process in running:
            process.kill()


@pytest.mark.slow
def test_two_processes_evaluate_as_one(tmp_path):
    checkpoint = ROOT / "checkpoints/sgan_simulations_8_8"
    command = ["-c", EVALUATE, "--checkpoint", checkpoint, "--no-figures"]
    command += ["--scene", "cross-path", "--samples", 3, "--json"]
    one = start(command, tmp_path / "alone.json")
    ended = finish([one, *start_two(command, tmp_path / "both.json")])
    assert [status for _, status in ended] == [0, 0, 0], ended
    # The first writes for both.
    assert ["rows: " in printed for printed, _ in ended] == [True, True, False]
    alone, both = (
        json.loads((tmp_path / name).read_text())["rows"] for name in ("alone.json", "both.json")
    )
    for row, other in zip(alone, both, strict=True):
        for field in ("model", "agents", "joint", "marginal", "collision_rate"):
            assert row[field] == other[field]


@pytest.mark.slow
def test_where_one_process_fails_the_other_ends_too():
    command = [ROOT / "evaluate.py", "--no-figures", "--scene", "cross-path"]
    (printed, status), (_, other) = finish(start_two(command, of_first=("--samples", 0)))
    assert status == 2
    assert "samples must be at least 1" in printed
    assert other != 0


def test_alone_nothing_happens():
    join(Processes())
    assert is_first()
    assert share("ab") == [(0, "a"), (1, "b")]
    array = np.arange(3.0)
    assert sum_over_processes(array) is array


@pytest.mark.parametrize("some", [{"count": 2}, {"coordinator": "a:1"}, {"auto": True, "index": 0}])
def test_half_an_answer_is_refused(some):
    with pytest.raises(InputError, match="go together"):
        join(Processes(**some))
