"""Runs: what they leave and tell, resumption to the same bits, and refusals."""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

from neurosym_jax.data.windows import make_batches
from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.models.disk import load_model, replace_card
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.run import (
    model_card,
    record_of,
    refuse_other_run,
    validate,
)
from neurosym_jax.training.state import sole_writer
from tests.networks import random_model
from tests.rows import result_row
from tests.training.conftest import with_recipe
from tests.training.scripted import (
    DrawnConfig,
    Scripted,
    ScriptedConfig,
    write_script,
)


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
    best = min(rows, key=lambda row: row["val_score"])
    assert facts["validation"] == best
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


def assert_resumed_to_the_same_bits(run, folder, done, interrupt_at, final, steps):
    """`done` is the folder of the run left alone; `steps` are those of its rows."""
    with pytest.raises(KeyboardInterrupt):
        train_run(run, folder, on_row=interrupt_at(steps[-1]))
    assert not (folder / "run.json").exists()
    # What a kill may leave: rows beyond the saved state, half a line.
    assert [row["step"] for row in rows_of(folder)] == steps
    with (folder / "metrics.jsonl").open("a") as file:
        file.write('{"step": 10')
    train_run(run, folder, resume=True)
    assert final(folder) == final(done)


def test_resumed_runs_end_with_the_same_bits(scripted, tmp_path, interrupt_at, final):
    """Of states; test_stops.py holds it of optimisers and of the order of scenes."""
    write_script([1.0, 2.0])
    train_run(scripted, tmp_path / "alone")
    folders = tmp_path / "run", tmp_path / "alone"
    assert_resumed_to_the_same_bits(scripted, *folders, interrupt_at, final, [2, 4])


@pytest.mark.slow
def test_resumed_runs_of_sgan_end_with_the_same_bits(
    run, done, tmp_path, interrupt_at, final
):
    steps = [25, 50, 75]
    assert_resumed_to_the_same_bits(run, tmp_path, done, interrupt_at, final, steps)


def test_a_kill_between_the_last_files_is_mended(scripted, tmp_path, final):
    write_script([1.0, 2.0])
    train_run(scripted, tmp_path / "alone")
    shutil.copytree(tmp_path / "alone", tmp_path / "run")
    for lost in ("run.json",), ("run.json", "curves.png", "model"):
        for name in lost:
            if name == "model":
                shutil.rmtree(tmp_path / "run" / name)
                continue
            (tmp_path / "run" / name).unlink()
        train_run(scripted, tmp_path / "run", resume=True)
        assert final(tmp_path / "run") == final(tmp_path / "alone")


def test_another_run_is_not_resumed(scripted, tmp_path):
    train_run(scripted, tmp_path)
    before = (tmp_path / "metrics.jsonl").read_bytes()
    shorter = dataclasses.replace(scripted.config, period=0.2)
    for changed, resume, message in (
        (scripted, False, "holds a run at step 4; resume=True continues it"),
        (
            with_recipe(scripted, seed=5),
            True,
            r"holds another run: training.seed 0 \(now 5\)$",
        ),
        (
            with_recipe(scripted, steps=2),
            True,
            r"another run: training.steps 2, and 4 are done",
        ),
        (
            dataclasses.replace(scripted, config=shorter),
            True,
            r"another run: config.period 0.4 \(now 0.2\)$",
        ),
        (
            dataclasses.replace(scripted, validation=scripted.training),
            True,
            "run: data.validation ",
        ),
    ):
        with pytest.raises(InputError, match=message):
            train_run(changed, tmp_path, resume=resume)
    assert (tmp_path / "metrics.jsonl").read_bytes() == before


