"""Training states survive kills, flipped bytes and NaNs, bit for bit."""

import os
import random
import shutil
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
from flax import struct
from orbax.checkpoint import v1 as ocp

from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.training.checkpoints import TrainingCheckpoints

RECORD = {"config": {"lr": 1e-3, "name": "sgan é"}, "history": [{"step": 1, "ade": 0.1 + 0.2}]}


class Odd(NamedTuple):
    half: Any
    brain: Any
    flags: Any
    bits: Any
    empty: Any
    fortran: Any
    strided: Any


@struct.dataclass
class State:
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
    odd = Odd(
        half=np.float16([1.5, -0.0]),
        brain=jnp.asarray(rng.normal(size=3), jnp.bfloat16),
        flags=np.array([True, False]),
        bits=rng.integers(0, 2**63, 3),
        empty=np.zeros((0, 3), np.float32),
        fortran=np.asfortranarray(rng.normal(size=(2, 3))),
        strided=np.arange(6.0)[::2],
    )
    key = jax.random.key_data(jax.random.key(seed))
    return State(params, optimiser.init(params), np.int32(seed), key, odd)


def assert_same(one: Any, two: Any) -> None:
    assert jax.tree.structure(one) == jax.tree.structure(two)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        a, b = np.asarray(a), np.asarray(b)
        assert (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())


def restored(folder: Path, template: Any) -> tuple[int, Any, dict[str, Any]]:
    found = TrainingCheckpoints(folder).restore(template)
    assert found is not None
    return found


def steps(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def two_steps(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    checkpoints = TrainingCheckpoints(folder)
    checkpoints.save(1, make_state(1), {"at": 1}, 0.5)
    checkpoints.save(2, make_state(2), {"at": 2}, 0.4)
    return folder


def test_round_trip_is_bit_identical(tmp_path):
    state = make_state(3)
    checkpoints = TrainingCheckpoints(tmp_path / "new" / "run")
    assert checkpoints.restore(state) is None
    checkpoints.save(7, state, RECORD, 0.25)
    step, again, record = restored(tmp_path / "new" / "run", make_state(0))
    assert (step, record) == (7, RECORD)
    assert_same(again, state)
    assert again.step.shape == ()
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), state.params)
    again = restored(tmp_path / "new" / "run", state.replace(params=shapes))[1]
    assert_same(again, state)


def test_numbers_as_keys_of_the_record_become_text(tmp_path):
    checkpoints = TrainingCheckpoints(tmp_path)
    checkpoints.save(1, {"a": np.ones(2)}, {10: "ten", 9: (1, 2)}, 0.0)
    assert checkpoints.restore({"a": np.ones(2)})[2] == {"10": "ten", "9": [1, 2]}


def test_the_two_newest_and_the_best_are_kept(tmp_path):
    metrics = [0.5, 0.2, 0.4, 0.3, 0.2, 0.9, 0.8, 0.7]
    kept = [[1], [1, 2], [2, 3], [2, 3, 4], [4, 5], [5, 6], [5, 6, 7], [5, 7, 8]]
    checkpoints = TrainingCheckpoints(tmp_path)
    for step, (metric, names) in enumerate(zip(metrics, kept), start=1):
        checkpoints.save(step, {"a": np.full(3, step)}, {}, metric)
        assert steps(tmp_path) == [f"step_{name:08d}" for name in names]
    assert restored(tmp_path, {"a": np.zeros(3, int)})[0] == 8


WEIGHTS = {name: {"w": np.array([1.0, np.nan], name)} for name in ("bfloat16", "float16")}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metric": float("nan")}, "metric is nan: step 3 .* step 2 is kept"),
        ({"metric": np.float32("inf")}, "metric is inf: step 3 .* step 2 is kept"),
        ({"params": WEIGHTS["bfloat16"]}, r"params\['w'\] is not finite: .* step 2 is kept"),
        ({"params": WEIGHTS["float16"]}, r"params\['w'\] is not finite: .* step 2 is kept"),
        ({"record": {"ade": float("nan")}}, "record is not JSON .* step 2 is kept"),
        ({"record": {"array": np.zeros(2)}}, "record is not JSON"),
        ({"step": 2}, "step 2 is not after step 2, which is already there: resume"),
        ({"step": 1}, "step 1 is not after step 2"),
    ],
)
def test_what_cannot_be_saved_is_refused(tmp_path, two_steps, changes, message):
    folder = shutil.copytree(two_steps, tmp_path / "run")
    given = {"step": 3, "params": {}, "record": {}, "metric": 0.1} | changes
    state = make_state(3).replace(params=given.pop("params"))
    with pytest.raises(TrainingError, match=message):
        TrainingCheckpoints(folder).save(given.pop("step"), state, **given)
    assert steps(folder) == steps(two_steps)
    assert_same(restored(folder, make_state(0))[1], make_state(2))


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
        TrainingCheckpoints(two_steps).restore(make_state(0).replace(**change))
    assert steps(two_steps) == ["step_00000001", "step_00000002"]


