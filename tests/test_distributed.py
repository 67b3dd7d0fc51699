"""Several processes give what one gives, to the last bit."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from neurosym_jax.distributed import Processes, is_first, join, share, sum_over_processes
from neurosym_jax.errors import InputError

ROOT = Path(__file__).parents[1]

# Groups so small that both processes have some of every test set.
SCRIPT = """
from neurosym_jax.command import run_command
from neurosym_jax.evaluation import protocol
from neurosym_jax.evaluation.run import EvaluateOptions, run_evaluation
protocol.GROUP = 2**9
run_command(EvaluateOptions, run_evaluation)
"""


def start(folder, name, *arguments):
    checkpoint = ROOT / "checkpoints/sgan_simulations_8_8"
    command = [sys.executable, "-c", SCRIPT, "--checkpoint", checkpoint, "--no-figures"]
    command += ["--scene", "cross-path", "--samples", 3, "--json", folder / name, *arguments]
    return subprocess.Popen(
        list(map(str, command)),
        env={**os.environ, "NPROC": "1", "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


@pytest.mark.slow
def test_two_processes_are_one(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    together = ("--processes.coordinator", address, "--processes.count", 2)
    running = [start(tmp_path, "alone.json")]
    for index in range(2):
        running.append(start(tmp_path, f"{index}.json", *together, "--processes.index", index))
    for process in running:
        said, _ = process.communicate(timeout=300)
        assert process.returncode == 0, said
    assert not (tmp_path / "1.json").exists()  # The first one writes for all.
    alone, both = (
        json.loads((tmp_path / name).read_text())["rows"] for name in ("alone.json", "0.json")
    )
    for row, other in zip(alone, both, strict=True):
        for field in ("model", "agents", "joint", "marginal", "collision_rate"):
            assert row[field] == other[field]


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
