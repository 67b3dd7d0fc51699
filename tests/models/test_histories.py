"""People seen for fewer steps than a network observes, or not at every step."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors.network import AnchorConfig, AnchorForecast
from neurosym_jax.models.anchors.training import AnchorRecipe, batch_loss
from neurosym_jax.models.forecast import predict_distribution
from neurosym_jax.models.histories import fill_history, shorten, whole_history
from neurosym_jax.scene import make_scene, with_steps
from tests.networks import random_model

FORECAST = jax.jit(nj.forecast, static_argnums=0)
NAN = np.nan
WALK = np.arange(8.0)[:, None] * [0.5, 0.1]


def test_what_was_not_seen_is_filled_in_from_what_was():
    track = WALK.copy()
    track[[0, 1, 4, 7]] = NAN
    filled, seen = fill_history(track[None], "observed")
    np.testing.assert_allclose(filled[0], WALK, atol=1e-12)
    assert seen[0].tolist() == [False, False, True, True, False, True, True, False]
    once = np.full((1, 8, 2), NAN)
    once[0, 5] = [3.0, 4.0]
    filled, seen = fill_history(once, "observed")
    np.testing.assert_array_equal(filled[0], np.tile([3.0, 4.0], (8, 1)))
    with pytest.raises(InputError, match="observed: agent 1 has no position"):
        fill_history(np.stack([WALK, 0 * WALK + NAN]), "observed")


def test_a_gap_is_filled_without_a_look_at_the_future():
    """Whatever comes after the observation: it is not an argument. Later steps change none before."""
    track = WALK.copy()
    track[6:] = NAN
    track[5] += [0.3, 0]
    filled, _ = fill_history(track[None], "observed")
    velocity = track[5] - track[4]
    np.testing.assert_allclose(filled[0, 6:], track[5] + [velocity, 2 * velocity])


def test_histories_get_the_length_that_a_network_takes():
    for count in (1, 2, 5, 8, 11):
        track = np.arange(float(count))[:, None] * [0.5, 0.1]
        on_host, seen = whole_history(track[None], 8, "observed")
        scene = jax.jit(with_steps, static_argnums=1)(make_scene(track[None]), 8)
        in_jax = np.asarray(scene.observed) + np.asarray(scene.origin)
        np.testing.assert_allclose(in_jax, on_host, atol=1e-5)
        whole = np.arange(8) >= 8 - count
        assert (seen is None) == (count >= 8)
        for mask in (seen, scene.seen):
            if mask is not None:
                np.testing.assert_array_equal(mask[0], whole)


@pytest.fixture(scope="module")
def model():
    return random_model(AnchorConfig(pred_len=4, samples=5, points=8, short=True))


@pytest.fixture(scope="module")
def people():
    rng = np.random.default_rng(0)
    return rng.uniform(0, 5, (3, 1, 2)) + rng.normal(0.3, 0.1, (3, 8, 2)).cumsum(1)


@pytest.mark.slow
def test_whole_histories_are_forecast_as_by_a_network_without_the_layers(model, people):
    layers = model.params["params"]
    trunk = {name: layers[name] for name in layers if not name.startswith("short_")}
    assert len(trunk) < len(layers)
    config = dataclasses.replace(model.config, short=False)
    plain = dataclasses.replace(model, config=config, params={"params": trunk})
    expected = nj.predict(plain, people, samples=5)
    np.testing.assert_array_equal(nj.predict(model, people, samples=5), expected)
    gap = people.copy()
    gap[0, :5] = NAN
    mixed = nj.predict(model, gap, samples=5)
    assert np.abs(mixed[:, 0] - expected[:, 0]).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("steps", [1, 2, 5, 11])
def test_every_path_takes_every_length(model, people, steps):
    before = people[:, :1] - np.array([0.9, 0.6, 0.3])[:, None]
    longer = np.concatenate([before, people], axis=1)
    observed = longer[:, -steps:]
    forecast = nj.predict(model, observed, samples=5)
    assert np.isfinite(forecast).all()
    (same,) = nj.predict_scenes(model, [observed], samples=5)
    np.testing.assert_allclose(same, forecast, atol=1e-5)
    pure = FORECAST(model.config, model.params, observed)
    np.testing.assert_allclose(pure, forecast, atol=1e-5)
    if steps > 8:
        np.testing.assert_array_equal(
            forecast, nj.predict(model, observed[:, -8:], samples=5)
        )


@pytest.mark.slow
def test_somebody_seen_once_may_go_anywhere(model, people):
    observed = np.full((2, 8, 2), NAN)
    observed[0] = people[0]
    observed[1, -1] = people[1, -1]
    draws = predict_distribution(model, observed, draws=200)[:, 1, -1] - people[1, -1]
    assert np.abs(draws.mean(0)).max() < 0.5
    assert np.quantile(np.linalg.norm(draws, axis=1), 0.5) > 0.5


def test_published_networks_keep_their_steps_and_say_so(model):
    network = random_model(nj.GeneratorConfig(pred_len=4, pooling="none"))
    with pytest.raises(InputError, match="observed has 3 steps; the model observes 8"):
        nj.predict(network, WALK[None, :3])
    with pytest.raises(InputError, match="not finite"):
        nj.predict(network, np.where(WALK > 3, NAN, WALK)[None])


def test_no_error_of_tracking_is_added_where_nobody_was_seen():
    """What a training fills in is a straight way, as in a forecast."""
    rng = np.random.default_rng(0)
    people = rng.normal(0.3, 0.1, (40, 8, 2)).cumsum(1)
    scene = make_scene(people).bare().replace(future=people[:, :4].astype("f"))
    scenes = jax.tree.map(lambda leaf: np.asarray(leaf)[None], scene)
    recipe = AnchorRecipe(jitter=0.5, clean_share=0.0)
    learned = []

    def apply(scene, _):
        jax.debug.callback(
            lambda *arrays: learned.append(arrays), scene.observed, scene.seen
        )
        nothing = jnp.zeros((1, 40, 4, 2))
        return AnchorForecast(nothing, jnp.zeros(1), nothing[:0])

    loss = jax.jit(lambda batch, key: batch_loss(apply, batch, key, recipe, short=True))
    loss((scenes, np.zeros(1, int)), jax.random.key(0))
    jax.effects_barrier()
    ((observed, seen),) = learned
    assert np.abs(observed - scenes.observed[0]).max() > 0.5  # It is augmented.
    bends = np.abs(np.diff(observed, n=2, axis=1)).max(axis=2)
    invented = ~seen[:, :-2]  # The first of three steps in a row.
    assert invented.any()
    assert bends[invented].max() < 1e-4
    assert bends[~invented].min() > 1e-3


def test_training_cuts_histories_at_random():
    rng = np.random.default_rng(0)
    people = rng.normal(0.3, 0.1, (40, 8, 2)).cumsum(1)
    scenes = jax.tree.map(
        lambda leaf: np.asarray(leaf)[None], make_scene(people).bare()
    )
    cut = jax.jit(shorten)(scenes, jax.random.key(0))
    seen = np.asarray(cut.seen[0])
    counts = seen.sum(1)
    assert set(counts) == set(range(2, 9))
    assert 0.3 < (counts == 8).mean() < 0.65
    assert (np.diff(seen.astype(int), axis=1) >= 0).all()
    observed = np.asarray(cut.observed[0])
    np.testing.assert_array_equal(observed[seen], scenes.observed[0][seen])
    for track, count in zip(observed[counts < 8], counts[counts < 8]):
        steps = np.diff(track, axis=0)
        expected = np.tile(steps[8 - count], (8 - count, 1))
        np.testing.assert_allclose(steps[: 8 - count], expected, atol=1e-5)
