"""A model at every moment: beginning from one, going on for longer, and ending early.

The names of the issues are those of public projects in which people met what a test is
about.
"""

import dataclasses
import json
import shutil

import jax
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.data.windows import is_fingerprint, seen_before
from neurosym_jax.errors import InputError, TrainingError
from neurosym_jax.models.anchors.network import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.anchors.training import AnchorRecipe
from neurosym_jax.models.disk import find_models, load_model, state_of_run
from neurosym_jax.models.forecaster import forecaster_of
from neurosym_jax.training.loop import train_run
from neurosym_jax.training.state import new_state, update
from tests.training.conftest import random_walks, with_recipe
from tests.training.scripted import write_script

pytestmark = pytest.mark.usefixtures("one_class")
TABLE = AnchorTableConfig(4, 3, samples=3)
RECIPE = AnchorRecipe(
    steps=4,
    validate_every=2,
    batch_scenes=4,
    crowd_share=0.0,
    schedule="constant",
    ema=0.9,
)


@pytest.fixture(scope="module")
def table(run):
    """A run of an anchor table: its step is compiled in a second."""
    return dataclasses.replace(run, config=TABLE, recipe=RECIPE)


@pytest.fixture(scope="module")
def done(table, tmp_path_factory):
    folder = tmp_path_factory.mktemp("table") / "run"
    train_run(table, folder)
    return folder


def equal(tree, other):
    pairs = zip(jax.tree.leaves(tree), jax.tree.leaves(other), strict=True)
    return [a.tobytes() == b.tobytes() for a, b in pairs if a.size]


def steps_of(folder):
    return [json.loads(line)["step"] for line in (folder / "metrics.jsonl").open()]


# Beginning from a model.


@pytest.mark.slow
def test_no_steps_give_the_same_forecasts_to_the_bit(tmp_path):
    """Of what is recommended, whose origin is kept: what it learned, and licences."""
    model, walks = nj.load_model("recommended"), random_walks([5, 5, 6], seed=3)
    windows = dataclasses.replace(
        walks, position=walks.position.repeat(3, axis=1)[:, :16], obs_len=8
    )
    others = dataclasses.replace(windows, position=windows.position[:, ::-1])
    recipe = AnchorRecipe(steps=0)
    tuned = nj.train(
        windows, others, tmp_path, init="recommended", recipe=recipe, data=("mine",)
    )
    observed = walks.position[:5, :1] + np.linspace(0, 3, 8)[:, None]
    for tuned_model in (tuned, load_model(tmp_path)):
        assert (
            nj.predict(tuned_model, observed).tobytes()
            == nj.predict(model, observed).tobytes()
        )
        assert (tuned_model.step, {*tuned_model.data}) == (
            0,
            {"ETH/UCY", "HERMES", "mine"},
        )
        assert is_fingerprint(tuned_model.seen)
    assert steps_of(tmp_path) == [0]


@pytest.mark.slow
def test_a_model_that_began_from_another_has_seen_what_both_learned(
    table, done, tmp_path
):
    other = dataclasses.replace(
        table,
        training=random_walks(table.training.sizes, seed=5),
        init=load_model(done),
    )
    model = train_run(other, tmp_path)
    for windows in (table.training, other.training):
        known_count, looked = seen_before(model.seen, windows)
        assert known_count == looked > 0
    assert not equal(model.params, load_model(done).params)[0]
    # packnet-sfm 69: the model that one begins from is not written over.
    assert load_model(done).seen != model.seen


def test_an_initial_model_must_fit(table, done):
    """VLN-HAMT 2, deep-text-recognition 267: a size mismatch in pages of parameters."""
    init = load_model(done)
    for change, message in (
        (
            {"pred_len": 5},
            r"initial model has another configuration: pred_len 3 \(now 5\)$",
        ),
        ({"period": 0.2}, r"another configuration: period 0\.4 \(now 0\.2\)$"),
    ):
        with pytest.raises(InputError, match=message):
            dataclasses.replace(
                table, config=dataclasses.replace(TABLE, **change), init=init
            )
    with pytest.raises(InputError, match="another configuration"):
        dataclasses.replace(table, config=AnchorConfig(4, 3), init=init)
    with pytest.raises(
        InputError, match="steps must be at least 1 without an initial model"
    ):
        with_recipe(table, steps=0)


