"""Anchors as a forecaster: probabilities, numbers of samples, and all the ways to ask for them."""

import jax
import numpy as np
import pytest

from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scores import score, score_forecaster
from neurosym_jax.models.anchors import forecaster as anchors
from neurosym_jax.models.anchors.forecaster import spread_of
from neurosym_jax.models.anchors.network import AnchorConfig, AnchorTableConfig
from neurosym_jax.models.disk import load_model
from neurosym_jax.models.forecast import (
    SceneForecaster,
    forecast,
    forecast_windows,
    predict,
    predict_representatives,
    predict_scenes,
)
from neurosym_jax.scene import make_scene
from tests.networks import random_model


@pytest.fixture(scope="module")
def model():
    return random_model(
        AnchorConfig(pred_len=4, samples=5, hidden=8, weighting="learned"), std=0.3
    )


@pytest.fixture(scope="module")
def windows():
    rng = np.random.default_rng(1)
    paths = rng.normal(size=(7, 1, 2)) * 2 + np.cumsum(
        rng.normal(0.3, 0.1, (7, 12, 2)), axis=1
    )
    identity = np.array([[0, 0], [0, 1], [0, 2]], np.uint32)
    return Windows(paths, np.arange(7), np.array([0, 2, 4, 7]), identity, 8)


@pytest.mark.slow
def test_every_way_gives_the_same_samples_and_probabilities(model, windows):
    observed = np.split(windows.position[:, :8], windows.bounds[1:-1])
    futures, likely = forecast_windows(model, windows, make_batches(windows), 5, 0)
    assert likely is not None
    np.testing.assert_allclose(likely.sum(axis=0), 1, rtol=1e-5)
    assert np.ptp(likely, axis=0).min() > 0.01
    for number, scene in enumerate(observed):
        alone, probability = predict_representatives(model, scene, samples=5)
        np.testing.assert_allclose(
            futures[:, windows.rows(np.array([number]))], alone, atol=1e-5
        )
        np.testing.assert_allclose(likely[:, number], probability, atol=1e-6)
        np.testing.assert_array_equal(predict(model, scene, samples=5), alone)
    last = make_scene(scene)
    raw = jax.jit(model.forecaster.forecast)(
        model.params, last.bare(), np.zeros((5, 0))
    )
    np.testing.assert_allclose(raw, alone - last.origin, atol=1e-5)
    many = predict_scenes(model, observed, samples=5)
    np.testing.assert_allclose(np.concatenate(many, axis=1), futures, atol=1e-5)


def test_fewer_samples_have_the_probabilities_given_that_they_are_all(model, windows):
    """The most probable one first, each another: `test_the_spread` has which."""
    observed = windows.position[:3, :8]
    futures, probability = predict_representatives(model, observed, samples=5)
    three, conditional = predict_representatives(model, observed, samples=3)
    distance = np.abs(futures - three[:, None]).max(axis=(2, 3, 4))
    places = distance.argmin(axis=1)
    assert distance.min(axis=1).max() < 1e-4
    assert len({*places}) == 3
    assert places[0] == probability.argmax()
    np.testing.assert_allclose(
        conditional, probability[places] / probability[places].sum(), rtol=1e-4
    )
    with pytest.raises(
        InputError, match="samples: anchors, learned makes at most 5, not 6"
    ):
        predict_scenes(model, [observed], samples=6)


def test_the_spread_serves_the_probable_samples_first():
    ends = np.array([0.0, 0.1, 5.0, 9.0])[:, None, None, None] * np.ones((1, 2, 3, 2))
    ends[:, 1] = np.arange(4.0)[::-1, None, None] * 100  # A slot of padding.
    valid = np.array([True, False])
    spread = jax.jit(spread_of, static_argnums=3)
    chosen = spread(ends, np.array([0.4, 0.35, 0.05, 0.2]), valid, 3)
    np.testing.assert_array_equal(chosen, [0, 3, 2])


