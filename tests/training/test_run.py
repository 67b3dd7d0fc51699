"""`neurosym train`: its data, and the real `train.py` in processes, killed and resumed."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from orbax.checkpoint import v1 as ocp

from neurosym_jax.commands.train import Options, make_run
from neurosym_jax.errors import InputError, InputWarning

SCRIPT = Path(__file__).resolve().parents[2] / "train.py"
LENGTHS = {"obs_len": 4, "pred_len": 4}


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


def begin(files, out, *more):
    """Start the training of a small model, on one thread."""
    arguments = {
        "--train-on": files / "walk.txt",
        "--validate-on": files / "check.txt",
        "--obs-len": 4,
        "--pred-len": 4,
        "--steps": 150,
        "--pooling": "none",  # The least to trace.
        "--out": out,
    }
    flat = [str(part) for pair in arguments.items() for part in pair]
    changes = ("batch_scenes=4", "best_k=2", "validate_every=25", "ema=0.9")
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), *flat, "--set", *changes, *more],
        env={**os.environ, "NPROC": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def final(folder):
    """All leaves of the last state, the digest of the model, and the metrics."""
    arrays = ocp.load(str(folder / "checkpoints" / "step_00000150" / "state"))
    state = {name: array.tobytes() for name, array in arrays.items()}
    model = json.loads((folder / "model" / "config.json").read_text())
    return state, model["sha256"], (folder / "metrics.jsonl").read_bytes()


@pytest.mark.slow
def test_a_kill_changes_nothing(files, tmp_path):
    """A run killed soon after a state was saved, and resumed in a fresh process: the same bits."""
    alone, killed = (begin(files, tmp_path / name) for name in ("alone", "run"))
    while killed.poll() is None and not list((tmp_path / "run" / "checkpoints").glob("step_*")):
        time.sleep(0.002)
    killed.kill()
    killed.communicate()
    assert not (tmp_path / "run" / "model").exists()
    for process in (alone, begin(files, tmp_path / "run", "--resume")):
        errors = process.communicate()[1]
        assert process.returncode == 0, errors
        assert "damaged" not in errors
    state, model, metrics = final(tmp_path / "run")
    assert (state, model, metrics) == final(tmp_path / "alone")
    assert state
    assert len(metrics.splitlines()) == 6


def test_bad_input_is_one_line(files, tmp_path):
    process = begin(files, tmp_path, "emma=0.9")
    errors = process.communicate()[1]
    assert process.returncode == 2
    assert errors.startswith("error: --set emma=0.9: must be NAME=VALUE, where NAME is one of")
    assert errors.count("\n") == 1


def test_a_model_knows_its_rate(files):
    names = {"train_on": ("walk",), "validate_on": ("check",), **LENGTHS}
    for period in (0.4, 0.2):
        run = make_run(Options(data=files, period=period, **names))
        assert run.network.period == run.training.period == run.validation.period == period
    assert run.training.scenes > 100


def test_one_recording_of_thor_left_out(shared):
    name = "CLiFF-LHMP_thor3_exp-3-run-2"
    with pytest.warns(InputWarning, match="goals_positions"):
        run = make_run(Options(model="neurosym", data=shared / "data/thor", dataset=name))
    assert run.dataset == name
    counts = [(part.scenes, part.agents) for part in (run.training, run.validation)]
    assert counts == [(2237, 7656), (496, 1699)]


def test_recordings_besides(files, tmp_path):
    (more := tmp_path / "more").mkdir()
    rows = np.loadtxt(files / "walk.txt")
    np.savetxt(more / "other.txt", rows[:, [0, 1, 3, 2]], fmt="%g")
    alone = make_run(Options(data=files, dataset="check", **LENGTHS))
    run = make_run(Options(data=files, dataset="check", train_also=(more,), **LENGTHS))
    besides = {"train_on": (str(more / "other.txt"),), "validate_on": ("check",)}
    whole = make_run(Options(data=files, **besides, **LENGTHS))
    assert run.training.scenes == alone.training.scenes + whole.training.scenes
    assert run.validation.scenes == alone.validation.scenes
    assert run.data == (files.name, "more")


def test_what_is_tested_or_validated_on_is_not_learned(files, tmp_path):
    (renamed := tmp_path / "part.txt").write_text(
        "".join((files / "check.txt").read_text().splitlines(keepends=True)[:40])
    )
    for dataset, place, message in (
        ("check", files, r"shapes of windows in check, .* tested on"),
        ("check", renamed, r"shapes of windows in check, .* tested on"),
        ("general", files, "what the model is validated on"),
    ):
        with pytest.raises(InputError, match=message):
            make_run(Options(data=files, dataset=dataset, train_also=(place,), **LENGTHS))


def test_nothing_left_out(files):
    run = make_run(Options(data=files, dataset="general", **LENGTHS))
    without = make_run(Options(data=files, dataset="check", **LENGTHS))
    assert run.dataset == "general"
    assert run.training.scenes > without.training.scenes


def test_options_that_contradict(files):
    for options, message in (
        ({"dataset": "general"}, "general is for models of real people"),
        ({"train_on": ("walk.txt",)}, "go together"),
        ({"data": files}, "--dataset is needed"),
    ):
        with pytest.raises(InputError, match=message):
            make_run(Options(**options, **LENGTHS))
