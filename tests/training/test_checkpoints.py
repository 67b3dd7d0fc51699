"""Training states survive kills, flipped bytes and NaNs, bit for bit."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.training.checkpoints import restore_state, save_state, saved_steps

RECORD = {"config": {"lr": 1e-3, "name": "sgan é"}, "history": [{"step": 1, "ade": 0.1 + 0.2}]}


class State(NamedTuple):
    params: Any
    optimiser: Any
    step: Any
    key: Any
    odd: Any


def make_state(seed: int = 0) -> State:
    rng = np.random.default_rng(seed)
    weights = {"a.b": {"w/x": rng.normal(size=(5, 4)), "['b']": rng.normal(size=4)}}
    params = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), weights)
    optimiser = optax.chain(
        optax.clip_by_global_norm(2.0), optax.adam(optax.constant_schedule(1.0))
    )
    odd = {
        "flags": np.array([True, False]),
        "bits": rng.integers(0, 2**63, 3),
        "empty": np.zeros((0, 3), np.float32),
        "fortran": np.asfortranarray(rng.normal(size=(2, 3))),
        "strided": np.arange(6.0)[::2],
    }
    key = jax.random.key_data(jax.random.key(seed))
    return State(params, optimiser.init(params), np.int32(seed), key, odd)


def assert_same(one: Any, two: Any) -> None:
    assert jax.tree.structure(one) == jax.tree.structure(two)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        a, b = np.asarray(a), np.asarray(b)
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())


def restored(folder: Path, template: Any) -> tuple[int, Any, dict[str, Any]]:
    found = restore_state(folder, template)
    assert found is not None
    return found


@pytest.fixture
def two_steps(tmp_path) -> Path:
    for step in (1, 2):
        save_state(tmp_path / "run", step, make_state(step), {"at": step})
    return tmp_path / "run"


def test_round_trip_is_bit_identical(tmp_path):
    state, folder = make_state(3), tmp_path / "new" / "run"
    assert restore_state(folder, state) is None
    save_state(folder, 7, state, RECORD)
    step, again, record = restored(folder, make_state(0))
    assert (step, record) == (7, RECORD)
    assert_same(again, state)
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state.params)
    assert_same(restored(folder, state._replace(params=shapes))[1], state)


def test_the_two_newest_are_kept(two_steps):
    save_state(two_steps, 30, make_state(3), {})
    assert saved_steps(two_steps) == [2, 30]
    assert restored(two_steps, make_state(0))[0] == 30


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"params": {"w": np.array([1.0, np.nan])}}, r"\['w'\] is not finite: .* step 2 is kept"),
        ({"record": {"ade": float("nan")}}, "record is not JSON .* step 2 is kept"),
        ({"record": {"array": np.zeros(2)}}, "record is not JSON"),
        ({"step": 2}, "step 2 is not after step 2, which is already there: resume"),
        ({"step": 1}, "step 1 is not after step 2"),
    ],
)
def test_what_cannot_be_saved_is_refused(two_steps, changes, message):
    given = {"step": 3, "params": {}, "record": {}} | changes
    state = make_state(3)._replace(params=given["params"])
    with pytest.raises(TrainingError, match=message):
        save_state(two_steps, given["step"], state, given["record"])
    assert saved_steps(two_steps) == [1, 2]
    assert_same(restored(two_steps, make_state(0))[1], make_state(2))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"step": np.zeros(1, np.int32)}, r"state\.step is int32\[\] there and int32\[1\] here"),
        ({"step": np.float32(0)}, r"state\.step is int32\[\] there and float32\[\] here"),
        ({"params": {}}, r"state\.params.* is float32\[4\] there and absent here"),
        ({"odd": {"new": np.zeros(2)}}, r"'new'\] is absent there and float64\[2\] here"),
    ],
)
def test_another_template_is_refused(two_steps, change, words):
    with pytest.raises(InputError, match=words):
        restore_state(two_steps, make_state(0)._replace(**change))
    assert saved_steps(two_steps) == [1, 2]


def test_a_damaged_step_is_passed_over(two_steps, capsys):
    path = two_steps / "step_00000002.state"
    whole, rng = path.read_bytes(), random.Random(0)
    flipped = []
    for _ in range(100):
        content = bytearray(whole)
        content[rng.randrange(len(content))] ^= rng.randrange(1, 256)
        flipped.append(bytes(content))
    for content in (*flipped, b"", whole[:40], whole[:-1], whole + b"?"):
        path.write_bytes(content)
        step, state, record = restored(two_steps, make_state(0))
        assert (step, record) == (1, {"at": 1})
        assert_same(state, make_state(1))
        assert "step_00000002.state: damaged, and passed over" in capsys.readouterr().err
        assert (two_steps / "damaged_step_00000002.state").exists()
    save_state(two_steps, 2, make_state(2), {"at": 2})
    assert_same(restored(two_steps, make_state(0))[1], make_state(2))


# One process imports everything, and forks those that are killed: importing takes seconds.
KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from orbax.checkpoint import v1
from neurosym_jax.training.checkpoints import restore_state, save_state, saved_steps

folder = Path(sys.argv[1])
for line in sys.stdin:
    pid = os.fork()
    if pid:
        print(pid, flush=True)
        os.waitpid(pid, 0)
        print("dead", flush=True)
        continue
    step = int(line)
    while True:
        step += 1
        state = {"w": np.full((64, 8), step, np.float32), "step": np.int32(step)}
        save_state(folder, step, state, {"at": step})
        (folder.parent / "saved").write_text(str(step))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
def test_a_kill_at_any_moment_leaves_the_last_step_whole(tmp_path, capsys):
    folder, rng = tmp_path / "run", random.Random(0)
    template = {"w": np.zeros((64, 8), np.float32), "step": np.int32(0)}
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "JAX_PLATFORMS": "cpu"},
    )
    assert process.stdin
    assert process.stdout
    step, longest = 0, 0.5
    with process:
        for _ in range(20):
            print(step, file=process.stdin, flush=True)
            pid = int(process.stdout.readline())
            time.sleep(rng.uniform(0.0, longest))
            os.kill(pid, signal.SIGKILL)
            assert process.stdout.readline() == "dead\n"
            found = restore_state(folder, template)
            if found is None:
                assert step == 0
                longest *= 2  # A busy machine saves nothing for long.
                continue
            step, state, record = found
            assert record == {"at": step}
            assert_same(state, {"w": np.full((64, 8), step, np.float32), "step": np.int32(step)})
            acknowledged = folder.parent / "saved"
            # The number itself is not written whole or not at all.
            if acknowledged.exists() and acknowledged.read_text():
                assert step >= int(acknowledged.read_text())
        process.stdin.close()
    assert step > 0
    assert "damaged" not in capsys.readouterr().err
    assert len(saved_steps(folder)) <= 3
