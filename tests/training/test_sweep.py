"""Sweeps: which runs there are, what trains them, and what is reported of them."""

import dataclasses
import itertools
import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import tyro
import yaml

from neurosym_jax.commands import compare_weightings, sweep, train
from neurosym_jax.commands._options import options_text, with_file
from neurosym_jax.commands._running import load_plugins
from neurosym_jax.commands.sweep import plan_runs, run
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import read_report
from neurosym_jax.evaluation.tables import format_table
from neurosym_jax.models.forecaster import forecaster_of
from neurosym_jax.plugins import load_plugin, loaded
from neurosym_jax.training.sweep import compare_sweep, run_sweep, unfinished
from tests.registrations import restored_registrations
from tests.rows import write_sweep

CHOSEN = sweep.Options(weighting=("cnd", "ones"), dataset=("cross-path",), seed=(0, 1))


def test_a_run_is_what_its_file_trains(tmp_path):
    """Its process is told of everything that makes the run, plugins included."""
    plugin = str(tmp_path / "mine.py")
    Path(plugin).write_text("")
    changes = {
        "set": ("batch_scenes=4", "rotate=0"),
        "network": ("encoder_h_dim=16",),
        "pooling": ("none", "social", "neurosym_ros"),
        "steps": 10,
        "period": 0.2,
        "pred_len": (8, 12),
        "out": tmp_path,
    }
    with restored_registrations():
        load_plugin(plugin)
        source, runs = plan_runs(dataclasses.replace(CHOSEN, **changes))
    assert source.period == 0.2  # They are tested in the steps that they learn.
    assert len({run.folder for run in runs}) == len(runs) == 2 * (2 + 2) * 2
    assert unfinished(runs) == runs
    for sweep_run in runs:
        command, *arguments = sweep_run.command
        with restored_registrations():
            read = load_plugins(with_file(train.Options, arguments))
            assert plugin in loaded()
            options = tyro.cli(train.Options, args=read)
            repeated = dataclasses.replace(options, resume=False)
            assert options_text(repeated) == sweep_run.options
        asked = (command, options.out, options.resume)
        assert asked == ("train", sweep_run.folder, True)
        network, recipe, _ = train.configured(options)
        place = f"{options.dataset}_8_{network.pred_len}_seed{recipe.seed}"
        assert sweep_run.folder.name == f"{forecaster_of(network).variant}_{place}"
        sizes = (network.period, network.encoder_h_dim, recipe.batch_scenes)
        assert sizes == (0.2, 16, 4)
    assert plugin not in loaded()


def test_lists_of_values_are_a_run_each(tmp_path):
    """Point 1: the last of two values was trained alone; a list within brackets is one value."""
    changes = {"set": ("learning_rate=0.01,0.001", "rotate=0", "label_real=[0.7,1.2]")}
    changes |= {
        "network": ("mlp_dim=8,16", "pooling=social,grid_size=9"),
        "family": ("sgan",),
    }
    changes |= {"weighting": (), "seed": (0,), "fold": (), "out": tmp_path}
    _, runs = plan_runs(dataclasses.replace(CHOSEN, **changes))
    seen = set()
    for sweep_run in runs:
        options = yaml.safe_load(sweep_run.options)
        assert options["set"][1:] == ["rotate=0", "label_real=[0.7,1.2]"]
        assert options["network"][1] == "pooling=social,grid_size=9"
        assert sweep_run.label == f"{options['set'][0]}, {options['network'][0]}"
        assert options["set"][0] in sweep_run.folder.name
        seen.add(sweep_run.label)
    assert len(seen) == len(runs) == 4


def test_a_change_stands_once_in_the_name_of_a_run(tmp_path):
    """The name of an anchors network has what differs from the defaults."""
    changes = {"network": ("hidden=8,80",), "set": ("ema=0,0.9",), "seed": (0,)}
    changes |= {"family": ("anchors",), "weighting": (), "out": tmp_path}
    _, runs = plan_runs(dataclasses.replace(CHOSEN, **changes))
    assert [sweep_run.folder.name for sweep_run in runs] == [
        f"anchors_hidden_{hidden}_ema={ema}_cross-path_8_8_seed0"
        for ema, hidden in itertools.product(("0", "0.9"), (8, 80))
    ]
    # Tables say the change by its own name.
    assert runs[0].label == "ema=0, hidden=8"


