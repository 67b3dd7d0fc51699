"""Runs: what they leave and tell, resumption to the same bits, and refusals."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.forecasting.model_folder import load_model, replace_card
from neurosym_jax.training import loop
from neurosym_jax.training.batches import SceneStream
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.run import Run, model_card
from neurosym_jax.training.state import sole_writer
from tests.rows import result_row


@pytest.fixture
def learns_nothing(monkeypatch):
    """Rounds take no time; the first leaf of the parameters counts the steps."""

    def advance(state, done, count):
        leaves, structure = jax.tree.flatten(state.params)
        params = jax.tree.unflatten(
            structure, [leaves[0] * 0 + done + count, *leaves[1:]]
        )
        return state._replace(step=state.step + count, params=params), {
            "g_loss": np.ones(count)
        }

    monkeypatch.setattr(Run, "rounds", lambda run: advance)


def rows_of(folder):
    return [json.loads(line) for line in (folder / "metrics.jsonl").open()]


@pytest.fixture(scope="module")
def done(run, tmp_path_factory):
    """The folder of a run left alone."""
    folder = tmp_path_factory.mktemp("alone") / "run"
    rows = []
    train_run(run, folder, on_row=rows.append)
    assert rows == rows_of(folder)
    return folder


@pytest.mark.slow
def test_files_and_card_of_a_run(run, done, tmp_path):
    rows, facts = rows_of(done), json.loads((done / "run.json").read_text())
    assert (done / "curves.png").stat().st_size > 1000
    assert [row["step"] for row in rows] == [25, 50, 75]
    assert all(np.isfinite(list(row.values())).all() for row in rows)
    assert facts["validation"] == (best := min(rows, key=lambda row: row["val_score"]))
    assert facts["counts"]["training"] == {"scenes": 13, "agents": run.training.agents}
    model = load_model(done / "model")
    assert (model.config, model.dataset) == (run.config, "zara1")
    assert model.neighbours == best["val_neighbour_near"]
    assert facts["parameters"] == sum(
        leaf.size for leaf in jax.tree.leaves(model.params)
    )

    text = (done / "model" / "README.md").read_text()
    assert "# SGAN, trained on walks without zara1\n" in text
    facts_of_card = "seed", "jax", "threads", "code", facts["data"]["training"][:16]
    assert all(name in text for name in (f"{best['val_ade']:.3f}", *facts_of_card))
    metrics = {"joint_ade": 0.25, "collision_rate": 0.031, "of_a_plugin": 1.5}
    rows = [
        result_row("SGAN", "zara1", metrics, "here", half=None),
        result_row(
            "constant velocity", "zara1", metrics | {"joint_ade": 0.5}, half=None
        ),
    ]
    folder = shutil.copytree(done / "model", tmp_path / "model")
    replace_card(folder, model_card(facts, rows))
    text = (load_model(folder) and folder / "README.md").read_text()
    assert "| zara1 | SGAN | 20 | 0.250 | 3.1 % | 1.500 |" in text
    assert "| zara1 | constant velocity | 20 | 0.500 |" in text


def test_resumed_runs_end_with_the_same_bits(
    run, done, tmp_path, monkeypatch, stop_at, final
):
    with monkeypatch.context() as patched:
        stop_at(patched, SceneStream, "steps", 50)
        with pytest.raises(KeyboardInterrupt):
            train_run(run, tmp_path)
    assert not (tmp_path / "run.json").exists()
    # What a kill may leave: rows beyond the saved state, half a line.
    with (tmp_path / "metrics.jsonl").open("a") as file:
        file.write('{"step": 75, "g_loss": 1.0}\n{"step": 10')
    train_run(run, tmp_path, resume=True)
    assert final(tmp_path) == final(done)


def test_a_kill_between_the_last_files_is_mended(run, done, tmp_path, final):
    shutil.copytree(done, tmp_path / "run")
    for lost in ("run.json",), ("run.json", "curves.png", "model"):
        for name in lost:
            if name == "model":
                shutil.rmtree(tmp_path / "run" / name)
                continue
            (tmp_path / "run" / name).unlink()
        train_run(run, tmp_path / "run", resume=True)
        assert final(tmp_path / "run") == final(done)


def test_runs_that_cannot_be_resumed_or_written_are_refused(
    run, with_recipe, done, tmp_path
):
    before = (done / "metrics.jsonl").read_bytes()
    other = dataclasses.replace(run, config=dataclasses.replace(run.config, mlp_dim=4))
    for changed, resume, message in (
        (run, False, "holds a run at step 75; resume=True continues it"),
        (with_recipe(seed=5), True, r"holds another run: training.seed 0 \(now 5\)$"),
        (
            with_recipe(steps=50),
            True,
            r"another run: training.steps 50, and 75 are done",
        ),
        (other, True, r"another run: config.mlp_dim 8 \(now 4\)$"),
        (
            dataclasses.replace(run, validation=run.training),
            True,
            "run: data.validation ",
        ),
    ):
        with pytest.raises(InputError, match=message):
            train_run(changed, done, resume=resume)
    assert (done / "metrics.jsonl").read_bytes() == before
    (tmp_path / "model").mkdir()
    with pytest.raises(InputError, match="holds a model and no state to go on from"):
        train_run(run, tmp_path, resume=True)
    (tmp_path / "file").touch()
    for folder in ("file", "file/run", "n" * 300):
        with pytest.raises(InputError, match="cannot be written"):
            train_run(run, tmp_path / folder)
    with (
        sole_writer(tmp_path),
        pytest.raises(InputError, match="another process is training"),
    ):
        train_run(run, tmp_path)
    with sole_writer(tmp_path):
        pass


def test_another_environment_is_told(run, done, capsys, monkeypatch):
    record = loop.record_of(run)
    before = record["environment"]["threads"]
    record["environment"]["threads"] = 77
    monkeypatch.setattr(loop, "record_of", lambda run: record)
    train_run(run, done, resume=True)
    assert (
        f"the run goes on with threads {before} (now 77): other bits"
        in capsys.readouterr().err
    )


def test_a_loss_that_is_not_finite_stops_the_run(
    run, done, tmp_path, monkeypatch, final
):
    steps = SceneStream.steps

    def poisoned(self, first, count):
        bad = np.nan if first >= 25 else 0.0
        groups = steps(self, first, count)
        return tuple(scene.replace(future=scene.future + bad) for scene in groups)

    with monkeypatch.context() as patched:
        patched.setattr(SceneStream, "steps", poisoned)
        with jax.debug_nans(False), pytest.raises(TrainingError) as caught:
            train_run(run, tmp_path)
    message = str(caught.value)
    assert "\n" not in message
    assert "after step 25 numbers are not finite" in message
    assert "g_loss nan" in message
    assert [path.name for path in (tmp_path / "checkpoints").glob("step_*")] == [
        "step_00000025"
    ]
    train_run(run, tmp_path, resume=True)
    assert final(tmp_path) == final(done)


def test_validations_come_when_due_and_the_best_state_is_kept(
    learns_nothing, with_recipe, tmp_path, monkeypatch
):
    scores, rows = iter([3.0, 1.0, 2.0]), []
    errors = {"val_ade": 1.0, "val_fde": 1.0}
    monkeypatch.setattr(
        loop, "validate", lambda *_: errors | {"val_score": next(scores)}
    )
    run = with_recipe(steps=65, validate_every=30, ema=0.0)
    model = train_run(run, tmp_path, on_row=rows.append)
    steps = [(row["step"], "val_ade" in row) for row in rows]
    assert steps == [(25, False), (30, True), (55, False), (60, True), (65, True)]
    assert (np.asarray(jax.tree.leaves(model.params)[0]) == 60).all()
    assert json.loads((tmp_path / "run.json").read_text())["validation"]["step"] == 60


def test_a_dead_pooling_is_warned_of(
    learns_nothing, with_recipe, tmp_path, monkeypatch, capsys
):
    init_state = Run.init_state

    def dead(run):
        state = init_state(run)
        layer = state.params["params"]["pooling"]["mlp"]["layer_1"]
        layer["bias"] = layer["bias"] - 100
        return state

    monkeypatch.setattr(Run, "init_state", dead)
    train_run(with_recipe(steps=25, ema=0.0), tmp_path)
    row = json.loads((tmp_path / "run.json").read_text())["validation"]
    assert row["val_neighbour_share"] == row["val_neighbour_move"] == 0
    warning = "advice: dead pooling at step 25: 0% of people are changed by their neighbours; try"
    assert capsys.readouterr().err.count(warning) == 1
    card = (tmp_path / "model" / "README.md").read_text()
    assert "people whom their neighbours change | 0.0 %" in card
