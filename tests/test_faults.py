"""Whatever fails on the disk: every file is the old or the new one, whole, and work goes on."""

import errno
import functools
import itertools
import json
import shutil

import jax
import numpy as np
import pytest

from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.report import evaluate_into, write_report
from neurosym_jax.evaluation.results import Settings
from neurosym_jax.evaluation.test_sets import TestSet as Case
from neurosym_jax.evaluation.test_sets import baseline, make_test
from neurosym_jax.models import Generator
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.runtime.files import write_text
from neurosym_jax.scene import make_scene
from neurosym_jax.training import loop
from neurosym_jax.training.recipe import TrainConfig
from neurosym_jax.training.run import Run
from neurosym_jax.training.step import TrainState
from tests.faults import failing

NETWORK = GeneratorConfig(obs_len=2, pred_len=1, pooling="none", embedding_dim=2, mlp_dim=2)
RECIPE = TrainConfig(steps=1, batch_scenes=1)


@pytest.fixture(scope="module")
def params():
    scene = make_scene(np.zeros((1, 2, 2)))
    arguments = (scene, np.zeros(8), np.zeros((1, 1, 2)))
    return jax.tree.map(np.asarray, jax.jit(Generator(NETWORK).init)(jax.random.key(0), *arguments))


def every_fault(work, check):
    """Let each operation of `work()` fail in turn, and call `check(done)` after each.

    Where `work` is not `done`, it failed in one line.
    """
    for at in itertools.count(1):
        failed = None
        with failing(at) as faults:
            try:
                work()
            except (InputError, OSError) as error:
                failed = error
        # Of an error of the disk commands make a line.
        assert "\n" not in str(failed)
        assert not isinstance(failed, OSError) or failed.errno == errno.ENOSPC
        check(failed is None)
        if faults.count < at:
            assert failed is None
            assert at > 5, "no faults were made"
            return


@pytest.fixture
def run_of(params, monkeypatch):
    """A run of two steps whose network learns nothing, so that only its files take time."""
    windows = Windows(
        position=np.cumsum(np.ones((4, 3, 2)), axis=1),
        agent=np.arange(4),
        bounds=np.array([0, 2, 4]),
        identity=np.zeros((2, 2), np.uint32),
        obs_len=2,
    )

    def advance(state, done, count):
        return state._replace(step=np.int32(state.step + count)), {"g_loss": np.ones(count)}

    monkeypatch.setattr(loop, "start_of", lambda _: TrainState(np.int32(0), params, (), ()))
    monkeypatch.setattr(loop, "rounds_of", lambda _: advance)
    values = {"val_ade": 1.0, "val_fde": 1.0, "val_score": 2.0}
    monkeypatch.setattr(loop, "_validate", lambda *_: dict(values))
    # As figures are written, but drawn in no time.
    draw = lambda figure, path: write_text(path, "drawn" * 100)  # noqa: E731
    monkeypatch.setattr("neurosym_jax.plotting.save_figure", draw)
    monkeypatch.setattr("neurosym_jax.plotting.plot_training", lambda *_: None)
    monkeypatch.setattr(loop, "code_version", lambda: "1")
    monkeypatch.setattr(loop, "record_of", functools.cache(loop.record_of))
    return Run(NETWORK, RECIPE, windows, windows, "zara1")


def files_of(folder):
    """What a finished run has, but for checkpoints."""
    names = ("metrics.jsonl", "run.json", "curves.png")
    whole = {name: (folder / name).read_bytes() for name in names}
    return whole | {path.name: path.read_bytes() for path in (folder / "model").iterdir()}


@pytest.mark.slow
def test_a_training_run_is_whole_or_goes_on(run_of, tmp_path, capsys):
    loop.train_run(run_of, tmp_path / "alone")
    wanted = files_of(tmp_path / "alone")

    folder = tmp_path / "run"

    def check(done):
        log = folder / "metrics.jsonl"  # The one file that grows: a part of it is a part of all.
        assert not log.exists() or wanted[log.name].startswith(log.read_bytes())
        for name in ("run.json", "curves.png"):
            assert not (folder / name).exists() or (folder / name).read_bytes() == wanted[name]
        if done or (folder / "model").exists():
            assert files_of(folder) == wanted
        loop.train_run(run_of, folder, resume=True)
        assert files_of(folder) == wanted
        assert "damaged" not in capsys.readouterr().err
        assert {path.name for path in folder.rglob(".*")} <= {".lock", ".scratch"}
        shutil.rmtree(folder)

    every_fault(lambda: loop.train_run(run_of, folder), check)


def test_a_report_is_the_old_or_the_new_one(tmp_path):
    path = tmp_path / "rows.json"
    old, new = ([{"model": number}] * 100 for number in (1, 2))

    def check(done):
        found = json.loads(path.read_text())["rows"]
        assert found == new if done else found in (old, new)
        assert [each.name for each in tmp_path.iterdir()] == ["rows.json"]
        write_report(path, old, {})

    write_report(path, old, {})
    every_fault(lambda: write_report(path, new, {}), check)


def test_an_evaluation_keeps_its_rows_and_goes_on(tmp_path):
    stamp, person = np.divmod(np.arange(12), 2)
    tracks = make_tracks("walk", stamp, person, np.stack([stamp, 1.0 * person], 1))
    entries = [(None, baseline("constant_velocity", 2, 1))] * 2
    test = make_test(Case("walk", 2, 1), entries, [tracks])
    path = tmp_path / "rows.json"

    def found():
        return [row["joint_ade"] for row in json.loads(path.read_text())["rows"]]

    def work(resume=False):
        evaluate_into(path, [test], Settings(samples=1, metrics=("joint_ade",)), resume=resume)

    work()
    wanted, log = found(), path.with_suffix(".jsonl")

    def check(done):
        assert found() == wanted  # The report of before, or the new one.
        kept = log.read_text().count("\n")
        work(resume=True)
        assert found() == wanted
        assert log.read_text().count("\n") == 2 >= kept
        assert {each.name for each in tmp_path.iterdir()} == {"rows.json", "rows.jsonl"}

    every_fault(work, check)
