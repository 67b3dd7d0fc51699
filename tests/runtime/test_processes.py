"""Several processes give what one gives, to the last bit."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.runtime.processes import Processes, is_first, join, share, sum_over_processes
from neurosym_jax.training.lock import sole_writer

ROOT = Path(__file__).parents[2]

# Groups so small that both processes have some of every test set.
EVALUATE = """
from neurosym_jax.commands._running import run_command
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


def start_two(command, *arguments, of_second=()):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    together = ("--processes.coordinator", address, "--processes.count", 2, "--processes.index")
    each = ((), of_second)
    return [start(command, *arguments, *together, index, *each[index]) for index in range(2)]


def finish(running, statuses=(0,)):
    """What all have said, once they have ended; none is left over."""
    said = []
    try:
        for process in running:
            said.append(process.communicate(timeout=200)[0])
            assert process.returncode in statuses, said
    finally:
        for process in running:
            process.kill()
    return said


@pytest.mark.slow
def test_two_processes_evaluate_as_one(tmp_path):
    checkpoint = ROOT / "checkpoints/sgan_simulations_8_8"
    command = ["-c", EVALUATE, "--checkpoint", checkpoint, "--no-figures"]
    command += ["--scene", "cross-path", "--samples", 3, "--json"]
    one = start(command, tmp_path / "alone.json")
    said = finish([one, *start_two(command, tmp_path / "both.json")])
    assert ["rows: " in each for each in said] == [True, True, False]  # The first writes for both.
    alone, both = (
        json.loads((tmp_path / name).read_text())["rows"] for name in ("alone.json", "both.json")
    )
    for row, other in zip(alone, both, strict=True):
        for field in ("model", "agents", "joint", "marginal", "collision_rate"):
            assert row[field] == other[field]


@pytest.mark.slow
def test_two_processes_train_as_one_and_go_on_after_a_kill(tmp_path):
    command = [ROOT / "train.py", "--scene", "cross-path", "--steps", 100, "--resume"]
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
    assert not (two / "model").exists(), "it was finished before it was killed"
    finish([one, *start_two(command, two)])
    assert (alone / "metrics.jsonl").read_text() == (two / "metrics.jsonl").read_text()
    params = [load_model(folder / "model").params for folder in (alone, two)]
    jax.tree.map(np.testing.assert_array_equal, *params)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "of_second", "reason"),
    [
        (["--steps", 1], [], "shards must be a multiple of 2"),
        (["--set", "shards=2"], ["--seed", 1], "the processes do not agree on the run"),
    ],
)
def test_processes_that_cannot_train_as_one_say_so_and_end(tmp_path, arguments, of_second, reason):
    running = start_two([ROOT / "train.py", *arguments, "--out", tmp_path], of_second=of_second)
    for said in finish(running, statuses=(2,)):
        assert reason in said


@pytest.mark.slow
def test_where_one_process_fails_the_others_end_too(tmp_path):
    with sole_writer(tmp_path):
        running = start_two([ROOT / "train.py", "--set", "shards=2", "--out", tmp_path])
        # JAX aborts who waits for the first process where it notices its end before we do.
        said, _ = finish(running, statuses=(2, -signal.SIGABRT))
    assert "another process is training there" in said


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