def test_what_is_frozen_keeps_its_bits(table):
    """darknet 6248: frozen layers changed. Also in the average, and whatever clipping does."""
    shapes = forecaster_of(AnchorConfig(4, 3, samples=3, hidden=4)).shapes()
    rng = np.random.default_rng(0)
    params, gradient = (
        jax.tree.map(lambda leaf: rng.normal(size=leaf.shape).astype("f4"), shapes)
        for _ in "pg"
    )
    recipe = dataclasses.replace(RECIPE, freeze=("own", "pair"), clip_norm=1.0)
    state = new_state(recipe, params)
    step = jax.jit(lambda state: update(recipe, state, gradient))
    for _ in range(2):
        state = step(state)
    for after in (state.params, state.average):
        for name, before in params["params"].items():
            same = equal(before, jax.tree.map(np.asarray, after["params"][name]))
            assert all(same) if name in recipe.freeze else not any(same), name
    run = dataclasses.replace(table, config=AnchorConfig(4, 3, samples=3, hidden=4))
    with pytest.raises(InputError, match=r"freeze: no module 'encoder' in .*own"):
        with_recipe(run, freeze=("encoder",))


# Going on for longer.


@pytest.mark.slow
def test_more_steps_give_the_bits_of_one_run(table, done, tmp_path, final, capsys):
    """Where the schedule is constant, and validations fall on the end of the shorter run."""
    train_run(with_recipe(table, steps=8), tmp_path / "whole")
    shutil.copytree(done, tmp_path / "more")
    train_run(with_recipe(table, steps=8), tmp_path / "more", resume=True)
    assert final(tmp_path / "more") == final(tmp_path / "whole")
    assert (
        json.loads((tmp_path / "more" / "run.json").read_text())["training"]["steps"]
        == 8
    )
    assert "schedule" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_schedule_that_ended_goes_on_and_says_so(table, tmp_path, capsys):
    """yolov3 626 and composer 1384: the learning rate after resumption is another, or 0."""
    cosine = with_recipe(table, schedule="cosine", warmup_steps=0)
    short = train_run(cosine, tmp_path)
    capsys.readouterr()
    longer = train_run(with_recipe(cosine, steps=8), tmp_path, resume=True)
    warning = "was scheduled for 4 steps, and from step 4 on follows the schedule of 8: other bits"
    assert warning in capsys.readouterr().err
    assert steps_of(tmp_path) == [2, 4, 6, 8]
    assert longer.step == short.step or not equal(short.params, longer.params)[0]


# Ending early.


def test_after_an_interruption_the_best_state_is_the_model(
    table, tmp_path, interrupt_at
):
    """ml-agents 980, coqui 99: Ctrl-C loses the model. Also where one's own function raises."""
    rows, interrupt = [], interrupt_at(4)
    with pytest.raises(KeyboardInterrupt):
        train_run(
            with_recipe(table, steps=8),
            tmp_path,
            on_row=lambda r: (rows.append(r), interrupt(r)),
        )
    model = load_model(tmp_path)
    assert model.step == min(rows, key=lambda row: row["val_score"])["step"]
    assert not (tmp_path / "run.json").exists()
    assert (
        f"Validation chose step {model.step}"
        in (tmp_path / "model/README.md").read_text()
    )
    message = f"{tmp_path}: the state after {model.step} steps of its training"
    (path,) = find_models([tmp_path])
    assert state_of_run(path, model.step) == f"{message}, which is not finished"
    train_run(with_recipe(table, steps=8), tmp_path, resume=True)
    assert "not finished" not in state_of_run(path, model.step)


def test_numbers_that_are_not_finite_are_tried_again_with_smaller_steps(
    scripted, tmp_path, capsys
):
    """Trajectory-Transformer 7; and handwriting-synthesis 16: before anything was saved."""
    for begin, back in ((2, 2), (0, 0)):
        write_script([3.0, 2.0], stable_rate=0.001, stable_steps=begin)
        train_run(scripted, tmp_path / str(begin))
        message = f"after step {begin} numbers are not finite: loss nan; it goes on from step {back}"
        assert f"{message} at learning_rate 0.0004" in capsys.readouterr().err
        assert steps_of(tmp_path / str(begin)) == [2, 4]

    write_script([3.0], stable_rate=0, stable_steps=2)
    again = (
        r"not finite: loss nan, again, with smaller steps; its model is that of step 2"
    )
    with pytest.raises(TrainingError, match=again):
        train_run(scripted, tmp_path / "both")
    assert load_model(tmp_path / "both").step == 2


