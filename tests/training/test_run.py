"""The real `train.py`, in processes of its own: kills, resumption, fresh processes, bad input."""

import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from orbax.checkpoint import v1 as ocp

from neurosym_jax.commands.train import Options, _test_of, make_run
from neurosym_jax.errors import InputError, InputWarning

SCRIPT = Path(__file__).resolve().parents[2] / "train.py"
EVERY_KILL = bool(os.environ.get("NEUROSYM_ALL_KILLS"))
STEPS = 2000 if EVERY_KILL else 150
KILLS = 20 if EVERY_KILL else 2


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two recordings of people who walk about."""
    folder = tmp_path_factory.mktemp("data")
    rng = np.random.default_rng(0)
    for name, frames in (("walk", 60), ("check", 30)):
        position = rng.uniform(-3, 3, (5, 1, 2)) + rng.normal(0.1, 0.2, (5, frames, 2)).cumsum(1)
        (folder / f"{name}.txt").write_text(
            "".join(
                f"{10 * frame}\t{person}\t{x:.3f}\t{y:.3f}\n"
                for frame in range(frames)
                for person, (x, y) in enumerate(position[:, frame])
            )
        )
    return folder


def command(files, out, *more):
    arguments = {
        "--train-on": files / "walk.txt",
        "--validate-on": files / "check.txt",
        "--obs-len": 4,
        "--pred-len": 4,
        "--steps": STEPS,
        "--out": out,
    }
    flat = [str(part) for pair in arguments.items() for part in pair]
    changes = ("batch_scenes=4", "best_k=2", "validate_every=25", "ema=0.9")
    flat += ["--pooling", "none"]  # The least to trace.
    return [sys.executable, str(SCRIPT), *flat, "--set", *changes, *more]


ENVIRONMENT = {**os.environ, "NPROC": "1"}


def final(folder):
    """All leaves of the last state, the digest of the model, and the metrics."""
    arrays = ocp.load(str(folder / "checkpoints" / f"step_{STEPS:08d}" / "state"))
    state = {name: array.tobytes() for name, array in arrays.items()}
    model = json.loads((folder / "model" / "config.json").read_text())
    return state, model["sha256"], (folder / "metrics.jsonl").read_bytes()


def train(files, out, *more):
    done = subprocess.run(
        command(files, out, *more), env=ENVIRONMENT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert "damaged" not in done.stderr


@pytest.mark.slow
def test_kills_change_nothing(files, tmp_path):
    """A run that is killed and resumed ends as one left alone, in fresh processes: the same bits.

    It is killed twice, soon after a step was saved and at any moment; 20 times of a longer run
    where NEUROSYM_ALL_KILLS is set.
    """
    start = time.monotonic()
    train(files, tmp_path / "alone")
    seconds = time.monotonic() - start
    run = tmp_path / "run"
    draw, kills = random.Random(time.time_ns()), 0

    def steps():
        return set((run / "checkpoints").glob("step_*"))

    while kills < KILLS:
        before, born = steps(), time.monotonic()
        process = subprocess.Popen(
            command(files, run, "--resume"),
            env=ENVIRONMENT,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        limit = draw.uniform(0, min(seconds, 6.0)) if kills % 2 else 600.0
        while process.poll() is None and time.monotonic() - born < limit:
            if limit == 600.0 and steps() - before:
                limit = time.monotonic() - born + draw.uniform(0, 1.0 if EVERY_KILL else 0.05)
            time.sleep(0.002)
        if process.poll() is None:
            process.kill()
            kills += 1
        _, errors = process.communicate()
        assert process.returncode in (0, -9), errors
        assert "damaged" not in errors
        if process.returncode == 0:
            break
    assert kills == KILLS or not EVERY_KILL
    assert kills
    train(files, run, "--resume")
    state, model, metrics = final(run)
    assert (state, model, metrics) == final(tmp_path / "alone")
    assert state
    assert len(model) == 64
    assert len(metrics.splitlines()) == STEPS // 25


def test_bad_input_is_one_line(files, tmp_path):
    done = subprocess.run(
        command(files, tmp_path, "emma=0.9"), env=ENVIRONMENT, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.startswith("error: --set emma=0.9: must be NAME=VALUE, where NAME is one of")
    assert done.stderr.count("\n") == 1


def test_the_next_command_names_data_and_plugins(files, tmp_path, monkeypatch):
    monkeypatch.setattr("neurosym_jax.commands.train.loaded", lambda: ["mine.py"])
    command = _test_of(Options(data=files, dataset="check"), tmp_path)
    assert command.endswith(f"--data {files} --dataset check --plugin mine.py")


def test_a_model_knows_its_rate(files):
    names = {"train_on": ("walk",), "validate_on": ("check",), "obs_len": 4, "pred_len": 4}
    for period in (0.4, 0.2):
        run = make_run(Options(data=files, period=period, **names))
        assert run.network.period == run.training.period == run.validation.period == period
    assert run.training.scenes > 100


@pytest.mark.parametrize("model", ["sgan", "neurosym"])
def test_one_recording_of_thor_left_out(shared, model):
    name = "CLiFF-LHMP_thor3_exp-3-run-2"
    with pytest.warns(InputWarning, match="goals_positions"):
        run = make_run(Options(model=model, data=shared / "data/thor", dataset=name))
    assert run.dataset == name
    assert run.data_name == f"trained without {name}"
    counts = [(part.scenes, part.agents) for part in (run.training, run.validation)]
    assert counts == [(2237, 7656), (496, 1699)]


def test_recordings_besides(files, tmp_path):
    (more := tmp_path / "more").mkdir()
    rows = np.loadtxt(files / "walk.txt")
    np.savetxt(more / "other.txt", rows[:, [0, 1, 3, 2]], fmt="%g")
    lengths = {"obs_len": 4, "pred_len": 4}
    alone = make_run(Options(data=files, dataset="check", **lengths))
    run = make_run(Options(data=files, dataset="check", train_also=(more,), **lengths))
    whole = make_run(
        Options(train_on=(str(more / "other.txt"),), validate_on=("check",), data=files, **lengths)
    )
    assert run.training.scenes == alone.training.scenes + whole.training.scenes
    assert run.validation.scenes == alone.validation.scenes
    assert run.data_name == "trained without check, and on more"
    with pytest.raises(InputError, match=r"shapes of windows in check, .* tested on"):
        make_run(Options(data=files, dataset="check", train_also=(files,), **lengths))
    (renamed := tmp_path / "part.txt").write_text(
        "".join((files / "check.txt").read_text().splitlines(keepends=True)[:40])
    )
    with pytest.raises(InputError, match=r"shapes of windows in check, .* tested on"):
        make_run(Options(data=files, dataset="check", train_also=(renamed,), **lengths))
    with pytest.raises(InputError, match="what the model is validated on"):
        make_run(Options(data=files, dataset="general", train_also=(files,), **lengths))


def test_nothing_left_out(files):
    lengths = {"obs_len": 4, "pred_len": 4}
    run = make_run(Options(data=files, dataset="general", **lengths))
    without = make_run(Options(data=files, dataset="check", **lengths))
    assert run.dataset == "general"
    assert run.data_name == f"trained on all of {files}"
    assert run.training.scenes > without.training.scenes
    with pytest.raises(InputError, match="general is for models of real people"):
        make_run(Options(dataset="general"))


def test_data(files):
    options = Options(train_on=(str(files / "walk.txt"),), obs_len=4, pred_len=4)
    with pytest.raises(InputError, match="go together"):
        make_run(options)
    with pytest.raises(InputError, match="--dataset is needed"):
        make_run(Options(data=files))
