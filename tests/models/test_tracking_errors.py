"""Which steps are taken for tracking errors, and what a network sees in their place."""

import functools
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import neurosym_jax as nj
from neurosym_jax.data.windows import Windows, make_batches
from neurosym_jax.errors import InputWarning
from neurosym_jax.interop.export import program_of
from neurosym_jax.models.forecast import forecast_windows, predict_distribution
from neurosym_jax.models.forecaster import draw_noise
from neurosym_jax.models.tracking_errors import (
    FASTEST,
    limit_displacement,
    repair_tracks,
    unknown_motion,
    was_repaired,
)
from neurosym_jax.scene import scene_identity
from tests.repository import exhaustive

PERIOD = 0.4
TIME = np.arange(8.0)[:, None]
WALK = TIME * [0.5, 0.1]


def repaired(track):
    """Of one track by numpy, which jax must equal."""
    repair = repair_tracks(track[None], PERIOD)
    in_jax = jax.jit(repair_tracks, static_argnums=1)(jnp.asarray(track[None]), PERIOD)
    for mine, other in zip(repair, in_jax):
        np.testing.assert_allclose(mine, other, atol=1e-4)
    return repair.tracks[0], repair.offset[0]


def straight(speed, angle=0.0, acceleration=0.0):
    """Eight positions that end at the origin with this speed, m/s; nobody goes backwards."""
    seconds = PERIOD * np.arange(-7, 1)
    if acceleration > 0:
        seconds = np.maximum(seconds, -speed / acceleration)
    way = speed * seconds + acceleration * seconds**2 / 2
    return way[:, None] * [np.cos(angle), np.sin(angle)]


@pytest.mark.parametrize("speed", [0.3, 1.3, 6.0, 12.0])
@pytest.mark.parametrize("step", range(8))
@pytest.mark.parametrize("size", [1.0, 3.0, 1000.0])
def test_a_single_wrong_position_is_replaced(step, size, speed):
    track = straight(speed, 0.2)
    wrong = track.copy()
    wrong[step] += [0, size]
    result, offset = repaired(wrong)
    np.testing.assert_allclose(result, track, atol=1e-9)
    np.testing.assert_allclose(offset, [0, size if step == 7 else 0], atol=1e-9)


@pytest.mark.parametrize("speed", [1.3, 8.0])
def test_after_a_lasting_jump_the_track_ends_where_it_is(speed):
    track = straight(speed)
    wrong = track + np.where(TIME >= 5, [0, 30.0], 0)
    result, offset = repaired(wrong)
    np.testing.assert_allclose(result, track + np.array([0, 30]), atol=1e-9)
    np.testing.assert_array_equal(offset, 0)


def test_two_wrong_positions():
    wrong = WALK.copy()
    wrong[3:5] += [[0, 8.0], [6.0, 0]]
    track, _ = repaired(wrong)
    assert np.linalg.norm(np.diff(track, axis=0), axis=1).max() < 0.52
    np.testing.assert_array_equal(track[-1], WALK[-1])


