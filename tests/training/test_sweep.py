"""Sweeps: which runs there are, what trains them, and what is reported of them."""

import dataclasses
import json

import pytest
import tyro

from neurosym_jax.commands import sweep, train
from neurosym_jax.commands._options import options_text, with_file
from neurosym_jax.commands._running import load_plugins
from neurosym_jax.commands.sweep import plan_runs, run
from neurosym_jax.errors import InputError
from neurosym_jax.training.network import model_name

CHOSEN = sweep.Options(weighting=("cnd", "ones"), dataset=("cross-path",), seed=(0, 1))


def test_runs():
    chosen = dataclasses.replace(CHOSEN, pred_len=(8, 12))
    _, runs = plan_runs(chosen)
    assert len({run.folder for run in runs}) == len(runs) == 3 * 2 * 2
    names = {run.folder.name.partition("_cross-path")[0] for run in runs}
    assert names == {"sgan_pool_net", "neurosym_as_described_cnd", "neurosym_as_described_ones"}
    assert len(plan_runs(dataclasses.replace(chosen, dataset=()))[1]) == 2 * len(runs)
    for changes, reason in (
        ({"seed": ()}, "--seed: at least one is needed"),
        ({"pooling": ("lstm",)}, "unknown pooling 'lstm'"),
        (
            {"pooling": ("none", "encounter"), "model": ("sgan",)},
            "--pooling encounter: sgan has none",
        ),
        ({"dataset": ("moon",)}, "unknown dataset 'moon': there are all-forward, cross-path"),
        ({"set": ("emma=1",)}, "--set emma=1"),
        ({"network": ("emma=1",)}, "--network emma=1"),
        (
            {"weighting": ("quantised", "quantised,quantisation_factor=0.05")},
            "two runs of the sweep have this name",
        ),
        ({"recipe": "anchors"}, "does not fit the network: --recipe ours, sgan"),
    ):
        with pytest.raises(InputError, match=reason):
            plan_runs(dataclasses.replace(chosen, **changes))
    with pytest.raises(InputError, match="--jobs must be at least 1"):
        run(dataclasses.replace(chosen, jobs=0))


def test_a_run_is_what_its_command_and_its_file_train(monkeypatch, tmp_path):
    """Its process is told of everything that makes the run, plugins included."""
    plugins = []
    for module in ("sweep", "_options"):
        monkeypatch.setattr(f"neurosym_jax.commands.{module}.loaded", lambda: ["mine.py"])
    monkeypatch.setattr("neurosym_jax.commands._running.load_plugin", plugins.append)
    changes = {"set": ("batch_scenes=4", "rotate=0"), "network": ("encoder_h_dim=16",)}
    changes |= {"pooling": ("none", "social", "neurosym_ros"), "steps": 10, "period": 0.2}
    _, runs = plan_runs(dataclasses.replace(CHOSEN, **changes))
    assert len(runs) == 2 * (2 + 2)
    for one in runs:
        options = tyro.cli(train.Options, args=load_plugins(one.arguments))
        assert (options.out, options.resume) == (one.folder, True)
        network, recipe = train.configured(options)
        assert one.folder.name.startswith(f"{model_name(network)}_{options.dataset}_8_8")
        assert (network.period, network.encoder_h_dim, recipe.batch_scenes) == (0.2, 16, 4)
        assert one.folder.name.endswith(f"seed{recipe.seed}")
        (file := tmp_path / "recipe.yaml").write_text(one.options)
        repeated = with_file(train.Options, [str(file), "--resume"])
        assert tyro.cli(train.Options, args=load_plugins(repeated)) == options
        assert plugins == ["mine.py"] * 2
        plugins.clear()


@pytest.mark.slow
def test_a_sweep_is_finished_once_and_reports_what_failed(tmp_path, monkeypatch, capsys):
    how = {"set": ("batch_scenes=4", "best_k=2", "max_agents=4"), "steps": 25}
    how |= {"model": ("sgan",), "pooling": ("none",), "weighting": ()}
    # One job, so that the second run finds the first one's compiled programs.
    chosen = dataclasses.replace(CHOSEN, out=tmp_path / "sweep", jobs=1, **how)
    first, second = plan_runs(chosen)[1]
    (deadly := tmp_path / "deadly.py").write_text("import os\nos.kill(os.getpid(), 9)")
    killed = first._replace(arguments=[*first.arguments, "--plugin", str(deadly)])
    (second.folder / "model").mkdir(parents=True)  # Not the model of a finished run.
    with monkeypatch.context() as patched:
        patched.setattr(sweep, "plan_runs", lambda _: (None, [killed, second]))
        with pytest.raises(InputError, match="no run was finished"):
            run(chosen)
    errors = capsys.readouterr().err
    assert errors.count("status -9") == 1
    assert errors.count("holds a finished model, and nothing is overwritten") == 1
    (second.folder / "model").rmdir()

    assert run(chosen) == 0
    assert (chosen.out / "sweep.yaml").read_text() == options_text(chosen)
    rows = json.loads((chosen.out / "sweep.json").read_text())["rows"]
    trained = [row for row in rows if row["training_seed"] is not None]
    assert [row["model"] for row in rows[:2]] == ["constant velocity", "constant velocity, sampled"]
    assert [row["training_seed"] for row in trained] == [0, 1]
    assert len({row["joint_ade"] for row in trained}) == 2
    table = (chosen.out / "sweep.md").read_text()
    assert "SGAN, no pooling (2 trainings) | 20 |" in table
    card = (second.folder / "model" / "README.md").read_text()
    assert "test on cross-path: this model" in card
    assert "threads | 1" in card

    # Nothing is trained again.
    monkeypatch.setattr("neurosym_jax.training.sweep.subprocess", None)
    capsys.readouterr()
    assert run(chosen) == 0
    assert "2 runs, 2 of them finished before" in capsys.readouterr().out
    for changes in ({"steps": 50}, {"period": 0.5}):
        with pytest.raises(InputError, match="the run had other options: choose another --out"):
            run(dataclasses.replace(chosen, **changes))
