"""Sweeps: which runs there are, what trains them, and what is reported of them."""

import dataclasses
import json

import pytest
import tyro

from neurosym_jax.commands._running import load_plugins
from neurosym_jax.commands.train import Options, make_run
from neurosym_jax.errors import InputError
from neurosym_jax.training.sweep import Sweep, plan_runs, run_sweep

CHOSEN = Sweep(
    models=("sgan", "neurosym"), weightings=("cnd", "ones"), datasets=("cross-path",), seeds=(0, 1)
)


def test_runs():
    chosen = dataclasses.replace(CHOSEN, pred_lens=(8, 12))
    runs = plan_runs(chosen)
    assert len({run.folder for run in runs}) == len(runs) == 3 * 2 * 2
    names = {run.folder.name.partition("_cross-path")[0] for run in runs}
    assert names == {"sgan_pool_net", "neurosym_as_described_cnd", "neurosym_as_described_ones"}
    assert len(plan_runs(dataclasses.replace(chosen, datasets=()))) == 2 * len(runs)
    for changes, reason in (
        ({"seeds": ()}, "--seeds and --models: at least one"),
        ({"models": ("lstm",)}, "unknown pooling 'lstm'"),
        ({"datasets": ("moon",)}, "unknown dataset 'moon': there are all-forward, cross-path"),
        ({"set": ("emma=1",)}, "--set emma=1"),
        ({"network": ("emma=1",)}, "--network emma=1"),
    ):
        with pytest.raises(InputError, match=reason):
            plan_runs(dataclasses.replace(chosen, **changes))
    with pytest.raises(InputError, match="--jobs must be at least 1"):
        run_sweep(chosen, runs, jobs=0)


def test_a_run_is_what_its_command_trains(monkeypatch):
    """Its process is told of everything that makes the run, plugins included."""
    plugins = []
    monkeypatch.setattr("neurosym_jax.training.sweep.loaded", lambda: ["mine.py"])
    monkeypatch.setattr("neurosym_jax.commands._running.load_plugin", plugins.append)
    changes = {"set": ("batch_scenes=4", "rotate=0"), "network": ("encoder_h_dim=16",)}
    models = ("sgan", "social", "neurosym", "neurosym_ros")
    for run in plan_runs(dataclasses.replace(CHOSEN, models=models, steps=10, **changes)):
        options = tyro.cli(Options, args=load_plugins(run.arguments))
        assert plugins.pop() == "mine.py"
        assert (options.out, options.resume) == (run.folder, True)
        described = make_run(options)
        assert (described.network, described.recipe) == (run.network, run.recipe)
        assert described.dataset == run.dataset


@pytest.mark.slow
def test_a_sweep_is_finished_once_and_reports_what_failed(tmp_path, monkeypatch, capsys):
    how = {"set": ("batch_scenes=4", "best_k=2", "max_agents=4"), "steps": 25}
    sweep = dataclasses.replace(CHOSEN, models=("none",), out=tmp_path / "sweep", **how)
    first, second = plan_runs(sweep)
    (deadly := tmp_path / "deadly.py").write_text("import os\nos.kill(os.getpid(), 9)")
    killed = dataclasses.replace(first, arguments=(*first.arguments, "--plugin", str(deadly)))
    second.model.mkdir(parents=True)  # Not the model of a finished run.
    with pytest.raises(InputError, match="no run was finished"):
        run_sweep(sweep, [killed, second])
    errors = capsys.readouterr().err
    assert errors.count("status -9") == 1
    assert errors.count("holds a finished model, and nothing is overwritten") == 1
    second.model.rmdir()

    # One job, so that the second run finds the first one's compiled programs.
    assert run_sweep(sweep, [first, second], jobs=1) == 0
    rows = json.loads((sweep.out / "sweep.json").read_text())["rows"]
    trained = [row for row in rows if row["training_seed"] is not None]
    assert [row["model"] for row in rows[:2]] == ["constant velocity", "constant velocity, sampled"]
    assert [row["training_seed"] for row in trained] == [0, 1]
    assert len({row["joint_ade"] for row in trained}) == 2
    table = (sweep.out / "sweep.md").read_text()
    assert "SGAN, no pooling (2 trainings) | 20 |" in table
    card = (second.model / "README.md").read_text()
    assert "test on cross-path: this model" in card
    assert "threads | 1" in card

    monkeypatch.setattr("neurosym_jax.training.sweep.subprocess", None)  # Nothing is trained again.
    capsys.readouterr()
    assert run_sweep(sweep, [first, second]) == 0
    assert "2 runs, 2 of them finished before" in capsys.readouterr().out
    with pytest.raises(InputError, match="its training differs: choose another --out"):
        run_sweep(sweep, plan_runs(dataclasses.replace(sweep, steps=50)))
