import dataclasses
import json
import re
import subprocess
import sys

import pytest
import tyro

from neurosym_jax.commands._running import with_plugins
from neurosym_jax.commands.train import Options, make_run
from neurosym_jax.errors import InputError
from neurosym_jax.sweeps import estimate
from neurosym_jax.sweeps.runs import plan_runs
from neurosym_jax.sweeps.sweep import plan_of, run_sweep
from neurosym_jax.sweeps.table import format_sweep


def row(model, scene, seed, ade, pred_len=8):
    errors = {"ade": ade, "fde": 2 * ade}
    return {
        "model": model,
        "scene": scene,
        "obs_len": 8,
        "pred_len": pred_len,
        "samples": 20 if seed is not None else 1,
        "joint": errors,
        "marginal": {name: value / 2 for name, value in errors.items()},
        "run": None if seed is None else {"seed": seed},
    }


def test_table():
    rows = [row("constant velocity", scene, None, 1.0) for scene in ("eth", "hotel")]
    rows += [row("SGAN", "eth", seed, 0.5 + 0.1 * seed) for seed in range(3)]
    rows += [row("SGAN", "hotel", seed, 0.3) for seed in range(2)]
    joint, marginal = format_sweep(rows).split("### ")[1:3]
    assert joint.startswith("8 steps observed, 8 forecast: joint best of k")
    lines = joint.splitlines()
    assert lines[2] == "| model | k | seeds | eth | hotel | average |"
    assert lines[4] == (
        "| constant velocity | 1 | - | 1.000 / 2.000 | 1.000 / 2.000 | 1.000 / 2.000 |"
    )
    # The average is over the two seeds that every scene has: .40 and .45.
    assert lines[5] == (
        "| SGAN | 20 | 3 | 0.600 ± 0.248 / 1.200 ± 0.497 | 0.300 ± 0.000 / 0.600 ± 0.000 "
        "| 0.425 ± 0.318 / 0.850 ± 0.635 |"
    )
    assert "| 0.500 / 1.000 |" in marginal
    assert format_sweep([row("SGAN", "eth", 0, 0.5, 12)]).count("| model | k | seeds | eth |") == 2


CHOSEN = {
    "models": ("sgan", "neurosym"),
    "weightings": ("cnd", "ones"),
    "datasets": ("cross-path",),
}


def test_runs(tmp_path):
    chosen = {**CHOSEN, "seeds": 2, "pred_lens": (8, 12)}
    runs = plan_runs(tmp_path, **chosen)
    assert len({run.folder for run in runs}) == len(runs) == 3 * 2 * 2
    kinds = {(run.generator.pooling, run.weighting) for run in runs}
    assert kinds == {("pool_net", None), ("as_described", "cnd"), ("as_described", "ones")}
    assert len(plan_runs(tmp_path, **{**chosen, "datasets": ()})) == 2 * len(runs)
    for changes, reason in (
        ({"seeds": 0}, "--seeds must be at least 1"),
        ({"models": ("lstm",)}, "unknown pooling 'lstm'"),
        ({"datasets": ("moon",)}, "unknown dataset 'moon': there are all-forward, cross-path"),
        ({"changes": ("emma=1",)}, "--set emma=1"),
    ):
        with pytest.raises(InputError, match=reason):
            plan_runs(tmp_path, **{**chosen, **changes})
    with pytest.raises(InputError, match="--jobs must be at least 1"):
        run_sweep(runs, tmp_path, jobs=0)


def test_a_run_is_what_its_command_trains(tmp_path, monkeypatch):
    """Its process is told of everything that makes the run, plugins included."""
    monkeypatch.setattr("neurosym_jax.sweeps.runs.loaded", lambda: ["mine.py"])
    models = ("sgan", "social", "neurosym", "neurosym_ros")
    changes = ("batch_scenes=4", "rotate=0")
    for run in plan_runs(tmp_path, **{**CHOSEN, "models": models, "changes": changes}, steps=10):
        options = tyro.cli(with_plugins(Options), args=run.arguments)
        assert options.plugin == ("mine.py",)
        assert (options.out, options.resume) == (run.folder, True)
        described = make_run(options)
        assert (described.generator, described.recipe) == (run.generator, run.recipe)
        assert described.dataset == run.dataset