@pytest.mark.slow
def test_probabilities_count_in_scores(model, windows):
    """Each sample as often as its probability says gives the score of equally probable samples."""
    rng = np.random.default_rng(2)
    forecast, future = rng.normal(size=(3, 2, 4, 2)), rng.normal(size=(2, 4, 2))
    repeated, proper = np.repeat(forecast, [3, 1, 2], axis=0), ["energy_score", "crps"]
    # Without probabilities, samples are draws, whose pairs are counted otherwise.
    for metrics, probability, same, equal in (
        (proper, [1 / 2, 1 / 6, 1 / 3], repeated, [1 / 6] * 6),
        (["coverage_50"], [1 / 3] * 3, forecast, None),
    ):
        weighted = score(forecast, future, probability=probability, metrics=metrics)
        expected = score(same, future, probability=equal, metrics=metrics)
        for name, equal_score in expected.items():
            assert weighted[name].mean == pytest.approx(equal_score.mean, rel=1e-4)
    # All probability on samples far from the truth covers nothing.
    moved = forecast + np.array([9.0, 9.0, 0.0])[:, None, None, None]
    far = score(moved, future, probability=[0.5, 0.5, 0.0], metrics=["coverage_50"])
    assert far["coverage_50"].mean == 0
    names, means = ("central_ade", "joint_ade"), {}
    for samples in (1, 5):
        options = {"samples": samples, "seed": 0, "metrics": names}
        done = score_forecaster(
            model.forecaster, model.params, make_batches(windows), **options
        )
        means[samples] = [done.mean(name) for name in names]
    assert means[5][0] == pytest.approx(means[1][1], rel=1e-4)
    assert means[5][1] < means[1][1]


@pytest.mark.slow
def test_alpha_and_the_weightings_parameters_have_gradients(model, windows):
    seen = windows.position[:3, :8]

    def end(params, alpha, observed):
        return forecast(model.config, params, observed, alpha=alpha)[:, :, -1].sum()

    alpha_gradient, observed_gradient = map(
        np.asarray,
        jax.jit(jax.grad(end, (1, 2)))(
            model.params, np.ones((3, 3, 8), np.float32), seen.astype(np.float32)
        ),
    )
    assert np.abs(alpha_gradient[..., -1]).max() > 0
    assert np.abs(alpha_gradient[..., :-1]).max() == 0
    assert np.abs(observed_gradient).max() > 0

    def end_and_samples(params):
        samples = forecast(model.config, params, seen)
        return samples[:, :, -1].sum(), samples

    params_gradient, own = jax.jit(jax.grad(end_and_samples, has_aux=True))(
        model.params
    )
    np.testing.assert_allclose(own, predict(model, seen, samples=5), atol=1e-4)
    assert any(
        np.abs(leaf).max() > 0 for leaf in jax.tree.leaves(params_gradient["weighting"])
    )


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [0.2, 3.0])
def test_a_crowd_is_forecast_as_if_all_pairs_were_computed(monkeypatch, spacing):
    model = load_model("anchors_general_8")
    walks = np.random.default_rng(0).normal(0, 0.12, (150, 9, 2)).cumsum(1)[:, 1:]
    walks += spacing * np.stack(np.divmod(np.arange(150), 12), -1)[:, None]
    forecasts = {}
    for crowd in (1000, anchors.CROWD):
        monkeypatch.setattr(anchors, "CROWD", crowd)
        run = SceneForecaster(model.forecaster, model.params, samples=20, seed=0)
        forecasts[crowd] = run(make_scene(walks))
    np.testing.assert_allclose(forecasts[anchors.CROWD], forecasts[1000], atol=1e-5)
    near = anchors.neighbours(make_scene(walks), model.config.radius, 0.4)
    np.testing.assert_array_equal(
        model.forecaster.prepared(make_scene(walks)).near, near
    )
    assert model.forecaster.prepared(make_scene(walks[: anchors.CROWD])).near is None
    distance = np.linalg.norm(walks[:, None, -1] - walks[:, -1], axis=-1)
    for agent, slots in enumerate(near):  # An agent's own slot fills what is left.
        within = np.flatnonzero(distance[agent] <= model.config.radius)
        assert set(slots) | {agent} == set(within)


def test_the_table_has_equal_probabilities():
    table = random_model(AnchorTableConfig(pred_len=4, samples=5), std=0.1)
    _, probability = predict_representatives(table, np.zeros((2, 8, 2)), samples=5)
    np.testing.assert_allclose(probability, 0.2, rtol=1e-5)
    assert table.name == "anchor table"
