"""What a person owes to where others went: weights are found again, and distance is silence."""

import jax.numpy as jnp
import numpy as np

from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.scene import make_scene
from studies import pairs


def test_weights_of_pairs_are_found_again():
    """Truths drawn among 16 points by known weights; without any, nothing is gained."""
    rng = np.random.default_rng(0)
    feature = rng.uniform(0, 1, (20000, 16, 7))
    weights = np.array([2.0, 1.0, 0, 0, 0, 0, 0])
    truth = (rng.gumbel(size=(20000, 16)) - feature @ weights).argmax(1)
    drawn = (
        jnp.asarray(feature, jnp.float32),
        jnp.asarray(np.eye(16)[truth], jnp.float32),
    )
    found = pairs.fitted([0, 1], [drawn])
    np.testing.assert_allclose(found, weights, atol=0.1)
    assert pairs.gain(found, *drawn).mean() > 0.15
    np.testing.assert_allclose(pairs.gain(jnp.zeros(7), *drawn), 0, atol=1e-5)


def test_a_pair_far_apart_says_nothing_to_each_other():
    model = load_model("anchors_zara1_8")
    walk = np.arange(16.0)[:, None] * [0.5, 0]
    for apart, speaks in ((0.8, True), (40.0, False)):
        tracks = np.stack([walk, walk + np.array([0, apart])])
        scene = make_scene(tracks[:, :8]).bare()
        scene = scene.replace(future=jnp.asarray(tracks[:, 8:] - tracks[:, 7].mean(0)))
        feature, nearness = pairs.features(model.config, model.params, scene)
        assert feature.shape == (2, 32, 7)
        assert bool((np.asarray(feature)[..., 1] > 0.05).any()) == speaks
        assert bool((np.asarray(feature)[..., 2:] > 0).any()) == speaks
        np.testing.assert_allclose(nearness.sum(1), 1, rtol=1e-5)


def test_points_are_compared_with_what_the_other_did():
    """The second of two companions is elsewhere later: all points of the first part from that."""
    model = load_model("anchors_zara1_8")
    tracks = np.arange(16.0)[:, None] * [0.5, 0] + np.array([[[0, 0]], [[0, 0.8]]])
    tracks[1, 8:] += [0, 50]
    scene = make_scene(tracks[:, :8]).bare()
    scene = scene.replace(future=jnp.asarray(tracks[:, 8:] - tracks[:, 7].mean(0)))
    parting = np.asarray(pairs.features(model.config, model.params, scene)[0])[..., 1]
    assert np.ptp(parting[0]) == 0
    assert np.ptp(parting[1]) > 0.2
