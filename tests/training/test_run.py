"""`neurosym train`: its data, and the real `train.py` in processes, killed and resumed."""

import dataclasses
import json
import os
import struct
import subprocess
import sys
import time

import numpy as np
import pytest

from neurosym_jax.commands import train
from neurosym_jax.commands.train import Options, closing_line, make_run
from neurosym_jax.data.tables import ReadOptions
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.models.disk import load_model
from tests.repository import ROOT

LENGTHS = {"obs_len": 4, "pred_len": 4}


def begin(files, out, *options):
    """Start the training of a small model, on one thread."""
    data = (
        "--train-on",
        files / "walk.txt",
        "--validate-on",
        files / "check.txt",
        "--out",
        out,
    )
    training = (
        "--obs-len",
        4,
        "--pred-len",
        4,
        "--steps",
        100,
        "--family",
        "anchor_table",
    )
    changes = ("--set", "batch_scenes=4", "validate_every=25", "ema=0.9")
    return subprocess.Popen(
        [
            sys.executable,
            *map(str, (ROOT / "train.py", *data, *training, *changes, *options)),
        ],
        env={**os.environ, "NPROC": "1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.slow
def test_a_kill_changes_nothing(files, tmp_path, final):
    """A run killed soon after its first state and then model were saved, and resumed in a fresh
    process: the same bits.
    """
    killed = begin(files, tmp_path / "run")
    while killed.poll() is None and not (tmp_path / "run" / "model").is_dir():
        time.sleep(0.002)
    killed.kill()
    killed.communicate()
    assert load_model(tmp_path / "run").step
    assert list((tmp_path / "run" / "checkpoints").glob("step_*"))
    assert not (tmp_path / "run" / "run.json").exists()
    # The other run begins here, so that it finds the killed one's compiled programs.
    alone = begin(files, tmp_path / "alone")
    for process in (alone, begin(files, tmp_path / "run", "--resume")):
        errors = process.communicate()[1]
        assert process.returncode == 0, errors
        assert "damaged" not in errors
    state, model, metrics = final(tmp_path / "run")
    assert (state, model, metrics) == final(tmp_path / "alone")
    assert state
    assert len(metrics.splitlines()) == 4


def events(folder):
    """(step, name, value) of all scalars in the event files of a folder, the first file first."""
    from tensorboardX.proto import event_pb2  # pyright: ignore[reportMissingImports]

    scalars = []
    for path in sorted(folder.glob("events.*")):
        content = path.read_bytes()
        while content:
            (size,) = struct.unpack(
                "<Q", content[:8]
            )  # Then 4 bytes of checksum, twice.
            event = event_pb2.Event.FromString(content[12 : 12 + size])
            scalars += [
                (event.step, value.tag, value.simple_value)
                for value in event.summary.value
            ]
            content = content[16 + size :]
    return scalars


SMALL = {
    "family": "anchor_table",
    "steps": 2,
    "set": ("batch_scenes=4", "validate_every=1"),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_tensorboard_has_the_rows(files, tmp_path):
    pytest.importorskip("tensorboardX", reason="tensorboardX is not installed")
    split = {"train_on": ("walk",), "validate_on": ("check",)}
    options = Options(data=files, **split, **LENGTHS, **SMALL, out=tmp_path)
    train.run(dataclasses.replace(options, log="tensorboard"))
    expected = []
    for line in (tmp_path / "metrics.jsonl").read_text().splitlines():
        row = json.loads(line)
        step = row.pop("step")
        expected += [(step, name, row[name]) for name in sorted(row)]
    assert {step for step, *_ in expected} == {1, 2}
    for scalar, (step, name, value) in zip(events(tmp_path), expected, strict=True):
        assert scalar == (step, name, pytest.approx(value, rel=1e-6))


def test_a_change_of_the_network_may_be_its_period():
    assert train.configured(Options(network=("period=0.2",)))[0].period == 0.2


def test_one_recording_of_thor_left_out(shared):
    name = "CLiFF-LHMP_thor3_exp-3-run-2"
    with pytest.warns(InputWarning, match="goals_positions"):
        run, _ = make_run(
            Options(family="neurosym", data=shared / "data/thor", dataset=name)
        )
    assert run.dataset == name
    counts = [(part.scenes, part.agents) for part in (run.training, run.validation)]
    assert counts == [(2093, 7177), (564, 1959)]


def test_further_recordings_are_learned_and_test_sets_never(files, tmp_path):
    """Whatever its file is called."""
    folder = tmp_path / "more"
    folder.mkdir()
    rows = np.loadtxt(files / "walk.txt")
    np.savetxt(folder / "other.txt", rows[:, [0, 1, 3, 2]], fmt="%g")
    alone, _ = make_run(Options(data=files, dataset="check", **LENGTHS))
    run, _ = make_run(
        Options(data=files, dataset="check", train_also=(folder,), **LENGTHS)
    )
    besides = {"train_on": (str(folder / "other.txt"),), "validate_on": ("check",)}
    with_other, _ = make_run(Options(data=files, **besides, **LENGTHS))
    assert run.training.scenes == alone.training.scenes + with_other.training.scenes
    assert run.validation.scenes == alone.validation.scenes
    assert run.data == (files.name, "more")
    general, _ = make_run(Options(data=files, dataset="general", **LENGTHS))
    assert general.dataset == "general"
    assert general.training.scenes > alone.training.scenes
    renamed = tmp_path / "part.txt"
    renamed.write_text(
        "".join((files / "check.txt").read_text().splitlines(keepends=True)[:40])
    )
    leaked = r"shapes of windows in check, .* tested on"
    for options, message in (
        ({"data": files, "dataset": "check", "train_also": (files,)}, leaked),
        ({"data": files, "dataset": "check", "train_also": (renamed,)}, leaked),
        (
            {"data": files, "dataset": "general", "train_also": (files,)},
            "model is validated on",
        ),
    ):
        with pytest.raises(InputError, match=message):
            make_run(Options(**options, **LENGTHS))


def last_line(tmp_path, **options):
    options = Options(**options, **LENGTHS)
    return closing_line(options, *make_run(options), tmp_path / "run")


def test_the_last_line_tests_on_what_was_not_seen(files, tmp_path):
    """Point 2: it tested on training data after general, and on simulations after --train-on."""
    walk, check = str(files / "walk.txt"), str(files / "check.txt")
    begin = f"test it: neurosym evaluate --model {tmp_path / 'run'}"
    nothing = "nothing is left to test on: test on a new recording: neurosym evaluate "
    for options, line in (
        ({}, begin),
        ({"dataset": "cross-path"}, begin),
        ({"data": files, "dataset": "check"}, f"{begin} --data {files}"),
        (
            {
                "data": files,
                "dataset": "check",
                "period": 0.2,
                "read": ReadOptions(max_gap=2.0),
            },
            f"{begin} --data {files} --max-gap 2 --period 0.2",
        ),
        ({"data": files, "dataset": "general"}, nothing),
        ({"data": files / "walk.txt"}, nothing),
        (
            {"data": files, "train_on": ("walk",)},
            f"{begin} --data {files} --test-on check",
        ),
        ({"data": files, "train_on": ("walk",), "validate_on": ("check",)}, nothing),
        ({"train_on": (walk,), "validate_on": (check,)}, nothing),
    ):
        text = last_line(tmp_path, **options)
        assert text.startswith(line) if line == nothing else text == line, options
    text = last_line(tmp_path, data=files / "walk.txt", period=0.3)
    assert text.endswith("--data NEW_RECORDING --period 0.3")


def test_folders_of_ones_own(files, tmp_path):
    """Point 5: train, val and test were no recordings, and --train-on took no folder."""
    rows = np.loadtxt(files / "walk.txt")
    for folder, turn in (("train", (1, 1)), ("validation", (-1, 1)), ("test", (1, -1))):
        (tmp_path / folder).mkdir()
        turned = rows * [1, 1, *turn]
        np.savetxt(tmp_path / folder / f"{folder}1.txt", turned, fmt="%g")
    run, source = make_run(Options(data=tmp_path, **LENGTHS))
    names = [part.reading[0].recording for part in (run.training, run.validation)]
    assert (names, source.scenes, run.dataset) == (
        ["train1", "validation1"],
        ("test1",),
        None,
    )
    assert last_line(tmp_path, data=tmp_path).endswith(f"--data {tmp_path}")
    places = {
        "train_on": (str(tmp_path / "train"),),
        "validate_on": (str(tmp_path / "validation"),),
    }
    other, _ = make_run(Options(**places, **LENGTHS))
    assert other.training.scenes == run.training.scenes
    (tmp_path / "test/test1.txt").write_bytes(
        (tmp_path / "train/train1.txt").read_bytes()
    )
    with pytest.raises(InputError, match="that is what the model is tested on"):
        make_run(Options(data=tmp_path, **LENGTHS))


def test_a_single_recording_needs_no_name_and_is_named(files, capsys, tmp_path):
    """Point 6, and the first lines of point 5."""
    train.run(Options(data=files / "walk.txt", out=tmp_path, **LENGTHS, **SMALL))
    output = capsys.readouterr().out
    assert "windows to learn from / to validate on:\n  walk: 27 / 11\n" in output
    assert "nothing is left to test on" in output
