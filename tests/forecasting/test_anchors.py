"""Anchors as a forecaster: probabilities, numbers of samples, and all the ways to ask for them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.scoring import score, score_forecaster
from neurosym_jax.forecasting import anchors
from neurosym_jax.forecasting.anchors import initial_anchors, spread_of
from neurosym_jax.forecasting.batched import forecast_windows, predict_scenes
from neurosym_jax.forecasting.differentiable import forecast
from neurosym_jax.forecasting.model import Model, SceneForecaster, predict, predict_distribution
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.models.anchors import AnchorConfig, AnchorTableConfig
from neurosym_jax.scene import make_scene

METRICS = ("energy_score", "crps", "coverage_50", "central_ade", "joint_ade")


@pytest.fixture(scope="module")
def model():
    config = AnchorConfig(pred_len=4, samples=5, hidden=8, weighting="learned")
    rng = np.random.default_rng(0)
    params = jax.jit(initial_anchors, static_argnums=0)(config, jax.random.key(0))
    network = jax.tree.map(
        lambda leaf: rng.normal(size=leaf.shape).astype(np.float32) * 0.3, params["params"]
    )
    return Model(config, jax.tree.map(np.asarray, {**params, "params": network}), kind="anchors")


@pytest.fixture(scope="module")
def windows():
    rng = np.random.default_rng(1)
    paths = rng.normal(size=(7, 1, 2)) * 2 + np.cumsum(rng.normal(0.3, 0.1, (7, 12, 2)), axis=1)
    identity = np.array([[0, 0], [0, 1], [0, 2]], np.uint32)
    return Windows(paths, np.arange(7), np.array([0, 2, 4, 7]), identity, 8)


def test_every_way_gives_the_same_samples_and_probabilities(model, windows):
    observed = np.split(windows.position[:, :8], windows.bounds[1:-1])
    futures, likely = forecast_windows(model, windows, make_batches(windows), 5, 0)
    assert likely is not None
    np.testing.assert_allclose(likely.sum(axis=0), 1, rtol=1e-5)
    assert np.ptp(likely, axis=0).min() > 0.01
    for number, scene in enumerate(observed):
        alone, probability = predict_distribution(model, scene, samples=5)
        np.testing.assert_allclose(futures[:, windows.rows(np.array([number]))], alone, atol=1e-5)
        np.testing.assert_allclose(likely[:, number], probability, atol=1e-6)
        np.testing.assert_array_equal(predict(model, scene, samples=5), alone)
    many = predict_scenes(model, observed, samples=5)
    np.testing.assert_allclose(np.concatenate(many, axis=1), futures, atol=1e-5)


def test_fewer_samples_begin_with_the_most_probable_one(model, windows):
    observed = windows.position[:3, :8]
    futures, probability = predict_distribution(model, observed, samples=5)
    one = predict(model, observed, samples=1)
    np.testing.assert_allclose(one[0], futures[probability.argmax()], atol=1e-6)
    three, given = predict_distribution(model, observed, samples=3)
    np.testing.assert_allclose(three[0], one[0], atol=1e-6)
    places = [int(np.abs(futures - each).sum(axis=(1, 2, 3)).argmin()) for each in three]
    assert len(set(places)) == 3
    np.testing.assert_allclose(given, probability[places] / probability[places].sum(), rtol=1e-4)
    for call in (predict, lambda *a, **k: predict_scenes(a[0], [a[1]], **k)):
        with pytest.raises(InputError, match="has 5 samples, not 6: ask for --samples 5 or fewer"):
            call(model, observed, samples=6)


def test_the_spread_serves_the_probable_samples_first():
    ends = jnp.array([0.0, 0.1, 5.0, 9.0])[:, None, None, None] * jnp.ones((1, 2, 3, 2))
    ends = ends.at[:, 1].set(jnp.arange(4.0)[::-1, None, None] * 100)  # A slot of padding.
    valid = jnp.array([True, False])
    chosen = spread_of(ends, jnp.array([0.4, 0.35, 0.05, 0.2]), valid, 3)
    np.testing.assert_array_equal(chosen, [0, 3, 2])


def test_probabilities_count_in_scores(model, windows):
    """Each sample as often as its probability says gives the score of equally probable samples."""
    rng = np.random.default_rng(2)
    forecast, future = rng.normal(size=(3, 2, 4, 2)), rng.normal(size=(2, 4, 2))
    repeated = np.repeat(forecast, [3, 1, 2], axis=0)
    metrics = ("energy_score", "crps")
    weighted = score(forecast, future, probability=[1 / 2, 1 / 6, 1 / 3], metrics=metrics)
    plain = score(repeated, future, metrics=metrics)
    for name in metrics:
        assert weighted[name].mean == pytest.approx(plain[name].mean, rel=1e-4)
    equal = score(forecast, future, probability=[1 / 3] * 3, metrics=METRICS[:3])
    for name, of in score(forecast, future, metrics=METRICS[:3]).items():
        assert equal[name].mean == pytest.approx(of.mean, rel=1e-4)
    # All probability on samples far from the truth covers nothing.
    moved = forecast + np.array([9.0, 9.0, 0.0])[:, None, None, None]
    far = score(moved, future, probability=[0.5, 0.5, 0.0], metrics=["coverage_50"])
    assert far["coverage_50"].mean == 0

    batches = make_batches(windows)
    found = score_forecaster(
        model.forecaster, model.params, batches, samples=5, seed=0, metrics=METRICS
    )
    one = score_forecaster(
        model.forecaster, model.params, batches, samples=1, seed=0, metrics=("joint_ade",)
    )
    assert found.samples == 5
    assert found.mean("central_ade") == pytest.approx(one.mean("joint_ade"), rel=1e-4)
    assert found.mean("joint_ade") < one.mean("joint_ade")


def test_alpha_and_the_weightings_parameters_have_gradients(model, windows):
    seen = windows.position[:3, :8]

    def end(params, alpha, observed):
        return forecast(model.config, params, observed, alpha=alpha)[:, :, -1].sum()

    own = jax.jit(forecast, static_argnums=0)(model.config, model.params, seen)
    np.testing.assert_allclose(own, predict(model, seen, samples=5), atol=1e-4)
    of_alpha, of_observed = jax.jit(jax.grad(end, (1, 2)))(
        model.params, jnp.ones((3, 3, 8)), jnp.asarray(seen)
    )
    assert jnp.abs(of_alpha[..., -1]).max() > 0
    assert jnp.abs(of_alpha[..., :-1]).max() == 0
    assert jnp.abs(of_observed).max() > 0
    of_params = jax.jit(jax.grad(lambda params: end(params, None, jnp.asarray(seen))))(model.params)
    assert any(jnp.abs(leaf).max() > 0 for leaf in jax.tree.leaves(of_params["weighting"]))


@pytest.mark.parametrize("apart", [0.2, 3.0])
def test_a_crowd_is_forecast_as_if_all_pairs_were_computed(monkeypatch, apart):
    model = load_model("anchors_general_8")
    walks = np.random.default_rng(0).normal(0, 0.3, (150, 9, 2)).cumsum(1)[:, 1:]
    walks += apart * np.stack(np.divmod(np.arange(150), 12), -1)[:, None]
    found = {}
    for crowd in (1000, anchors.CROWD):
        monkeypatch.setattr(anchors, "CROWD", crowd)
        run = SceneForecaster(model.forecaster, model.params, samples=20, seed=0)
        found[crowd] = run(make_scene(walks))
    np.testing.assert_allclose(found[anchors.CROWD], found[1000], atol=1e-5)
    near = anchors.neighbours(make_scene(walks), model.config.radius)
    distance = np.linalg.norm(walks[:, None, -1] - walks[:, -1], axis=-1)
    for agent, slots in enumerate(near):  # An agent's own slot fills what is left.
        within = np.flatnonzero(distance[agent] <= model.config.radius)
        assert set(slots) | {agent} == set(within)


def test_the_table_has_equal_probabilities():
    config = AnchorTableConfig(pred_len=4, samples=5)
    params = jax.jit(initial_anchors, static_argnums=0)(config, jax.random.key(0))
    table = Model(config, params, kind="anchor_table")
    _, probability = predict_distribution(table, np.zeros((2, 8, 2)), samples=5)
    np.testing.assert_allclose(probability, 0.2, rtol=1e-5)
    assert table.name == "anchor table"