@pytest.fixture
def small_sweep(files, tmp_path):
    """Options of two trainings of a second each, of SGAN without pooling."""
    return dataclasses.replace(
        CHOSEN,
        family=("sgan",),
        pooling=("none",),
        weighting=(),
        set=("batch_scenes=4", "best_k=2", "max_agents=4"),
        steps=25,
        obs_len=4,
        pred_len=(4,),
        data=files,
        dataset=("check",),
        out=tmp_path / "sweep",
        jobs=1,
    )


@pytest.mark.slow
def test_a_sweep_is_finished_once_and_reports_what_failed(
    small_sweep, tmp_path, capsys
):
    source, (first, second) = plan_runs(small_sweep)
    deadly = tmp_path / "deadly.py"
    deadly.write_text("import os\nos.kill(os.getpid(), 9)")
    killed = first._replace(options=f"{first.options}plugin: {deadly}\n")
    to_be_tested = (source, small_sweep.out, options_text(small_sweep), 1)
    with pytest.raises(InputError, match="no run was finished"):
        run_sweep([killed], *to_be_tested)
    assert capsys.readouterr().err.count("_seed0: status -9") == 1
    assert run_sweep([killed, second], *to_be_tested) == 1
    assert capsys.readouterr().err.count("_seed0: status -9") == 1

    assert (small_sweep.out / "sweep.yaml").read_text() == options_text(small_sweep)
    rows = json.loads((small_sweep.out / "sweep.json").read_text())["rows"]
    assert [(row["model"], row["training_seed"]) for row in rows] == [
        ("constant velocity", None),
        ("constant velocity, sampled", None),
        ("SGAN, no pooling", 1),
    ]
    assert "SGAN, no pooling | 20 |" in (small_sweep.out / "sweep.md").read_text()
    card = (second.folder / "model" / "README.md").read_text()
    assert "| check | SGAN, no pooling | 20 |" in card
    assert "threads | 1" in card

    # The finished run is not trained again.
    log = (second.folder / "train.log").stat()
    only = dataclasses.replace(small_sweep, seed=(1,))
    assert run(only) == 0
    assert (second.folder / "train.log").stat() == log
    assert "1 runs, 1 of them finished before" in capsys.readouterr().out
    run(dataclasses.replace(only, dry_run=True, seed=(1, 2)))
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["finished", "left"]
    for changes, message in (
        ({"steps": 50}, r"steps 25 \(now 50\)"),
        ({"period": 0.5}, "period "),
    ):
        refusal = f"had other options: {message}.*: choose another out"
        with pytest.raises(InputError, match=refusal):
            run(dataclasses.replace(only, **changes))
    # A run that was begun when `--family` was called `--model` goes on.
    recipe = second.folder / "recipe.yaml"
    recipe.write_text(recipe.read_text().replace("family: ", "model: "))
    assert "model: " in recipe.read_text()
    run(dataclasses.replace(only, log="tensorboard", quiet=True, dry_run=True))


METRICS = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde")
BETTER = {"SGAN": 0.0, "NeuroSyM, ones": 0.01, "NeuroSyM, cnd": 0.1}


@pytest.fixture
def folder(tmp_path):
    """A sweep of three models of which one is 9 cm better than the others, on two test sets."""
    draw = np.random.default_rng(0)
    runs = []
    cases = itertools.product(BETTER, (("eth", 70), ("zara1", 160)), range(3))
    for model, (scene, count), seed in cases:
        draws = (
            0.5
            - BETTER[model]
            + draw.normal(0, 0.02, (count, 4))
            + draw.normal(0, 0.004)
        )
        runs.append((model, scene, seed, dict(zip(METRICS, draws.T))))
    write_sweep(tmp_path, [("constant velocity", "eth", None, runs[0][-1]), *runs])
    return tmp_path


