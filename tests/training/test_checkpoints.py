"""Training states survive kills and flipped bytes, bit for bit."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from orbax.checkpoint import v1 as ocp

from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.training.state import restore_state, save_state, sole_writer


def state_of(seed):
    rng = np.random.default_rng(seed)
    return {
        "params": {
            "a.b": {
                "w/x": jnp.asarray(rng.normal(size=(5, 4))),
                "['b']": np.float32(seed),
            }
        },
        "half": np.float16([1.5, -0.0]),
        "brain": jnp.asarray(rng.normal(size=3), jnp.bfloat16),
        "flags": np.array([True, False]),
        "key": jax.random.key_data(jax.random.key(seed)),
        "strided": np.asfortranarray(rng.normal(size=(2, 6)))[:, ::2],
    }


def assert_same(state, other):
    assert jax.tree.structure(state) == jax.tree.structure(other)
    for a, b in zip(
        *(map(np.asarray, jax.tree.leaves(tree)) for tree in (state, other)),
        strict=True,
    ):
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())


def names(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def two_steps(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    for step in (1, 2):
        save_state(folder, step, state_of(step), {"at": step})
    return folder


def test_round_trip_is_bit_identical(tmp_path):
    folder, record = (
        tmp_path / "new" / "run",
        {"lr": 1e-3, "rows": [{"ade": 0.1 + 0.2, "é": 1}]},
    )
    assert restore_state(folder, state_of(0)) is None
    save_state(folder, 7, state_of(3), record)
    state, again = restore_state(folder, state_of(0))
    assert_same(state, state_of(3))
    assert again == record


@pytest.mark.parametrize(
    "change", [{"flags": np.zeros(3, bool)}, {"half": np.zeros(2)}, {"new": 0}]
)
def test_another_template_is_refused(two_steps, change):
    template = jax.tree.map(np.asarray, state_of(0) | change)
    with pytest.raises(InputError, match="holds another run"):
        restore_state(two_steps, template)
    assert names(two_steps) == ["step_00000001", "step_00000002"]


def flip(path, rng):
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= rng.randrange(1, 256)
    path.write_bytes(content)


CHANGES = {
    "flipped byte": flip,
    "empty": lambda path, _: os.truncate(path, 0),
    "half": lambda path, _: os.truncate(path, path.stat().st_size // 2),
    "longer": lambda path, _: path.write_bytes(path.read_bytes() + b"?"),
    "missing": lambda path, _: path.unlink(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_an_altered_file_is_never_read_and_the_state_before_is(
    tmp_path, two_steps, capsys, monkeypatch, change
):
    load, rng = ocp.load, random.Random(0)

    def load_first(path):
        return load(path) if "_00000001/" in path else pytest.fail(f"{path} was read")

    monkeypatch.setattr(ocp, "load", load_first)
    for path in sorted((two_steps / "step_00000002").rglob("*")):
        if path.is_file() and path.stat().st_size:
            folder = shutil.copytree(two_steps, tmp_path / "run")
            CHANGES[change](folder / path.relative_to(two_steps), rng)
            state, record = restore_state(folder, state_of(0))
            assert record == {"at": 1}
            assert_same(state, state_of(1))
            assert "step_00000002: is damaged: " in capsys.readouterr().err
            assert names(folder) == ["damaged_step_00000002", "step_00000001"]
            shutil.rmtree(folder)


def test_the_newest_are_kept_and_training_goes_on_after_damage(
    tmp_path, two_steps, capsys
):
    folder = shutil.copytree(two_steps, tmp_path / "run")
    save_state(folder, 3, state_of(3), {})
    assert names(folder) == ["step_00000002", "step_00000003"]  # The two newest.
    shutil.rmtree(folder)
    shutil.copytree(two_steps, folder)
    (folder / "step_00000002" / "record.json").write_text("{}")
    assert restore_state(folder, state_of(0))[1] == {"at": 1}
    save_state(folder, 2, state_of(2), {"at": 2})
    assert_same(restore_state(folder, state_of(0))[0], state_of(2))
    for name in ("step_00000001", "step_00000002"):
        (folder / name / "record.json").unlink()
    assert restore_state(folder, state_of(0)) is None
    assert capsys.readouterr().err.count("warning: ") == 3


def test_what_a_killed_process_left_half_written_goes_at_the_next_start(tmp_path):
    """And nothing that a user may have put there."""
    left = [".model.0123abcd", "checkpoints/.step_00000003.0123abcd"]
    kept = [".notes.0123abcd", ".model.mine", "checkpoints/.step_notes", "model"]
    for name in [*left, *kept]:
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / ".metrics.0123abcd.jsonl").write_text("{")
    with sole_writer(tmp_path):
        present = {
            path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")
        }
    assert present == {*kept, ".lock", "checkpoints"}


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (InputError("a.csv: is full"), "a.csv: is full"),
        (RuntimeError("first\nsecond"), "{path}: first"),
        (RuntimeError(), "{path}: RuntimeError"),
    ],
)
def test_a_state_that_cannot_be_saved_is_told_in_one_line(tmp_path, error, message):
    def fail(*_):
        raise error

    with mock.patch.object(ocp, "save", fail), pytest.raises(TrainingError) as caught:
        save_state(tmp_path, 1, state_of(1), {})
    path = tmp_path / "step_00000001"
    assert (
        str(caught.value)
        == f"{message.format(path=path)}; what was saved before is kept"
    )
    assert names(tmp_path) == []


# One process imports everything, and forks those that are killed: importing takes
# seconds.
KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from neurosym_jax.training.state import save_state

folder = Path(sys.argv[1])
for line in sys.stdin:
    if pid := os.fork():
        print(pid, flush=True)
        os.waitpid(pid, 0)
        print("dead", flush=True)
        continue
    for step in range(int(line) + 1, sys.maxsize):
        save_state(folder, step, {"w": np.full((64, 8), step, np.float32)}, {"at": step})
        (folder.parent / "saved").write_text(str(step))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
def test_a_kill_at_any_moment_leaves_the_last_step_whole(tmp_path, capsys):
    folder, saved, rng = tmp_path / "run", tmp_path / "saved", random.Random(0)
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process: Any = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(folder)], **pipes
    )
    step, longest = 0, 0.4
    with process:
        for _ in range(10):
            print(step, file=process.stdin, flush=True)
            pid = int(process.stdout.readline())
            time.sleep(rng.uniform(0.0, longest))
            os.kill(pid, signal.SIGKILL)
            assert process.stdout.readline() == "dead\n"
            restored = restore_state(folder, {"w": np.zeros((64, 8), np.float32)})
            if restored is None:
                assert step == 0
                longest *= 2  # A busy machine saves nothing for long.
                continue
            state, step = restored[0], restored[1]["at"]
            assert_same(state, {"w": np.full((64, 8), step, np.float32)})
            # The number itself is not written whole or not at all.
            acknowledged = saved.read_text() if saved.exists() else ""
            if acknowledged:
                assert step >= int(acknowledged)
        process.stdin.close()
    assert step > 0
    assert "damaged" not in capsys.readouterr().err