def test_a_wrong_position_that_is_left_in_two_steps():
    """Two steps of an error agree with each other, but not with the track's others."""
    wrong = WALK.copy()
    wrong[3:5] += [[0, 4.0], [0, 8.0]]
    track, _ = repaired(wrong)
    np.testing.assert_allclose(track, WALK, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_of_a_track_of_nothing_but_errors_nothing_is_known(seed):
    teleports = np.random.default_rng(seed).uniform(-20, 20, (8, 2))
    pixels = TIME * [30.0, 20.0]
    for track in (teleports, pixels):
        repair = repair_tracks(track[None], PERIOD)
        assert repair.lost.all()
        np.testing.assert_allclose(repair.tracks[0, -1] + repair.offset[0], track[-1])


def curve(speed, radius):
    angle = speed * PERIOD / radius * TIME
    return radius * np.concatenate([np.cos(angle), np.sin(angle)], 1)


def test_what_people_do_keeps_its_bits():
    turn = np.cumsum(
        [[1.2, 0]] * 4 + [[0.6, 0.2], [-0.3, 0.2], [-0.6, 0], [-0.6, 0]], 0
    )
    stop = np.cumsum([[0.6, 0]] * 6 + [[0, 0]] * 2, 0)
    noise = np.random.default_rng(0).normal(size=(8, 2))
    walks = [WALK, turn, stop, WALK + 0.1 * noise]
    runs = [straight(speed) for speed in (3.75, 4.1, 7.0, 12.0, FASTEST - 0.1)]
    starts = [straight(speed, 1.0, 2.0) for speed in (1.0, 4.0, 5.6, 9.0)]
    brakes = [straight(speed, 1.0, -2.0) for speed in (0.0, 4.0, 8.0)]
    rides = [curve(5.0, 6.0), curve(8.0, 16.0), straight(6.0) + 0.15 * noise]
    for track in (*walks, *runs, *starts, *brakes, *rides):
        result, offset = repaired(track)
        np.testing.assert_array_equal(result, track)
        np.testing.assert_array_equal(offset, 0)
        assert not was_repaired(track[None], PERIOD)


def limited(ahead, expansion):
    """Displacements [k, 2] of one agent in one step, limited."""
    factor = jnp.array([expansion])
    result = limit_displacement(ahead.transpose(3, 2, 0, 1), PERIOD, factor)
    return result[:, 0, :, 0].T


@pytest.mark.parametrize("steps", [1, 2, 3, 7])
def test_who_was_repaired_is_whoever_a_repair_changes(steps):
    rng = np.random.default_rng(steps)
    # From walks without an error to pixels, with runners between them.
    scale = 10 ** rng.uniform(-2, 2, (4000, 1, 1))
    speed = rng.uniform(0, 25, (4000, 1, 2)) * PERIOD
    step = speed * rng.integers(0, 2, (4000, 1, 1)) + rng.normal(
        0, scale, (4000, steps, 2)
    )
    tracks = np.concatenate([np.zeros((4000, 1, 2)), step.cumsum(axis=1)], axis=1)
    repair = repair_tracks(tracks, PERIOD)
    changed = (repair.tracks != tracks).any((1, 2)) | repair.offset.any(1) | repair.lost
    assert 500 < changed.sum() < 3500
    np.testing.assert_array_equal(was_repaired(tracks, PERIOD), changed)


@pytest.mark.parametrize("expansion", [1.0, 3.0])
def test_displacements_are_limited_smoothly_and_in_their_direction(expansion):
    sizes = expansion * np.array([0.1, 0.9, 1.9, 3.0, 1e6], np.float32)
    ahead = sizes[:, None, None, None] * np.array([0.6, 0.8], np.float32)
    result = np.asarray(jax.jit(limited)(ahead, expansion))
    distance = np.linalg.norm(result, axis=-1)
    np.testing.assert_allclose(distance[:2], sizes[:2], rtol=4e-3)
    np.testing.assert_allclose(result / distance[:, None], [[0.6, 0.8]] * 5, rtol=1e-5)
    assert (np.diff(distance) > 0).all()
    np.testing.assert_allclose(distance[-1], expansion * 4 * PERIOD + 0.3, rtol=1e-5)

    def furthest(scale):
        return limited(scale * ahead, expansion).sum()

    slope = jax.jit(jax.grad(furthest))
    assert np.isfinite(slope(0.0))
    assert np.isfinite(slope(1.0))


def test_unknown_motion_goes_everywhere_and_nowhere_on_average():
    ends = unknown_motion(100, 12, PERIOD)[:, -1]
    distance = np.linalg.norm(ends, axis=-1)
    assert np.abs(ends.mean(0)).max() < 0.3
    assert distance.min() < 0.1
    np.testing.assert_allclose(distance.max(), 2.0 * 12 * PERIOD, rtol=0.01)


@pytest.fixture(scope="module", params=[8, exhaustive(12)])
def recommended(request):
    return nj.load_model("recommended", pred_len=request.param)


def central_ends(model, tracks):
    """[N, 2] ends of the most probable samples of `tracks [N, 8, 2]`, each person alone."""
    count = len(tracks)
    bounds = np.arange(count + 1)
    identity = scene_identity("", np.arange(count))
    windows = Windows(tracks, np.arange(count), bounds, identity, 8)
    samples, probability = forecast_windows(
        model, windows, make_batches(windows), 20, 0
    )
    return samples[probability.argmax(0), np.arange(count), -1]


SPEEDS = (0.2, 0.5, 1, 1.5, 2, 3, 3.9, 4.1, 5, 6, 7, 8, 10, 12)


def test_a_straight_track_goes_on_at_any_speed(recommended):
    """At constant velocity, and where the speed grew all the while."""
    rng = np.random.default_rng(0)
    ahead = recommended.config.pred_len
    for acceleration in (0.0, 1.0, 2.0):
        speeds = [speed for speed in SPEEDS if speed > 7 * PERIOD * acceleration]
        for angle in rng.uniform(-np.pi, np.pi, 5):
            tracks = np.stack([straight(v, angle, acceleration) for v in speeds])
            way = ahead * np.linalg.norm(tracks[:, -1] - tracks[:, -2], axis=1)
            ends = central_ends(recommended, tracks)
            along = ends @ [np.cos(angle), np.sin(angle)]
            assert (np.abs(along - way) < 0.12 * way + 0.1).all(), along / way
            assert (np.diff(along) > 0).all()
            aside = np.linalg.norm(ends, axis=1) ** 2 - along**2
            assert (np.sqrt(np.maximum(aside, 0)) < 0.06 * way + 0.15).all()


@pytest.mark.slow
def test_the_distribution_of_a_runner_is_that_of_a_walker_enlarged(recommended):
    draws = {}
    for speed in (3.0, 9.0):
        track = straight(speed, 0.5)[None]
        draws[speed] = predict_distribution(recommended, track)[:, 0] / speed
    spread = draws[3.0].std(0).mean()
    np.testing.assert_allclose(draws[9.0].mean(0), draws[3.0].mean(0), atol=0.05)
    np.testing.assert_allclose(draws[9.0].std(0).mean(), spread, rtol=0.1)


def test_whose_steps_are_all_errors_is_forecast_to_go_anywhere(recommended):
    teleports = np.random.default_rng(3).uniform(-20, 20, (1, 8, 2))
    with pytest.warns(InputWarning, match="agents 0 have no plausible step"):
        draws = predict_distribution(recommended, teleports)[:, 0, -1]
    distance = np.linalg.norm(draws - teleports[0, -1], axis=1)
    assert np.median(distance) > 2
    assert distance.max() < 2.1 * PERIOD * recommended.config.pred_len


COMPANY = np.stack([straight(1.3), straight(0.9, 2.0), WALK])
COMPANY += np.array([[0, 0], [1, 1], [-2, 0.7]])[:, None]


@settings(max_examples=40, deadline=None)
@given(
    speed=st.floats(0.2, 12),
    step=st.integers(0, 7),
    size=st.floats(1, 1000),
    angle=st.floats(-np.pi, np.pi),
)
@example(speed=1.3, step=7, size=1000.0, angle=0.0)
def test_one_wrong_position_is_bounded_and_moves_others_little(
    recommended, speed, step, size, angle
):
    right = np.concatenate([straight(speed, angle)[None] + np.array([3, -2]), COMPANY])
    wrong = right.copy()
    wrong[0, step] += size * np.array([np.cos(2 * angle), np.sin(2 * angle)])
    before = nj.predict(recommended, right)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)
        after = nj.predict(recommended, wrong)
    assert np.linalg.norm(after[:, 1:] - before[:, 1:], axis=-1).max() < 0.5
    way = np.linalg.norm(after[:, 0] - wrong[0, -1], axis=-1)
    seconds = PERIOD * np.arange(1, way.shape[1] + 1)
    # An error below the largest change of velocity may be taken for the person's.
    assert (way < 4 / 3 * (speed + 4.5) * seconds + 0.3).all()


