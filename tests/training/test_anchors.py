"""The training of anchors and their table: crowds, batches, and runs."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.evaluation.scores import score
from neurosym_jax.models.anchors.network import (
    AnchorConfig,
    AnchorForecast,
    AnchorTableConfig,
)
from neurosym_jax.models.anchors.training import (
    AnchorRecipe,
    AnchorStream,
    anchor_loss,
    company,
    overlap,
    personal_energy,
    points_loss,
    step_energy,
)
from neurosym_jax.models.disk import load_model
from neurosym_jax.training.batches import augment
from neurosym_jax.training.loop import train_run
from tests.repository import exhaustive

pytestmark = pytest.mark.usefixtures("one_class")
LOSS = jax.jit(anchor_loss, static_argnums=4)
RECIPE = AnchorRecipe(
    steps=40,
    batch_people=48,
    validate_every=20,
    warmup_steps=5,
    learning_rate=0.01,
    ema=0.8,
)


def test_overlapping_people_cost_by_their_distance():
    x = jnp.array([0.0, 0.2, 5.0, 0.1])  # The last is not there.
    forecast = jnp.stack([x, 0 * x], -1)[None, None, :, None].repeat(3, axis=3)
    valid = jnp.array([[True, True, True, False]])
    spreading = forecast.at[..., 1:, 0].add(x[:, None])
    cost = jax.jit(overlap)(spreading, valid)[0, 0]
    # At 0.2 m in the first of three steps, at 0.4 m in the others.
    np.testing.assert_allclose(cost, [0.25, 0.25, 0, 0], atol=1e-6)
    target = jnp.zeros((1, 4, 3, 2))
    forecast = AnchorForecast(forecast, jnp.zeros((1, 1)), forecast[:, :0])

    def collision_loss(weight):
        recipe = AnchorRecipe(collision_weight=weight)
        return LOSS(forecast, target, valid, jnp.zeros(1, int), recipe)

    assert float(collision_loss(2.0) - collision_loss(0.0)) == pytest.approx(
        2 * (0.75 + 0.75) / 3, abs=1e-5
    )


def test_scenes_of_a_crowd_share_their_best_sample():
    future = jnp.zeros((2, 1, 3, 2))
    forecast = jnp.array([[0.0, 1.0], [1.0, 0.2]])[..., None, None, None] * jnp.ones(
        (1, 3, 2)
    )
    valid, probability = (
        jnp.ones((2, 1), bool),
        jnp.log(jnp.array([[0.1, 0.9], [0.9, 0.1]])),
    )
    forecast = AnchorForecast(forecast, probability, forecast[:, :0])
    none = dict.fromkeys(("joint", "marginal", "mean", "likely", "probability"), 0.0)

    def loss(crowd, **weights):
        weights = {
            f"{name}_weight": value for name, value in {**none, **weights}.items()
        }
        options = AnchorRecipe(**weights, fde_weight=0.0)
        value = LOSS(forecast, future, valid, jnp.array(crowd), options)
        return float(value) / np.sqrt(2)

    separate, merged = [0, 1], [0, 0]
    assert loss(separate, joint=1.0) == pytest.approx(0.1, abs=1e-3)
    assert loss(merged, joint=1.0) == pytest.approx(0.5, abs=1e-3)
    assert loss(merged, marginal=1.0) == pytest.approx(0.1, abs=1e-3)
    assert loss(separate, likely=1.0) == pytest.approx(1.0, abs=1e-3)
    assert loss(separate, probability=1.0) > loss(merged, probability=1.0) > 0
    np.testing.assert_array_equal(company(valid, jnp.array([1, 1])), [1, 1])
    np.testing.assert_array_equal(company(valid, jnp.array([0, 1])), [0, 0])


def known_energy(points, future):
    """The metric where equally probable points are all that can happen, not draws."""
    options = {
        "metrics": ["energy_score"],
        "probability": [1 / len(points)] * len(points),
    }
    return float(score(points, future, **options)["energy_score"].mean)


def test_points_are_scored_by_the_energy_score_of_each_person():
    """By the metric, of a scene for each person; people who are not there count nothing."""
    rng = np.random.default_rng(0)
    points, future = rng.normal(size=(6, 3, 5, 2)), rng.normal(size=(3, 5, 2))
    energy = jax.jit(personal_energy)(points, future)
    for person in range(3):
        row = slice(person, person + 1)
        metric = known_energy(points[:, row], future[row])
        assert energy[person] == pytest.approx(metric, rel=1e-3)
    exact = jax.jit(personal_energy)(
        jnp.repeat(jnp.asarray(future)[None], 4, axis=0), future
    )
    np.testing.assert_allclose(exact, 0, atol=1e-3)
    samples, valid = jnp.zeros((1, 1, 3, 5, 2)), jnp.array([[True, False, True]])

    def loss(weight):
        forecast = AnchorForecast(samples, jnp.zeros((1, 1)), jnp.asarray(points)[None])
        recipe = AnchorRecipe(energy_weight=weight)
        return LOSS(
            forecast, jnp.asarray(future)[None], valid, jnp.zeros(1, int), recipe
        )

    expected = 3 * (energy[0] + energy[2]) / 2
    assert float(loss(3.0) - loss(0.0)) == pytest.approx(float(expected), rel=1e-4)


@pytest.mark.slow
def test_positions_at_single_steps_are_scored_by_themselves():
    """By the metric, at the last step and every third before it, each as a future of one step."""
    rng = np.random.default_rng(0)
    points, future = rng.normal(size=(6, 3, 5, 2)), rng.normal(size=(3, 5, 2))
    energy = jax.jit(step_energy)(points, future)
    for person in range(3):
        row = slice(person, person + 1)
        single = [known_energy(points[:, row, [n]], future[row, [n]]) for n in (1, 4)]
        expected = np.mean(single)
        assert energy[person] == pytest.approx(expected, rel=1e-3)
    batch, valid = (
        (jnp.asarray(array)[None] for array in (points, future)),
        jnp.ones((1, 3), bool),
    )
    recipe = AnchorRecipe(energy_weight=0.0, step_weight=2.0)
    total = points_loss(*batch, valid, recipe)
    assert float(total) == pytest.approx(2 * float(energy.sum()), rel=1e-4)


def test_batches_depend_on_seed_and_step_and_crop_what_is_large(run):
    stream = AnchorStream(run.training, RECIPE)
    scenes, _crowd = stream.batch(3)
    again, _ = AnchorStream(run.training, RECIPE).batch(3)
    np.testing.assert_array_equal(scenes.observed, again.observed)
    assert (stream.batch(4)[0].observed != scenes.observed).any()
    assert scenes.valid.shape == (8, 6)
    assert run.training.sizes.max() > 6
    crowds = np.concatenate([np.bincount(stream.batch(step)[1]) for step in range(50)])
    assert crowds.min() == 1
    assert crowds.max() > 3
    never = AnchorStream(run.training, dataclasses.replace(RECIPE, crowd_share=0.0))
    np.testing.assert_array_equal(never.batch(0)[1], np.arange(8))


@pytest.mark.slow
def test_some_scenes_are_observed_without_noise_and_all_are_stretched(run):
    scenes = AnchorStream(
        run.training, dataclasses.replace(RECIPE, batch_people=720)
    ).batch(0)[0]
    (moved,) = augment((scenes,), jax.random.key(0), RECIPE)

    def stretch(field):
        after, before = (
            np.linalg.norm(getattr(part, field), axis=-1) for part in (moved, scenes)
        )
        return np.where(before > 0, after / np.maximum(before, 1e-9), np.nan)

    ratio = np.nanmean(stretch("future"), axis=(1, 2))
    assert 1 / 1.6 <= ratio.min() < 0.8
    assert 1.25 < ratio.max() <= 1.601
    straight = stretch("observed")
    clean = np.nanmax(np.abs(straight - ratio[:, None, None]), axis=(1, 2)) < 1e-4
    assert 0.35 < clean.mean() < 0.65


@pytest.mark.slow
@pytest.mark.parametrize(
    ("network", "kind"),
    [
        (AnchorConfig(4, 3, hidden=8), "anchors"),
        exhaustive(AnchorConfig(4, 3, points=6, hidden=8), "anchors"),
        exhaustive(AnchorTableConfig(4, 3), "anchor_table"),
    ],
)
def test_training_learns_and_a_resumed_run_ends_with_the_same_bits(
    run, network, kind, tmp_path, interrupt_at, final
):
    run, rows = dataclasses.replace(run, config=network, recipe=RECIPE), []
    train_run(run, tmp_path / "alone", on_row=rows.append)
    assert rows[-1]["loss"] < 0.9 * rows[0]["loss"]
    with pytest.raises(KeyboardInterrupt):
        train_run(run, tmp_path / "run", on_row=interrupt_at(40))
    train_run(run, tmp_path / "run", resume=True)
    assert final(tmp_path / "run") == final(tmp_path / "alone")
    model = load_model(tmp_path / "run" / "model")
    assert (model.family, model.config) == (kind, network)
    assert kind == "anchor_table" or np.ptp(model.params["params"]["prior"]) > 0
    facts = json.loads((tmp_path / "run" / "run.json").read_text())
    assert (facts["forecaster"], facts["samples"]) == (kind, 20)