def files(folder: Path) -> list[Path]:
    """The files of the newest step that have any bytes."""
    paths = sorted((folder / "step_00000002").rglob("*"))
    return [path for path in paths if path.is_file() and path.stat().st_size]


def assert_falls_back(folder: Path, capsys: Any) -> None:
    capsys.readouterr()
    step, state, record = restored(folder, make_state(0))
    assert record == {"at": step}
    assert_same(state, make_state(step))
    if step == 1:
        assert "step 2 is damaged and passed over: " in capsys.readouterr().err
        assert steps(folder) == ["damaged_step_00000002", "step_00000001"]


@pytest.mark.slow
def test_a_flipped_byte_never_restores_other_leaves(tmp_path, two_steps, capsys):
    rng = random.Random(0)
    for trial in range(100):
        folder = shutil.copytree(two_steps, tmp_path / str(trial))
        path = rng.choice(files(folder))
        content = bytearray(path.read_bytes())
        content[rng.randrange(len(content))] ^= rng.randrange(1, 256)
        path.write_bytes(content)
        assert_falls_back(folder, capsys)
        shutil.rmtree(folder)


@pytest.mark.slow
@pytest.mark.parametrize("cut", ["empty", "half", "last byte", "missing"])
def test_a_truncated_file_falls_back(tmp_path, two_steps, capsys, cut):
    for path in files(two_steps):
        folder = shutil.copytree(two_steps, tmp_path / path.name)
        broken = folder / path.relative_to(two_steps)
        size = path.stat().st_size
        if cut == "missing":
            broken.unlink()
        else:
            os.truncate(broken, {"empty": 0, "half": size // 2, "last byte": size - 1}[cut])
        assert_falls_back(folder, capsys)
        shutil.rmtree(folder)


def test_orbax_never_reads_an_altered_file(tmp_path, two_steps, capsys, monkeypatch):
    load = ocp.load

    def load_first(path):
        return load(path) if "_00000001/" in path else pytest.fail(f"{path} was read")

    monkeypatch.setattr(ocp, "load", load_first)
    for path in files(two_steps):
        folder = shutil.copytree(two_steps, tmp_path / "run")
        with open(folder / path.relative_to(two_steps), "ab") as file:
            file.write(b"?")
        assert_falls_back(folder, capsys)
        shutil.rmtree(folder)


def test_nothing_whole_is_none_and_training_goes_on_after_a_fallback(tmp_path, two_steps, capsys):
    folder = shutil.copytree(two_steps, tmp_path / "run")
    (folder / "step_00000002" / "step.json").write_text("{}")
    assert restored(folder, make_state(0))[0] == 1
    TrainingCheckpoints(folder).save(2, make_state(2), {"at": 2}, 0.4)
    assert_same(restored(folder, make_state(0))[1], make_state(2))
    for name in ("step_00000001", "step_00000002"):
        (folder / name / "step.json").unlink()
    assert TrainingCheckpoints(folder).restore(make_state(0)) is None
    assert capsys.readouterr().err.count("warning: ") == 3


def test_a_damaged_step_is_not_pruned_unseen(tmp_path, two_steps):
    folder = shutil.copytree(two_steps, tmp_path / "run")
    (folder / "step_00000001" / "step.json").write_text("{")  # Its metric cannot be read.
    for step in (3, 4):
        TrainingCheckpoints(folder).save(step, make_state(step), {}, 0.6)
    assert steps(folder) == [f"step_{step:08d}" for step in (1, 2, 3, 4)]


# One process imports everything, and forks those that are killed: importing takes seconds.
KILLED = """
import os, sys
from pathlib import Path
import numpy as np
from orbax.checkpoint import v1
from neurosym_jax.training.checkpoints import TrainingCheckpoints

folder = Path(sys.argv[1])
for line in sys.stdin:
    pid = os.fork()
    if pid:
        print(pid, flush=True)
        os.waitpid(pid, 0)
        print("dead", flush=True)
        continue
    checkpoints = TrainingCheckpoints(folder)
    step = int(line)
    while True:
        step += 1
        state = {"w": np.full((64, 8), step, np.float32), "step": np.int32(step)}
        checkpoints.save(step, state, {"at": step}, 1.0 / step)
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
            found = TrainingCheckpoints(folder).restore(template)
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
    assert len([name for name in steps(folder) if name.startswith("step_")]) <= 3
