import dataclasses
import hashlib
import itertools
import json
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax import evaluation
from neurosym_jax.commands.evaluate import Options, _load, run
from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.evaluation.metrics import register_metric
from neurosym_jax.evaluation.tables import rows_frame
from neurosym_jax.models.disk import find_model, load_model, save_model
from tests.repository import SMALL, exhaustive

# Joint ADE and FDE of best-of-20 that the authors publish for their checkpoints.
ZOO = {
    "sgan-models/zara1_8": (0.21, 0.42),
    "sgan-p-models/hotel_12": (0.43, 0.88),
}


@pytest.fixture
def options(tmp_path):
    """Options that write below `tmp_path`, of 8 + 7 steps, which no model has that ships."""

    def make(**fields):
        names = ("constant_velocity", "constant_velocity_sampled")
        usual = {"json": tmp_path / "rows.json", "figures": False, "baselines": names}
        if "model" not in fields:
            usual["pred_len"] = 7
        return Options(**(usual | fields))

    return make


def test_the_first_minute(tmp_path, capsys):
    """One SGAN, one NeuroSyM and constant velocity, where they belong; what fits 80 columns."""
    rows = run(
        Options(json=tmp_path / "rows.json", plots=tmp_path / "figures", samples=3)
    )
    models = ("constant velocity", "SGAN", "NeuroSyM, cnd")
    assert [(row["dataset"], row["model"]) for row in rows] == [
        (scene, model)
        for scene, model in itertools.product(("all-forward", "cross-path"), models)
    ]
    assert [path.name for path in (tmp_path / "figures").iterdir()] == ["overview.png"]
    out, err = capsys.readouterr()
    lines = [line.rstrip() for line in out.splitlines() if str(tmp_path) not in line]
    assert max(map(len, lines)) <= 80
    begins = tuple(f"{model}  " for model in models)
    assert sum(line.startswith(begins) for line in lines) == 6
    assert "the networks make 3," in out
    assert lines[-1] == "    neurosym evaluate --data my_tracks.csv --model recommended"
    assert err.splitlines()[-1].startswith("[6/6] NeuroSyM, cnd on cross-path (")
    report = json.loads((tmp_path / "rows.json").read_text())
    provenance = report["provenance"]
    assert set(provenance) == {
        "version",
        "commit",
        "command",
        "data",
        "checkpoints",
        "environment",
    }
    params = find_model("sgan_simulations_8") / "params.safetensors"
    digest = hashlib.sha256(params.read_bytes()).hexdigest()
    assert provenance["checkpoints"][str(params)] == digest


@pytest.mark.parametrize("style", ["csv", "latex"])
def test_a_table_for_a_paper_goes_alone_to_the_output(options, capsys, style):
    intervals = style == "latex"
    fields = {"table": style, "seeds": 2, "intervals": intervals}
    rows = run(options(samples=2, dataset="cross-path", **fields))
    out = capsys.readouterr().out
    assert (
        out
        == evaluation.format_table(rows_frame(rows), style, intervals=intervals) + "\n"
    )
    assert (r"{\scriptsize [" in out) == intervals
    assert rows[0]["joint_ade_std"] is None
    assert rows[1]["joint_ade_std"] > 0
    assert rows[1]["joint_ade_low"] < rows[1]["joint_ade"] < rows[1]["joint_ade_high"]


def test_saved_forecasts_have_the_noise_of_the_seed(options, tmp_path):
    def saved(seed):
        run(
            options(
                samples=2,
                seed=seed,
                dataset="cross-path",
                save_forecasts=tmp_path / "f.npz",
            )
        )
        (path,) = tmp_path.glob("f_*sampled.npz")
        return np.load(path)["samples"]

    first = saved(0)
    np.testing.assert_array_equal(first, saved(0))
    assert (first != saved(1)).any()


