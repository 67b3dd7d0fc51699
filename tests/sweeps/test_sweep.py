import dataclasses
import json

import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.sweeps import sweep as module
from neurosym_jax.sweeps.sweep import SweepOptions, sweep, sweep_runs
from neurosym_jax.sweeps.table import format_sweep, mean_and_interval


def test_interval():
    assert mean_and_interval([0.25]) == (0.25, None)
    mean, half = mean_and_interval([1.0, 2.0, 3.0])
    # Student's t with two degrees of freedom: 4.303.
    assert (mean, half) == (2.0, pytest.approx(4.302653 / np.sqrt(3), rel=1e-6))


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


def test_runs(tmp_path):
    options = SweepOptions(
        models=("sgan", "neurosym"),
        scenes=("cross-path",),
        seeds=2,
        pred_lens=(8, 12),
        weightings=("cnd", "ones"),
        out=tmp_path,
    )
    runs = sweep_runs(options)
    assert len({run.out for run in runs}) == len(runs) == 3 * 2 * 2
    assert {(run.model, run.weighting) for run in runs} == {
        ("sgan", "cnd"),
        ("neurosym", "cnd"),
        ("neurosym", "ones"),
    }
    assert all(run.resume for run in runs)
    assert len(sweep_runs(dataclasses.replace(options, scenes=()))) == 2 * len(runs)
    for changes, reason in (
        ({"seeds": 0}, "--seeds must be at least 1"),
        ({"jobs": 0}, "--jobs must be at least 1"),
        ({"scenes": ("moon",)}, "unknown scene 'moon': there are all-forward, cross-path"),
        ({"set": ("emma=1",)}, "--set emma=1"),
    ):
        with pytest.raises(InputError, match=reason):
            sweep_runs(dataclasses.replace(options, **changes))


@pytest.mark.slow
def test_a_sweep_is_finished_once(tmp_path, monkeypatch, capsys):
    options = SweepOptions(
        models=("sgan",),
        scenes=("cross-path",),
        seeds=2,
        steps=25,
        set=("batch_scenes=4", "best_k=2", "max_agents=4"),
        out=tmp_path / "sweep",
        jobs=1,  # So that the second finds the first one's compiled programs.
    )
    assert sweep(options) == 0
    rows = json.loads((tmp_path / "sweep" / "sweep.json").read_text())["rows"]
    trained = [row for row in rows if row["run"]]
    assert [row["model"] for row in rows[:2]] == ["constant velocity", "constant velocity, sampled"]
    assert [row["run"]["seed"] for row in trained] == [0, 1]
    assert {row["run"]["weighting"] for row in trained} == {None}
    assert len({row["joint"]["ade"] for row in trained}) == 2
    table = (tmp_path / "sweep" / "sweep.md").read_text()
    assert "| 20 | 2 |" in table
    folder = tmp_path / "sweep" / "sgan_pool_net_cross-path_8_8_seed1"
    assert "test on cross-path: this model" in (folder / "model" / "README.md").read_text()
    assert "threads | 1" in (folder / "model" / "README.md").read_text()

    monkeypatch.setattr(module, "_start", None)  # Nothing is trained again.
    assert sweep(options) == 0
    assert "2 runs, 2 of them finished before" in capsys.readouterr().out
    with pytest.raises(InputError, match="was trained with steps = 25, not 50"):
        sweep(dataclasses.replace(options, steps=50))


@pytest.mark.slow
def test_failed_runs_are_told(tmp_path, capsys):
    options = SweepOptions(models=("sgan",), scenes=("cross-path",), seeds=2, out=tmp_path, jobs=2)
    for run in sweep_runs(options):
        (run.out / "model").mkdir(parents=True)  # A model of nobody knows what.
    with pytest.raises(InputError, match="no run was finished"):
        sweep(options)
    assert capsys.readouterr().err.count("holds a finished model, and nothing is overwritten") == 2