def test_predict_names_the_agents_and_equals_predict_scenes(recommended):
    walks = np.stack([WALK, WALK + np.array([0, 2.0])])
    walks[1, 7] += [0, 50.0]
    with pytest.warns(InputWarning, match="observed: agents 1 have steps that contra"):
        forecast = nj.predict(recommended, walks)
    with pytest.warns(InputWarning, match="tracking errors"):
        (same,) = nj.predict_scenes(recommended, [walks])
    np.testing.assert_allclose(forecast, same, atol=1e-4)
    again = nj.predict(recommended, walks, repair=True)
    np.testing.assert_array_equal(forecast, again)


def test_the_warning_is_of_the_line_that_calls(recommended):
    walks = np.stack([WALK, WALK + np.array([0, 2.0])])
    walks[1, 7] += [0, 50.0]
    for call in (
        lambda: nj.predict(recommended, walks),
        lambda: nj.predict_scenes(recommended, [walks]),
        lambda: list(nj.predict_batches([walks], recommended)),
    ):
        with pytest.warns(InputWarning, match="tracking errors") as caught:
            call()
        assert [warning.filename for warning in caught] == [__file__]


def test_published_networks_take_positions_as_they_are(model, recwarn):
    """On every path, for tracks that would be repaired: `nj.forecast` of all of them."""
    walks = np.random.default_rng(0).normal(0, 2, (5, 4, 2)).cumsum(1)
    assert was_repaired(walks, PERIOD).any()
    sgan = model("pool_net")
    noise = draw_noise(sgan.forecaster.noise, 0, scene_identity("", 0)[None], 4, 5)
    forecast = jax.jit(nj.forecast, static_argnums=0)
    expected = forecast(sgan.config, sgan.params, walks, noise[:, 0])
    same = functools.partial(np.testing.assert_allclose, desired=expected, atol=1e-5)
    same(nj.predict(sgan, walks, samples=4))
    same(nj.predict_scenes(sgan, [walks], samples=4)[0])
    same(program_of(sgan, 4)(jnp.asarray(walks), jnp.asarray(noise[:, 0]))[0])
    windows = Windows(
        walks, np.arange(5), np.array([0, 5]), scene_identity("", 0)[None], 4
    )
    same(forecast_windows(sgan, windows, make_batches(windows), 4, 0)[0])
    assert not recwarn.list


@pytest.mark.slow
def test_repair_by_name_is_the_forecast_of_the_repaired_tracks(model):
    walks = np.stack([WALK[:4], 0.1 + 0.5 * WALK[:4]])
    jumps = walks.copy()
    jumps[1, 3] += [0, 50.0]
    sgan = model("pool_net")
    expected = nj.predict(sgan, walks)
    assert not np.allclose(nj.predict(sgan, jumps), expected, atol=1)
    expected[:, 1] += [0, 50.0]
    with pytest.warns(InputWarning, match="agents 1 have"):
        result = nj.predict(sgan, jumps, repair=True)
    np.testing.assert_allclose(result, expected, atol=1e-4)
    with pytest.warns(InputWarning, match="agents 1 have"):
        (result,) = nj.predict_scenes(sgan, [jumps], repair=True)
    np.testing.assert_allclose(result, expected, atol=1e-4)
    with pytest.warns(InputWarning, match="agents 1 have"):
        draws = predict_distribution(sgan, jumps, draws=3, repair=True)
    assert np.linalg.norm(draws[:, 1] - jumps[1, 3], axis=-1).max() < 5