@pytest.mark.slow
def test_report_log_and_figures_of_an_evaluation(options, tmp_path, capsys):
    rows = run(
        options(
            samples=3,
            figures=True,
            plots=tmp_path / "figures",
            dataset="cross-path",
            all=True,
        )
    )
    report = json.loads((tmp_path / "rows.json").read_text())
    assert report.pop("provenance")["data"] == {}
    assert [reading["recording"][-12:] for reading in report.pop("recordings")] == [
        f"cross-path/{number}" for number in range(2)
    ]
    assert report == {"format": 2, "protocol": "sgan", "rows": rows}
    log = (tmp_path / "rows.jsonl").read_text()
    # The log has no p-values: they need all rows.
    tested = {f"{name}_p" for name in rows[0]} & set(rows[0])
    for line, row in zip(log.splitlines(), rows, strict=True):
        assert json.loads(line) == {name: row[name] for name in row.keys() - tested}
    assert {row["joint_ade_p"] is None for row in rows} == {True, False}
    assert [(row["model"], row["samples"]) for row in rows] == [
        ("constant velocity", 1),
        ("constant velocity, sampled", 3),
    ]
    for row in rows:
        assert all(
            np.isfinite(value) for value in row.values() if isinstance(value, float)
        )
        assert row["joint_ade_low"] < row["joint_ade"] < row["joint_ade_high"]
        assert row["joint_ade"] >= row["marginal_ade"] - 1e-9
    assert [path.name for path in (tmp_path / "figures").iterdir()] == [
        "cross-path_8_7.png"
    ]
    out, err = capsys.readouterr()
    for text in (
        "cross-path: 8 + 7 steps, 574 scenes, 1148 people",
        "these are the baselines",
    ):
        assert text in out
    assert "cross-path_8_7.png" in out
    assert "Next:" not in out
    assert "evaluating" not in err  # No progress bar where no terminal is.


def test_a_torch_file_and_a_folder_of_the_same_weights(options, tmp_path, capsys):
    save_model(tmp_path / "folder", load_model(SMALL))
    paths = (str(SMALL), f"{tmp_path}/./folder/")
    rows = run(
        options(model=paths, samples=2, dataset="cross-path", collisions=False, seed=5)
    )
    assert [(row["checkpoint"], row["seed"]) for row in rows] == [
        (path, 5) for path in (None, None, *paths)
    ]
    assert "collision_rate" not in rows[0]
    assert (
        f"assumed of {SMALL}: forward as in the released code"
        in capsys.readouterr().out
    )
    for metric in ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde"):
        assert rows[2][metric] == rows[3][metric]


@pytest.mark.parametrize(
    ("typed", "called"),
    [
        ((), "recommended"),
        (("recommended", "anchors_mine"), "recommended"),
        (("anchors_general_8",), ""),
        (("recommended", "anchors_general_8"), ""),
    ],
)
def test_recommended_has_one_name(typed, called, tmp_path, monkeypatch):
    """A network that is asked for by its own name keeps it, and so does another's folder."""
    name = "anchors_general_8"
    assert _load(name, Options(model=typed)).called == called
    assert _load(name, Options(all=True)).called == ""
    save_model(tmp_path / "anchors_mine", load_model(name))
    monkeypatch.chdir(tmp_path)
    assert _load("anchors_mine", Options(model=("recommended", "."))).called == ""


@pytest.mark.slow
def test_a_warning_says_recommended_where_that_was_typed(options, tmp_path, capsys):
    data = tmp_path / "walk.csv"
    data.write_text("\n".join(f"{frame},1,{0.2 * frame:.1f},0" for frame in range(20)))
    few = {"data": data, "period": 0.2, "min_agents": 1, "samples": 2, "pred_len": 8}
    for typed, called in (
        ("recommended", r"recommended \(anchors_general_8\)"),
        ("anchors_general_8", "anchors_general_8"),
    ):
        with pytest.warns(InputWarning, match=f"^{called}: was trained on steps of"):
            run(options(**few, model=(typed,)))


def test_one_step_and_one_agent(options, tmp_path):
    data = tmp_path / "walk.csv"
    data.write_text("\n".join(f"{frame},1,{0.1 * frame:.1f},0" for frame in range(9)))
    row, _ = run(options(data=data, pred_len=1, min_agents=1, samples=2))
    assert (row["scenes"], row["agents"], row["dataset"]) == (1, 1, "walk")
    assert row["joint_ade"] == pytest.approx(0, abs=1e-6)
    assert row["collision_rate"] == 0


def test_a_recording_without_a_window_is_left_out_beside_others(options, tmp_path):
    steps = {"long": 9, "short": 5}
    for name, count in steps.items():
        rows = [f"{frame},1,{0.1 * frame:.1f},0" for frame in range(count)]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows))
    alone = {"pred_len": 1, "min_agents": 1, "samples": 2}
    with pytest.warns(InputWarning, match="short is left out: short: no 9 consecutive"):
        rows = run(options(data=tmp_path, **alone))
    assert {row["dataset"] for row in rows} == {"long"}
    for chosen in (
        {"data": tmp_path, "dataset": "short"},
        {"data": tmp_path / "short.csv"},
    ):
        with pytest.raises(InputError, match="no 9 consecutive steps"):
            run(options(**chosen, **alone))


