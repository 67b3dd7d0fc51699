import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest
from orbax.checkpoint import v1 as ocp

from neurosym_jax.data.batching import make_batches
from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.symbolic.transition import Transition
from neurosym_jax.symbolic.weighting import initial_parameters
from neurosym_jax.training import generator_objective, loop
from neurosym_jax.training.card import write_card
from neurosym_jax.training.checkpoints import TrainingCheckpoints
from neurosym_jax.training.finish import outcome
from neurosym_jax.training.lock import sole_writer
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.metrics_log import MetricsLog
from neurosym_jax.training.step import initial_state
from neurosym_jax.training.stream import SceneStream


class Stop(Exception):
    pass


def interrupt_after(monkeypatch, step):
    """Training ends abruptly when the batches from `step` on are asked for."""
    steps = SceneStream.steps

    def until(self, first, count):
        if first >= step:
            raise Stop
        return steps(self, first, count)

    monkeypatch.setattr(SceneStream, "steps", until)


def poison_after(monkeypatch, step):
    """The futures of the batches from `step` on are not numbers; gives the batches as they are."""
    steps = SceneStream.steps

    def poisoned(self, first, count):
        groups = steps(self, first, count)
        if first < step:
            return groups
        return tuple(scene.replace(future=scene.future + np.nan) for scene in groups)

    monkeypatch.setattr(SceneStream, "steps", poisoned)
    return steps


def leaves(folder):
    """Every leaf of the final state and of the model."""
    final = max((folder / "checkpoints").glob("step_*"))
    arrays = ocp.load(str(final / "state"))
    return {name: array.tobytes() for name, array in arrays.items()}, [
        np.asarray(leaf) for leaf in jax.tree.leaves(load_model(folder / "model").params)
    ]


@pytest.fixture(scope="module")
def told():
    """The rows that the run of `done` tells while it goes on."""
    return []


@pytest.fixture(scope="module")
def done(run, told, tmp_path_factory):
    """The folder of a run left alone."""
    folder = tmp_path_factory.mktemp("alone")
    train_run(run, folder / "run", on_row=told.append)
    return folder / "run"


@pytest.mark.slow
def test_what_a_run_tells(run, done, told):
    rows, model = told, load_model(done / "model")
    assert rows == [json.loads(line) for line in (done / "metrics.jsonl").open()]
    head, *lines = outcome(run, model).splitlines()
    assert head.startswith(f"on the {run.validation.scenes} validation scenes, joint best of 3")
    kept = min((row for row in rows if "val_score" in row), key=lambda row: row["val_score"])
    assert f"ADE {kept['val_ade']:.3f}  FDE {kept['val_fde']:.3f}" in lines[0]
    assert [line.split("  ")[1] for line in lines[1:]] == [
        "constant velocity",
        "constant velocity, sampled",
    ]


def test_a_dead_pooling_is_warned_of(with_recipe, tmp_path, monkeypatch, capsys):
    def dead(*args):
        state = initial_state(*args)
        layer = state.generator["params"]["pooling"]["mlp"]["layer_1"]
        layer["bias"] = layer["bias"] - 100
        return state

    monkeypatch.setattr(generator_objective, "initial_state", dead)
    train_run(with_recipe(steps=25, ema=0.0), tmp_path)
    row = json.loads((tmp_path / "run.json").read_text())["validation"]
    assert row["val_neighbour_share"] == row["val_neighbour_move"] == 0
    warning = (
        "warning: dead pooling at step 25: 0 % of people are changed by their neighbours: "
        "4 of 4 bottleneck units are never above 0\n"
    )
    assert capsys.readouterr().err.count(warning) == 2  # At the validation and at the end.
    assert "the forecasts of 0.0 % of people" in (tmp_path / "model" / "README.md").read_text()


