import dataclasses
import json
from pathlib import Path

import pytest
import tyro

from neurosym_jax.commands._running import load_plugins
from neurosym_jax.commands.train import Options, make_run
from neurosym_jax.errors import InputError
from neurosym_jax.training.sweep import run_sweep
from neurosym_jax.training.sweep_plan import plan_runs

ROOT = Path(__file__).parents[2]


CHOSEN = {
    "models": ("sgan", "neurosym"),
    "weightings": ("cnd", "ones"),
    "datasets": ("cross-path",),
}


def test_runs(tmp_path):
    chosen = {**CHOSEN, "seeds": (0, 1), "pred_lens": (8, 12)}
    runs = plan_runs(tmp_path, **chosen)
    assert len({run.folder for run in runs}) == len(runs) == 3 * 2 * 2
    names = {run.folder.name.partition("_cross-path")[0] for run in runs}
    assert names == {"sgan_pool_net", "neurosym_as_described_cnd", "neurosym_as_described_ones"}
    assert len(plan_runs(tmp_path, **{**chosen, "datasets": ()})) == 2 * len(runs)
    for changes, reason in (
        ({"seeds": ()}, "--seeds and --models: at least one"),
        ({"models": ("lstm",)}, "unknown pooling 'lstm'"),
        ({"datasets": ("moon",)}, "unknown dataset 'moon': there are all-forward, cross-path"),
        ({"changes": ("emma=1",)}, "--set emma=1"),
        ({"network": ("emma=1",)}, "--network emma=1"),
    ):
        with pytest.raises(InputError, match=reason):
            plan_runs(tmp_path, **{**chosen, **changes})
    with pytest.raises(InputError, match="--jobs must be at least 1"):
        run_sweep(runs, tmp_path, jobs=0)


def test_a_run_is_what_its_command_trains(tmp_path, monkeypatch):
    """Its process is told of everything that makes the run, plugins included."""
    plugins = []
    monkeypatch.setattr("neurosym_jax.training.sweep_plan.loaded", lambda: ["mine.py"])
    monkeypatch.setattr("neurosym_jax.commands._running.load_plugin", plugins.append)
    models = ("sgan", "social", "neurosym", "neurosym_ros")
    changes = {"changes": ("batch_scenes=4", "rotate=0"), "network": ("encoder_h_dim=16",)}
    for run in plan_runs(tmp_path, **{**CHOSEN, "models": models, **changes}, steps=10):
        options = tyro.cli(Options, args=load_plugins(run.arguments))
        assert plugins.pop() == "mine.py"
        assert (options.out, options.resume) == (run.folder, True)
        described = make_run(options)
        assert (described.network, described.recipe) == (run.network, run.recipe)
        assert described.dataset == run.dataset


@pytest.mark.slow
def test_a_sweep_is_finished_once(tmp_path, monkeypatch, capsys):
    out = tmp_path / "sweep"
    chosen = {
        **CHOSEN,
        "models": ("none",),  # The least to compile.
        "seeds": (0, 1),
        "changes": ("batch_scenes=4", "best_k=2", "max_agents=4"),
    }
    runs = plan_runs(out, **chosen, steps=25)
    # One job, so that the second run finds the first one's compiled programs.
    assert run_sweep(runs, out, jobs=1) == 0
    rows = json.loads((out / "sweep.json").read_text())["rows"]
    trained = [row for row in rows if row["training_seed"] is not None]
    assert [row["model"] for row in rows[:2]] == ["constant velocity", "constant velocity, sampled"]
    assert [row["training_seed"] for row in trained] == [0, 1]
    assert len({row["joint_ade"] for row in trained}) == 2
    table = (out / "sweep.md").read_text()
    assert "SGAN, no pooling (2 trainings) | 20 |" in table
    folder = out / "sgan_none_cross-path_8_8_seed1"
    assert "test on cross-path: this model" in (folder / "model" / "README.md").read_text()
    assert "threads | 1" in (folder / "model" / "README.md").read_text()

    monkeypatch.setattr("neurosym_jax.training.sweep.subprocess", None)  # Nothing is trained again.
    assert run_sweep(runs, out) == 0
    assert "2 runs, 2 of them finished before" in capsys.readouterr().out
    with pytest.raises(InputError, match="was trained with steps = 25, not 50"):
        run_sweep(plan_runs(out, **chosen, steps=50), out)


@pytest.mark.slow
def test_failed_runs_are_reported(tmp_path, capsys):
    chosen = {**CHOSEN, "models": ("none",), "seeds": (0, 1, 2)}
    first, *runs = plan_runs(tmp_path, **chosen)
    deadly = tmp_path / "deadly.py"
    deadly.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)")
    first = dataclasses.replace(first, arguments=(*first.arguments, "--plugin", str(deadly)))
    for run in runs:
        run.model.mkdir(parents=True)  # Not the model of a finished run.
    with pytest.raises(InputError, match="no run was finished"):
        run_sweep([first, *runs], tmp_path, jobs=1)
    errors = capsys.readouterr().err
    assert errors.count("status -9") == 1
    assert errors.count("holds a finished model, and nothing is overwritten") == 2
