"""Which positions are taken for tracking errors, and what a network sees in their place."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import neurosym_jax as nj
from neurosym_jax.errors import InputWarning
from neurosym_jax.forecasting.tracking_errors import limit_displacement, repair_tracks

TIME = np.arange(8.0)[:, None]
WALK = TIME * [0.5, 0.1]


def repaired(track):
    """Of one track by numpy, which jax must equal."""
    tracks, offsets = repair_tracks(track[None], 0.4)
    for mine, other in zip(
        (tracks, offsets),
        jax.jit(repair_tracks, static_argnums=1)(jnp.asarray(track[None]), 0.4),
    ):
        np.testing.assert_allclose(mine, other, atol=1e-4)
    return tracks[0], offsets[0]


@pytest.mark.parametrize("step", range(8))
@pytest.mark.parametrize("size", [1.0, 3.0, 1000.0])
def test_a_single_wrong_position_is_replaced(step, size):
    wrong = WALK.copy()
    wrong[step] += [0, size]
    track, offset = repaired(wrong)
    np.testing.assert_allclose(track, WALK, atol=1e-9)
    np.testing.assert_allclose(offset, [0, size if step == 7 else 0], atol=1e-9)


def test_after_a_lasting_jump_the_track_ends_where_it_is():
    wrong = WALK + np.where(TIME >= 5, [0, 30.0], 0)
    track, offset = repaired(wrong)
    np.testing.assert_allclose(track, WALK + np.array([0, 30]), atol=1e-9)
    np.testing.assert_array_equal(offset, 0)


def test_two_wrong_positions_and_a_track_of_nothing_else():
    wrong = WALK.copy()
    wrong[3:5] += [[0, 8.0], [6.0, 0]]
    track, _ = repaired(wrong)
    assert np.linalg.norm(np.diff(track, axis=0), axis=1).max() < 0.52
    np.testing.assert_array_equal(track[-1], WALK[-1])
    everywhere, offset = repaired(TIME * [9.0, 0])
    np.testing.assert_array_equal(everywhere, everywhere[:1].repeat(8, 0))
    np.testing.assert_array_equal(everywhere[-1] + offset, [63, 0])


def test_what_people_do_keeps_its_bits():
    turn = np.cumsum(
        [[1.2, 0]] * 4 + [[0.6, 0.2], [-0.3, 0.2], [-0.6, 0], [-0.6, 0]], 0
    )
    stop = np.cumsum([[0.6, 0]] * 6 + [[0, 0]] * 2, 0)
    run = TIME * [1.5, 0]
    noise = np.random.default_rng(0).normal(size=(8, 2)) * 0.1
    for track in (WALK, turn, stop, run, WALK + noise):
        result, offset = repaired(track)
        np.testing.assert_array_equal(result, track)
        np.testing.assert_array_equal(offset, 0)


def test_displacements_are_limited_smoothly_and_in_their_direction():
    ahead = jnp.array([0.1, 0.9, 1.9, 3.0, 1e6])[:, None, None, None] * jnp.array(
        [0.6, 0.8]
    )
    limited = limit_displacement(ahead, jnp.zeros((1, 2)), 0.4)[:, 0, 0]
    distance = jnp.linalg.norm(limited, axis=-1)
    np.testing.assert_allclose(distance[:2], [0.1, 0.9], rtol=1e-3)
    np.testing.assert_allclose(limited / distance[:, None], [[0.6, 0.8]] * 5, rtol=1e-5)
    assert (jnp.diff(distance) > 0).all()
    np.testing.assert_allclose(distance[-1], 4 * 0.4 + 0.3, rtol=1e-5)

    def furthest(scale):
        return limit_displacement(scale * ahead, jnp.zeros((1, 2)), 0.4).sum()

    assert np.isfinite(jax.grad(furthest)(0.0))
    assert np.isfinite(jax.grad(furthest)(1.0))


def test_predict_names_the_agents_and_equals_predict_scenes(model):
    walks = np.stack([WALK[:4], WALK[:4] + np.array([0, 2.0])])
    walks[1, 3] += [0, 50.0]
    with pytest.warns(InputWarning, match="observed: agents 1 have steps beyond 4 m/s"):
        forecast = nj.predict(model("pool_net"), walks)
    with pytest.warns(InputWarning, match="tracking errors"):
        (same,) = nj.predict_scenes(model("pool_net"), [walks])
    np.testing.assert_allclose(forecast, same, atol=1e-5)