@pytest.mark.slow
def test_what_a_run_leaves(run, done):
    names = {path.name for path in done.iterdir()}
    assert names >= {"checkpoints", "metrics.jsonl", "curves.png", "run.json", "model"}
    assert {path.name for path in (done / "model").iterdir()} == {
        "README.md",
        "config.json",
        "params.safetensors",
    }
    rows = [json.loads(line) for line in (done / "metrics.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [25, 50, 75]
    assert all(np.isfinite(list(row.values())).all() for row in rows)
    assert all(row["val_neighbour_near"] >= 0 for row in rows)
    facts = json.loads((done / "run.json").read_text())
    best = min(rows, key=lambda row: row["val_score"])
    assert facts["validation"] == best
    assert facts["counts"]["training"] == {"scenes": 13, "agents": run.training.agents}
    model = load_model(done / "model")
    assert (model.config, model.dataset) == (run.network, "zara1")
    assert model.neighbours == best["val_neighbour_near"]
    assert facts["parameters"] == sum(leaf.size for leaf in jax.tree.leaves(model.params))


def test_the_card(done, tmp_path):
    text = (done / "model" / "README.md").read_text()
    facts = json.loads((done / "run.json").read_text())
    assert "# SGAN, walks" in text
    assert "Not tested yet" in text
    assert f"{facts['validation']['val_ade']:.3f}" in text
    for name in ("seed", "jax", "threads", "code", facts["data"]["training"][:16]):
        assert name in text
    metrics = {"joint_ade": 0.25, "joint_fde": 0.5, "marginal_ade": 0.125, "marginal_fde": 0.375}
    metrics |= {"collision_rate": 0.031, "of_a_plugin": 1.5}
    row = {"checkpoint": "here", "model": "SGAN", "dataset": "zara1", "samples": 20, **metrics}
    row |= {f"{name}_low": None for name in metrics}
    folder = shutil.copytree(done / "model", tmp_path / "model")
    write_card(folder, facts, [row, {**row, "checkpoint": None, "model": "constant velocity"}])
    text = (load_model(folder) and folder / "README.md").read_text()
    assert (
        "| test on zara1: this model | 20 | 0.250 / 0.500 | 0.125 / 0.375 | 3.1 % | 1.500 |" in text
    )
    assert "test on zara1: constant velocity" in text
    assert "Not tested" not in text


@pytest.mark.parametrize("step", [1, 50])
def test_resumed_runs_end_with_the_same_bits(run, done, tmp_path, monkeypatch, step):
    with monkeypatch.context() as patched:
        interrupt_after(patched, step)
        with pytest.raises(Stop):
            train_run(run, tmp_path)
    assert not (tmp_path / "model").exists()
    # What a kill may leave: rows beyond the checkpoint, half a line.
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 75, "g_loss": 1.0}\n{"step": 10')
    train_run(run, tmp_path, resume=True)
    (state, params), (alone, wanted) = leaves(tmp_path), leaves(done)
    assert state == alone
    for ours, theirs in zip(params, wanted):
        np.testing.assert_array_equal(ours, theirs)
    names = ("metrics.jsonl",)
    assert [(tmp_path / n).read_bytes() for n in names] == [(done / n).read_bytes() for n in names]


def test_a_kill_between_the_last_files_is_mended(run, done, tmp_path):
    shutil.copytree(done, tmp_path / "run")
    for lost in ((), ("run.json", "curves.png")):
        shutil.rmtree(tmp_path / "run" / "model")
        for name in lost:
            (tmp_path / "run" / name).unlink()
        train_run(run, tmp_path / "run", resume=True)
        assert (tmp_path / "run" / "model" / "README.md").exists()
        load_model(tmp_path / "run" / "model")


def test_what_cannot_be_resumed_is_refused(run, with_recipe, done, tmp_path):
    before = (done / "metrics.jsonl").read_bytes()
    with pytest.raises(InputError, match="holds a run at step 75; --resume continues it"):
        train_run(run, done)
    with pytest.raises(InputError, match="holds another run: its training differs"):
        train_run(with_recipe(seed=5), done, resume=True)
    with pytest.raises(InputError, match="its data differs"):
        train_run(dataclasses.replace(run, validation=run.training), done, resume=True)
    assert (done / "metrics.jsonl").read_bytes() == before
    (tmp_path / "model").mkdir()
    with pytest.raises(InputError, match="holds a finished model"):
        train_run(run, tmp_path, resume=True)


def test_another_environment_is_told(run, done, capsys, monkeypatch):
    now = loop.run_environment()
    monkeypatch.setattr(loop, "run_environment", lambda: now | {"threads": 77})
    train_run(run, done, resume=True)
    assert f"began with threads {now['threads']} and goes on with 77" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_refused(run, tmp_path):
    (tmp_path / "file").touch()
    for folder in ("file", "file/run", "n" * 300):
        with pytest.raises(InputError, match="cannot be written"):
            train_run(run, tmp_path / folder)


def test_one_process_at_a_time(run, tmp_path):
    with sole_writer(tmp_path), pytest.raises(InputError, match="another process is training"):
        train_run(run, tmp_path)
    with sole_writer(tmp_path):
        pass


def test_a_loss_that_is_not_finite_stops_the_run(run, tmp_path, monkeypatch):
    steps = poison_after(monkeypatch, 25)
    with jax.debug_nans(False), pytest.raises(TrainingError) as caught:
        train_run(run, tmp_path)
    message = str(caught.value)
    assert "\n" not in message
    assert "between step 25 and step 50" in message
    assert "g_loss nan" in message
    assert "step 25 is kept" in message
    assert [path.name for path in (tmp_path / "checkpoints").glob("step_*")] == ["step_00000025"]
    monkeypatch.setattr(SceneStream, "steps", steps)
    train_run(run, tmp_path, resume=True)


def test_nothing_is_kept_of_a_run_lost_at_once(run, tmp_path, monkeypatch):
    poison_after(monkeypatch, 0)
    with jax.debug_nans(False), pytest.raises(TrainingError, match="no step had been saved"):
        train_run(run, tmp_path)
    assert not list((tmp_path / "checkpoints").glob("step_*"))


def test_validations_come_when_they_are_due_and_at_the_end(with_recipe, tmp_path, monkeypatch):
    def advance(generator, recipe, key, state, groups):  # It learns nothing, in no time.
        count = len(groups[0].valid)
        return state._replace(step=state.step + count), {"g_loss": np.ones(count)}

    monkeypatch.setattr(generator_objective, "train_steps", advance)
    train_run(with_recipe(steps=65, validate_every=30), tmp_path)
    rows = MetricsLog(tmp_path / "metrics.jsonl", 1000).rows()
    steps = [(row["step"], "val_ade" in row) for row in rows]
    assert steps == [(25, False), (30, True), (55, False), (60, True), (65, True)]


@pytest.mark.parametrize("change", [{"batch_scenes": 10**9}, {"best_k": 10**9}])
def test_a_batch_beyond_memory_is_refused_before_it_is_taken(with_recipe, tmp_path, change):
    with pytest.raises(InputError, match=r"a batch of .* GB are free: lower batch_scenes, best_k"):
        train_run(with_recipe(**change), tmp_path)


def test_the_best_state_is_kept_not_the_last(with_recipe, tmp_path, monkeypatch):
    scores = iter([3.0, 1.0, 2.0])
    kept = []

    def validate(run, params, batches):
        kept.append(jax.tree.map(np.array, params))
        score = next(scores)
        return {"val_ade": score, "val_fde": score, "val_score": score}

    monkeypatch.setattr(loop, "_validate", validate)
    model = train_run(with_recipe(), tmp_path)
    jax.tree.map(np.testing.assert_array_equal, model.params, kept[1])
    assert json.loads((tmp_path / "run.json").read_text())["validation"]["step"] == 50
    assert sorted(TrainingCheckpoints(tmp_path / "checkpoints")._steps()) == [50, 75]


@pytest.mark.slow
def test_what_a_weighting_estimates_is_kept_as_it_was_counted(with_recipe, make_windows, tmp_path):
    same = make_windows([3] * 13)  # One class to compile.
    run = dataclasses.replace(with_recipe(steps=25, ema=0.0), training=same, validation=same)
    weighting = Transition()
    network = dataclasses.replace(
        run.network, pooling="as_described,bottleneck_dim=4,hidden_dim=16", weighting=weighting
    )
    train_run(dataclasses.replace(run, network=network), tmp_path / "run")
    model = load_model(tmp_path / "run" / "model")
    assert model.config == network
    scenes = [(b.scene.observed, b.scene.valid) for b in make_batches(run.training)]
    estimated = initial_parameters(weighting, scenes)
    jax.tree.map(np.testing.assert_array_equal, model.params["weighting"], estimated)
    assert estimated["transition"].max() > 0.1
