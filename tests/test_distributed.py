"""Several processes give what one gives, to the last bit."""

import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest

from neurosym_jax.distributed import Processes, is_first, join, share, sum_over_processes
from neurosym_jax.errors import InputError
from neurosym_jax.model_folder import load_model

ROOT = Path(__file__).parents[1]

# Groups so small that both processes have some of every test set.
EVALUATE = """
from neurosym_jax.command import run_command
from neurosym_jax.evaluation import protocol
from neurosym_jax.evaluation.run import EvaluateOptions, run_evaluation
protocol.GROUP = 2**9
run_command(EvaluateOptions, run_evaluation)
"""


def start(command, *arguments):
    return subprocess.Popen(
        [sys.executable, *map(str, (*command, *arguments))],
        env={**os.environ, "NPROC": "1", "PYTHONPATH": str(ROOT), "JAX_PLATFORMS": "cpu"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def start_two(command, *arguments):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    together = ("--processes.coordinator", address, "--processes.count", 2, "--processes.index")
    return [start(command, *arguments, *together, index) for index in range(2)]


def finish(running):
    for process in running:
        said, _ = process.communicate(timeout=300)
        assert process.returncode == 0, said


@pytest.mark.slow
def test_two_processes_evaluate_as_one(tmp_path):
    checkpoint = ROOT / "checkpoints/sgan_simulations_8_8"
    command = ["-c", EVALUATE, "--checkpoint", checkpoint, "--no-figures"]
    command += ["--scene", "cross-path", "--samples", 3, "--json"]
    finish(
        [
            start(command, tmp_path / "alone.json"),
            *start_two(command, tmp_path / "both.json"),
        ]
    )
    alone, both = (
        json.loads((tmp_path / name).read_text())["rows"] for name in ("alone.json", "both.json")
    )
    for row, other in zip(alone, both, strict=True):
        for field in ("model", "agents", "joint", "marginal", "collision_rate"):
            assert row[field] == other[field]


@pytest.mark.slow
def test_two_processes_train_as_one_and_go_on_after_a_kill(tmp_path):
    command = [ROOT / "train.py", "--scene", "cross-path", "--steps", 75, "--resume"]
    command += ["--set", "shards=2", "batch_scenes=8", "validate_every=25", "best_k=3", "--out"]
    alone, two = tmp_path / "alone", tmp_path / "two"
    one = start(command, alone)
    killed = start_two(command, two)
    while not list(two.glob("checkpoints/step_*")):
        assert None in [process.poll() for process in killed], "they ended without a checkpoint"
        time.sleep(0.05)
    for process in killed:
        process.kill()
        process.communicate()
    finish([one, *start_two(command, two)])
    assert (alone / "metrics.jsonl").read_text() == (two / "metrics.jsonl").read_text()
    params = [load_model(folder / "model").params for folder in (alone, two)]
    jax.tree.map(np.testing.assert_array_equal, *params)


@pytest.mark.slow
def test_shards_that_two_processes_cannot_share_are_refused(tmp_path):
    for process in start_two([ROOT / "train.py"], "--steps", 1, "--out", tmp_path):
        said, _ = process.communicate(timeout=300)
        assert process.returncode == 2  # As of every refusal.
        assert "shards must be a multiple of 2" in said


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