def test_smaller_steps_stay_smaller_after_resumption(scripted, tmp_path, interrupt_at):
    write_script([3.0, 2.0, 1.0], stable_rate=0.001)
    longer = with_recipe(scripted, steps=6)
    with pytest.raises(KeyboardInterrupt):
        train_run(longer, tmp_path, on_row=interrupt_at(4))
    rows = []
    train_run(longer, tmp_path, resume=True, on_row=rows.append)
    rate = scripted.recipe.learning_rate / 10
    assert rows[-1]["step"] == 6
    assert [row["rate"] for row in rows] == pytest.approx([rate] * len(rows))


def test_patience_counts_from_the_best_and_survives_resumption(
    scripted, tmp_path, interrupt_at
):
    """transformers 28544, fairseq 3531: counted anew; ms-swift 5326: not reset by a better one."""
    patient = with_recipe(scripted, steps=40, patience=3)
    write_script([5.0, 6.0, 4.0, 6.0, 6.0, 6.0, 1.0])
    train_run(patient, tmp_path / "whole")
    assert steps_of(tmp_path / "whole") == [2, 4, 6, 8, 10, 12]
    assert load_model(tmp_path / "whole").step == 6
    with pytest.raises(KeyboardInterrupt):
        train_run(patient, tmp_path / "cut", on_row=interrupt_at(10))
    train_run(patient, tmp_path / "cut", resume=True)
    assert steps_of(tmp_path / "cut") == [2, 4, 6, 8, 10, 12]


def test_a_run_that_goes_on_has_its_model_from_the_start(
    scripted, tmp_path, interrupt_at
):
    write_script([1.0, 2.0, 2.0])
    longer = with_recipe(scripted, steps=6)
    with pytest.raises(KeyboardInterrupt):
        train_run(longer, tmp_path, on_row=interrupt_at(2))
    shutil.rmtree(tmp_path / "model")  # It ended between a state and its model.
    steps = []

    def look(row):
        steps.append(load_model(tmp_path).step)

    train_run(longer, tmp_path, resume=True, on_row=look)
    assert set(steps) == {2}


def test_advice_is_given_once(scripted, tmp_path, capsys):
    write_script([1.0] + [2.0] * 9)
    train_run(with_recipe(scripted, steps=20), tmp_path)
    advice = capsys.readouterr().err
    stalled = "advice: no validation is better than that of step 2 since"
    few = "advice: validation has 10 people in windows: below 100"
    assert (advice.count(stalled), advice.count(few)) == (1, 1)
    assert advice.count("compiling the training step") == 1
    train_run(with_recipe(scripted, steps=20), tmp_path / "quiet", quiet=True)
    assert "compil" not in capsys.readouterr().err


def test_a_full_disk_is_one_line(table, tmp_path, monkeypatch, capfd):
    """Known before a state is written: its library would print tracebacks."""
    full = shutil.disk_usage(tmp_path)._replace(free=1000)
    monkeypatch.setattr(
        "neurosym_jax.training.state.shutil.disk_usage", lambda path: full
    )
    with pytest.raises(
        TrainingError, match=r"No space left on device.*; what was saved before is"
    ):
        train_run(table, tmp_path, quiet=True)
    assert "Traceback" not in capfd.readouterr().err
    assert not list((tmp_path / "checkpoints").glob("*step*"))


def test_damaged_states_are_never_begun_over(table, done, tmp_path, capsys):
    """Without resume nothing is touched; with it, a model that is there is not replaced."""
    shutil.copytree(done, tmp_path / "run")
    for path in (tmp_path / "run/checkpoints").glob("*/sha256"):
        path.write_text("damaged")
    before = (tmp_path / "run/metrics.jsonl").read_bytes()
    for resume, message in (
        (False, "holds a run at step 4; resume=True continues it"),
        (True, "holds a model and no state to go on from"),
        (False, "holds a model and no state to go on from"),
    ):
        with pytest.raises(InputError, match=message):
            train_run(table, tmp_path / "run", resume=resume)
    shutil.rmtree(tmp_path / "run/model")
    (tmp_path / "run/run.json").unlink()
    with pytest.raises(
        InputError, match="whose states are damaged; resume=True begins it anew"
    ):
        train_run(table, tmp_path / "run")
    assert (tmp_path / "run/metrics.jsonl").read_bytes() == before
    assert load_model(done).step in (2, 4)