@pytest.mark.slow
def test_a_significant_difference_is_bold(folder):
    compare_sweep(folder, ["ones"], out=folder / "ablation.md")
    text = (folder / "ablation.md").read_text()
    assert "Runs: 18. Seeds: 3." in text
    assert "nothing of how much" not in text
    assert "Difference to NeuroSyM, ones, mean over test sets" in text
    assert "\n| NeuroSyM, cnd | **−0.09" in text
    assert "\n| SGAN | **+0.0" in text
    assert "constant velocity" not in text
    rows = pl.read_csv(folder / "ablation.csv")
    assert len(rows) == 2 * 3 * 4
    (row,) = rows.filter(
        model="NeuroSyM, cnd", test_set="mean over test sets", metric="joint_ade"
    ).iter_rows(named=True)
    assert (row["reference"], row["seeds"]) == ("NeuroSyM, ones", 3)
    assert row["difference"] == pytest.approx(-0.09, abs=0.01)
    assert row["low_95"] < -0.09 < row["high_95"] < -0.05


def test_each_reference_has_its_differences_and_what_they_tell(folder):
    """The sign turns with the reference; what is told is half of the interval, in %."""
    text = compare_sweep(folder, ["ones", "SGAN"])
    _, first, second = text.split("Difference to ")
    assert first.startswith("NeuroSyM, ones")
    assert second.startswith("SGAN")
    assert "\n| NeuroSyM, ones | **−0.0" in second
    rows = pl.read_csv(folder / "report.csv")
    chosen = {"test_set": "mean over test sets", "metric": "joint_ade"}
    (row,) = rows.filter(model="SGAN", reference="NeuroSyM, ones", **chosen).iter_rows(
        named=True
    )
    (turned,) = rows.filter(
        model="NeuroSyM, ones", reference="SGAN", **chosen
    ).iter_rows(named=True)
    assert turned["difference"] == pytest.approx(-row["difference"])
    told = 50 * (row["high_95"] - row["low_95"]) / row["error_of_reference"]
    largest = 100 * row["high_95"] / row["error_of_reference"]
    assert f"\n| SGAN | {told:.1f}, {largest:.1f} |" in first
    assert "hardly look" not in text  # Nothing is known of it.


def test_networks_that_look_at_nobody_are_counted(folder):
    """The share is of the validation; baselines have none."""

    def of_validation(row):
        seed = row["training_seed"]
        share = None if seed is None else 0.9
        if row["model"] == "SGAN" and seed == 1:
            share = 0.1
        row["val_neighbour_near"] = share

    changed(folder, of_validation)
    counts = "0 of 6 of NeuroSyM, ones; 0 of 6 of NeuroSyM, cnd."
    assert f"2 of 6 of SGAN; {counts}" in compare_sweep(folder, ["ones"])
    changed(folder, lambda row: row.update(pred_len=8 + 4 * (row["model"] == "SGAN")))
    text = compare_sweep(folder, ["ones"], pred_len=8)
    assert f": {counts}" in text.replace("\n", " ")


def test_compared_weightings_are_a_sweep_of_them(tmp_path, capsys):
    """One command trains the weighting and its references by the same seeds, and reports them."""
    chosen = compare_weightings.Options(
        weighting="soft",
        seeds=2,
        dataset=("cross-path",),
        out=tmp_path,
        steps=3,
        dry_run=True,
    )
    assert compare_weightings.run(chosen) == 0
    trained = [line.split()[-2] for line in capsys.readouterr().out.splitlines()]
    same = dataclasses.replace(
        CHOSEN,
        weighting=("soft", "ones", "shuffled"),
        family=("neurosym",),
        out=tmp_path,
        steps=3,
    )
    _, runs = plan_runs(same)
    assert trained == [str(run.folder / "recipe.yaml") for run in runs]
    assert len(trained) == 3 * 2
    for change, message in (
        ({"weighting": "ones"}, "is the weighting itself"),
        ({"fold": ("1/2", "2/2")}, "in their weighting alone, and there are NeuroSyM,"),
        (
            {"set": ("ema=0,0.9",)},
            "weighting alone, and there are NeuroSyM, soft, ema=0",
        ),
    ):
        with pytest.raises(InputError, match=message):
            compare_weightings.run(dataclasses.replace(chosen, **change))
    with pytest.raises(InputError, match="seeds must be at least 1"):
        compare_weightings.run(dataclasses.replace(chosen, seeds=0))