def test_where_nothing_can_be_resumed_or_written_is_refused(scripted, tmp_path):
    (tmp_path / "model").mkdir()
    with pytest.raises(InputError, match="holds a model and no state to go on from"):
        train_run(scripted, tmp_path, resume=True)
    (tmp_path / "file").touch()
    for folder in ("file", "file/run", "n" * 300):
        with pytest.raises(InputError, match="cannot be written"):
            train_run(scripted, tmp_path / folder)
    with (
        sole_writer(tmp_path),
        pytest.raises(InputError, match="another process is training"),
    ):
        train_run(scripted, tmp_path)
    with sole_writer(tmp_path):
        pass


def test_another_environment_is_told(run, tmp_path, capsys):
    before, now = json.loads(json.dumps(record_of(run))), record_of(run)
    threads = before["environment"]["threads"]
    now["environment"]["threads"] = 77
    refuse_other_run(before, now, 75, tmp_path)
    told = f"the run goes on with threads {threads} (now 77): other bits"
    assert told in capsys.readouterr().err


def test_losses_that_are_not_finite_stop_a_run_that_can_go_on(
    scripted, tmp_path, capsys
):
    write_script([3.0, 2.0], stable_rate=0, stable_steps=2)
    with pytest.raises(TrainingError) as caught:
        train_run(scripted, tmp_path)
    message = str(caught.value)
    assert "\n" not in message
    assert "after step 2 numbers are not finite: loss nan" in message
    states = [path.name for path in (tmp_path / "checkpoints").glob("step_*")]
    assert states == ["step_00000002"]
    write_script([3.0, 2.0])
    train_run(scripted, tmp_path, resume=True)
    assert [row["step"] for row in rows_of(tmp_path)] == [2, 4]


def test_validations_come_when_due_and_the_best_state_is_kept(scripted, tmp_path):
    write_script([3.0, 1.0], every=30)
    run, rows = with_recipe(scripted, steps=65, validate_every=30), []
    Scripted.errors[65] = 2.0
    model = train_run(run, tmp_path, on_row=rows.append)
    errors = {row["step"]: row["val_ade"] for row in rows if "val_ade" in row}
    assert [row["step"] for row in rows] == [25, 30, 55, 60, 65]
    assert errors == pytest.approx({30: 3.0, 60: 1.0, 65: 2.0})
    assert model.params["step"] == 60
    assert json.loads((tmp_path / "run.json").read_text())["validation"]["step"] == 60


@pytest.mark.parametrize(
    ("config", "by_default"),
    [(ScriptedConfig(4, 3), "ade_fde"), (DrawnConfig(4, 3), "energy")],
)
def test_the_best_state_is_chosen_by_what_the_network_is_for(
    scripted, run, config, by_default
):
    batches = make_batches(run.validation)
    for select_by in (None, "ade", "ade_fde", "energy"):
        recipe = dataclasses.replace(scripted.recipe, select_by=select_by)
        selected = dataclasses.replace(scripted, config=config, recipe=recipe)
        row = validate(selected, selected.init_state().params, batches)
        scores = {
            "ade": row["val_ade"],
            "ade_fde": row["val_ade"] + row["val_fde"],
            "energy": row["val_energy_score"],
        }
        assert len(set(scores.values())) == 3
        assert row["val_score"] == scores[select_by or by_default]


def test_a_dead_pooling_is_warned_of(run, tmp_path, capsys):
    """Of a model that is begun from: no step is needed to see it."""
    dead = random_model(run.config)
    layer = dead.params["params"]["pooling"]["mlp"]["layer_1"]
    layer["bias"] = layer["bias"] - 100
    train_run(with_recipe(dataclasses.replace(run, init=dead), steps=0), tmp_path)
    row = json.loads((tmp_path / "run.json").read_text())["validation"]
    assert row["val_neighbour_share"] == row["val_neighbour_move"] == 0
    warning = "advice: dead pooling at step 0: 0% of people are changed by their neighbours; try"
    assert capsys.readouterr().err.count(warning) == 1
    card = (tmp_path / "model" / "README.md").read_text()
    assert "people whom their neighbours change | 0.0 %" in card