@pytest.mark.slow
def test_further_metrics_where_they_are_asked_for(options, capsys, tmp_path):
    rng = np.random.default_rng(0)
    heading = rng.normal(0, 0.2, (3, 150)).cumsum(1)
    paths = 0.4 * np.stack([np.cos(heading), np.sin(heading)], axis=-1).cumsum(1)
    rows = [
        f"{step},{person},{x:.3f},{y:.3f}"
        for person, path in enumerate(paths)
        for step, (x, y) in enumerate(path)
    ]
    data = tmp_path / "walks.csv"
    data.write_text("\n".join(rows))
    fields = {"metrics": ("energy_score", "coverage_50"), "symbols": True}
    velocity, sampled = run(options(**fields, data=data, samples=4, period=0.4))
    assert "crps" not in sampled
    assert sampled["energy_score"] < velocity["energy_score"]
    assert velocity["coverage_50"] is None  # A single forecast has no region.
    for row in (velocity, sampled):
        assert 0.1 < row["state_log_low"] < row["state_log"] < 4.4
        assert 0.01 < row["event_log"] < 0.7
    out = capsys.readouterr().out
    assert {"energy", "covered", "states", "events"} < set(out.split())
    assert "states, events: log scores" in out


@pytest.mark.slow
def test_another_rate_than_in_training_is_told(options, tmp_path):
    model = load_model("sgan_simulations_8")
    config = dataclasses.replace(model.config, period=0.2)
    save_model(tmp_path / "m", dataclasses.replace(model, config=config))
    fields = {
        "model": (str(tmp_path / "m"),),
        "samples": 2,
        "dataset": "cross-path",
    }
    with pytest.warns(
        InputWarning, match=r"m: was trained on steps of 0\.2 s and is tested on"
    ):
        run(options(**fields, collisions=False))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rows = run(options(**fields, collisions=False, period=0.2))
    assert rows[0]["joint_ade"] > 0


@pytest.mark.slow
def test_joint_metrics_matter_counts_these_windows(shared, options):
    fields = {
        "protocol": "joint-metrics",
        "baselines": ("constant_velocity",),
        "collisions": False,
    }
    scenes = "eth", "hotel", "univ", "zara1", "zara2"
    # The fastest that forecast 12 steps, each tested on the scene it has not learned from.
    tables = tuple(f"anchor_table_{scene}_12" for scene in scenes)
    tested = run(options(model=tables, data=shared / "data/eth_ucy", **fields))
    rows = [row for row in tested if row["checkpoint"] is None]
    assert [row["scenes"] for row in rows] == [253, 445, 947, 705, 998]
    # Its mean over scenes, and of the five: .539 / 1.152, see docs/evaluate.md.
    for error, mean in (("joint_ade", 0.539), ("joint_fde", 1.152)):
        values = [row[error] for row in rows]
        assert np.mean(values) == pytest.approx(mean, abs=0.001)


@pytest.mark.parametrize(
    "name", [exhaustive("sgan-models/zara1_8"), "sgan-p-models/hotel_12"]
)
def test_published_numbers(shared, options, name):
    checkpoint = (str(shared / f"checkpoints/{name}_model.pt"),)
    *_, row = run(
        options(model=checkpoint, data=shared / "data/eth_ucy", collisions=False)
    )
    assert (row["joint_ade"], row["joint_fde"]) == pytest.approx(ZOO[name], abs=0.02)
    assert row["samples"] == 20


def test_every_real_sample_of_thor(shared, options):
    with pytest.warns(InputWarning, match=r"goals_positions\.csv: left out"):
        rows = run(options(data=shared / "data/thor", samples=2, collisions=False))
    assert len(rows) == 6
    assert all(row["scenes"] > 200 and 0.2 < row["joint_ade"] < 0.7 for row in rows)


def test_a_metric_that_is_not_finite_is_named(options):
    register_metric("odd", "odd")(lambda forecast, scene: jnp.inf)
    asked_options = options(samples=3, dataset="cross-path")
    log = asked_options.json.with_suffix(".jsonl")
    log.write_text('{"checkpoint": null}\n')
    with pytest.raises(
        InputError, match="metric odd: is not finite for constant velocity on cr"
    ):
        run(asked_options)
    assert not asked_options.json.exists()
    assert log.read_text() == ""