TRIAL = """
import sys, time
for step in range(3):
    time.sleep(0.1)
    with open(sys.argv[1] + "/metrics.jsonl", "a") as file:
        file.write('{"step": %d}\\n' % (10 * step))
time.sleep(100)
"""
"""Ten steps in a tenth of a second, after another one."""


def test_a_plan_says_how_long_it_takes(tmp_path, monkeypatch):
    def start(run):
        return subprocess.Popen([sys.executable, "-c", TRIAL, run.arguments[-1]])

    monkeypatch.setattr(estimate, "start", start)
    runs = plan_runs(tmp_path / "sweep", **CHOSEN, steps=1000)
    plan = plan_of(runs, jobs=1)
    assert plan.count("left  ") == 3
    assert "3 runs, 3 of them left" in plan
    seconds = re.search(r"_seed0 alone takes about (\d+) s; all that is left, 1 at once, ", plan)
    assert seconds is not None
    assert 9 <= int(seconds[1]) <= 40
    assert not (tmp_path / "sweep").exists()


@pytest.mark.slow
def test_a_sweep_is_finished_once(tmp_path, monkeypatch, capsys):
    out = tmp_path / "sweep"
    chosen = {
        **CHOSEN,
        "models": ("none",),  # The least to compile.
        "seeds": 2,
        "changes": ("batch_scenes=4", "best_k=2", "max_agents=4"),
    }
    runs = plan_runs(out, **chosen, steps=25)
    # One job, so that the second run finds the first one's compiled programs.
    assert run_sweep(runs, out, jobs=1) == 0
    rows = json.loads((out / "sweep.json").read_text())["rows"]
    trained = [row for row in rows if row["run"]]
    assert [row["model"] for row in rows[:2]] == ["constant velocity", "constant velocity, sampled"]
    assert [row["run"]["seed"] for row in trained] == [0, 1]
    assert {row["run"]["weighting"] for row in trained} == {None}
    assert len({row["joint"]["ade"] for row in trained}) == 2
    table = (out / "sweep.md").read_text()
    assert "| 20 | 2 |" in table
    folder = out / "sgan_none_cross-path_8_8_seed1"
    assert "test on cross-path: this model" in (folder / "model" / "README.md").read_text()
    assert "threads | 1" in (folder / "model" / "README.md").read_text()

    monkeypatch.setattr(
        "neurosym_jax.sweeps.processes.TrainingProcess.__init__", None
    )  # Nothing is trained again.
    assert run_sweep(runs, out) == 0
    assert "2 runs, 2 of them finished before" in capsys.readouterr().out
    with pytest.raises(InputError, match="was trained with steps = 25, not 50"):
        run_sweep(plan_runs(out, **chosen, steps=50), out)


@pytest.mark.slow
def test_failed_runs_are_told(tmp_path, capsys):
    first, *runs = plan_runs(tmp_path, **{**CHOSEN, "models": ("none",)}, seeds=3)
    deadly = tmp_path / "deadly.py"
    deadly.write_text("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)")
    first = dataclasses.replace(first, arguments=(*first.arguments, "--plugin", str(deadly)))
    for run in runs:
        run.model.mkdir(parents=True)  # A model of nobody knows what.
    with pytest.raises(InputError, match="no run was finished"):
        run_sweep([first, *runs], tmp_path, jobs=1)
    told = capsys.readouterr().err
    assert told.count("its process ended with status -9") == 1
    assert told.count("holds a finished model, and nothing is overwritten") == 2