def test_the_errors_of_a_sweep_are_printed_once(folder, capsys, monkeypatch):
    """By the sweep: the comparison of weightings adds the differences."""
    chosen = compare_weightings.Options(
        weighting="cnd", against=("ones",), dataset=("cross-path",), out=folder
    )

    def finished(*_):
        print("| NeuroSyM, cnd | 20 |")
        return 0

    monkeypatch.setattr(sweep, "run_sweep", finished)
    assert compare_weightings.run(chosen) == 0
    printed = capsys.readouterr().out
    errors = format_table(read_report(folder / "sweep.json"), "markdown")
    assert errors not in printed
    assert "Difference to NeuroSyM, ones" in printed
    assert printed.endswith(f"{folder / 'report.md'}, {folder / 'report.csv'}\n")
    # `report` has not printed them before.
    assert errors in compare_sweep(folder, ["ones"])


def changed(folder, change):
    """Change the rows of the sweep in `folder`."""
    path = folder / "sweep.json"
    data = json.loads(path.read_text())
    for row in data["rows"]:
        change(row)
    path.write_text(json.dumps(data))


@pytest.mark.parametrize("seeds", [1, 2])
def test_two_models_are_compared_and_few_seeds_find_nothing(folder, seeds):
    def left(row):
        if row["training_seed"] in (None, *range(seeds, 3)) or row["model"] == "SGAN":
            row["training_seed"] = None

    changed(folder, left)
    text = compare_sweep(folder)
    assert f"Runs: {2 * 2 * seeds}. Seeds: {seeds}." in text
    assert "seeds tell nothing of how much trainings differ" in text
    assert "\n| NeuroSyM, cnd | −0.09" in text
    assert "| **−" not in text


def test_a_comparison_does_not_hang_on_its_neighbours(folder):
    """Blocks of scenes are as long as the windows compared, whatever else the sweep has."""
    changed(folder, lambda row: row.update(pred_len=12))
    alone = compare_sweep(folder, ["ones"], out=folder / "a.md")
    shorter = ("SGAN", 2)
    changed(
        folder,
        lambda row: row.update(
            pred_len=8 if (row["model"], row["training_seed"]) == shorter else 12
        ),
    )
    beside = compare_sweep(folder, ["ones"], pred_len=12, out=folder / "b.md")
    rows = [
        next(line for line in text.splitlines() if line.startswith("| NeuroSyM, cnd"))
        for text in (alone, beside)
    ]
    assert rows[0] == rows[1]


def test_sweeps_that_cannot_be_compared_are_refused(folder, tmp_path_factory):
    empty = tmp_path_factory.mktemp("empty")
    for sweep_folder, options, message in (
        (folder, {}, r"against names .* there are SGAN; NeuroSyM"),
        (folder, {"against": ["soft"]}, r"against names .* there are SGAN; NeuroSyM"),
        (folder, {"out": folder / "r.txt"}, r"must end in \.md"),
        (empty, {}, "no finished sweep is here; `neurosym sweep --out"),
    ):
        with pytest.raises(InputError, match=message):
            compare_sweep(sweep_folder, **options)
    changed(folder, lambda row: row.update(pred_len=8 + 4 * (row["model"] == "SGAN")))
    for options, message in (
        ({}, r"8 \+ 8, 8 \+ 12; pred_len chooses one"),
        ({"pred_len": 9}, r"8 \+ 8, 8 \+ 12; pred_len chooses one"),
        ({"pred_len": 12}, "compares two models or more: there are SGAN$"),
    ):
        with pytest.raises(InputError, match=message):
            compare_sweep(folder, **options)
