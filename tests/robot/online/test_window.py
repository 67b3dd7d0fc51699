"""The window is `data.tracks.resample` as the stream comes in, whatever the stream does."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from neurosym_jax.data.tracks import make_tracks, resample
from neurosym_jax.errors import InputError
from neurosym_robot.online.window import Window

EMPTY = np.zeros((0, 2))


def frames(window: Window, stamps, ids=(1,), speed=1.0):
    """Push everybody walking at `speed`; the number of grid points reached."""
    steps = 0
    for stamp in stamps:
        xy = np.stack([speed * stamp + np.array(ids, float), np.array(ids, float)], 1)
        steps += window.push(stamp, ids, xy)
    return steps


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_an_irregular_stream_is_resampled_as_offline(start):
    rng = np.random.default_rng(0)
    stamps = start + np.cumsum(rng.uniform(0.02, 0.3, 120))
    seen = rng.random((120, 5)) < 0.8
    seen[40:70, 2] = False
    walk = rng.normal(0, 0.1, (120, 5, 2)).cumsum(axis=0)
    rows = np.argwhere(seen)
    tracks = make_tracks("r", stamps[rows[:, 0]], rows[:, 1], walk[rows[:, 0], rows[:, 1]])
    grid = resample(tracks, 0.4, start=stamps[0])
    known = {
        (round((t - stamps[0]) / 0.4), i): xy
        for t, i, xy in zip(grid.stamp, grid.id.tolist(), grid.position)
    }
    window, compared = Window(4, 0.4), 0
    for stamp, here, xy in zip(stamps, seen, walk):
        if not window.push(stamp, np.flatnonzero(here), xy[here]):
            continue
        ids, positions, extrapolated = window.complete()
        assert not extrapolated.any()
        assert list(ids) == sorted(ids)
        whole = {i for i in range(5) if all((window.index - k, i) in known for k in range(4))}
        assert set(ids.tolist()) <= whole
        assert whole & set(np.flatnonzero(here).tolist()) <= set(ids.tolist())
        for i, position in zip(ids.tolist(), positions):
            expected = [known[window.index - 3 + k, i] for k in range(4)]
            assert_allclose(position, expected, atol=1e-6 if start else 1e-12)
            compared += 1
    assert compared > 100


def test_duplicate_backward_and_unusable_stamps_change_nothing():
    window = Window(3, 0.4)
    assert frames(window, np.arange(15) / 10) == 4
    before = window.complete()
    for stamp in (1.4, 1.3, 0.0, np.nan, np.inf, -1e300):
        assert not window.push(stamp, [1, 2], np.ones((2, 2)))
    health = window.health
    assert (health.duplicate_stamps, health.backward_stamps, health.bad_stamps) == (1, 2, 3)
    for one, two in zip(before, window.complete()):
        assert_allclose(one, two)


def test_a_clock_set_back_begins_the_grid_anew():
    window = Window(3, 0.4)
    frames(window, 1000 + np.arange(15) / 10)
    assert window.push(5.0, [1], [[6.0, 1.0]])
    assert (window.index, window.health.clock_resets) == (0, 1)
    assert len(window.complete()[0]) == 0
    frames(window, 5.1 + np.arange(12) / 10)
    assert len(window.complete()[0]) == 1


def test_a_pause_breaks_windows_and_a_short_gap_does_not():
    window = Window(3, 0.4, far=np.inf)
    frames(window, np.arange(13) / 10)
    frames(window, [2.1])
    assert len(window.complete()[0]) == 1
    frames(window, [3.5])
    assert len(window.complete()[0]) == 0
    assert window.health.pauses == 1
    assert window.incomplete() == {1: "unseen"}
    frames(window, 3.6 + np.arange(10) / 10)
    assert len(window.complete()[0]) == 1
    frames(window, [1e6 + 0.1])
    assert window.incomplete() == {1: "unseen"}
    assert window.health.forgotten == 1


def test_nan_people_are_left_out_and_counted():
    window = Window(2, 0.4)
    window.push(0.0, [1, 2, 2, 3], [[0, 0], [np.nan, 0], [1, 1], [1e30, 0]])
    window.push(0.4, np.array([1.0, 2.5, np.nan]), np.zeros((3, 2)))
    health = window.health
    assert (health.bad_positions, health.duplicate_ids, health.bad_ids) == (1, 0, 2)
    assert health.far_positions == 1
    assert window.complete()[0].tolist() == [1]


def test_people_come_and_go_and_say_why_they_are_missing():
    window = Window(3, 0.4)
    frames(window, np.arange(5) / 10, ids=(1, 2))
    frames(window, np.arange(5, 9) / 10, ids=(1, 3))
    assert window.complete()[0].tolist() == [1]
    assert window.incomplete() == {2: "unseen", 3: "short"}
    window.push(20.0, [], EMPTY)
    assert window.incomplete() == {}


def test_floods_of_ids_are_bounded_and_the_nearest_are_followed():
    window = Window(2, 0.4, max_tracks=50)
    ids = np.arange(10_000)
    xy = np.stack([ids / 100.0, np.zeros(10_000)], 1)
    for n in range(3):
        window.push(n * 0.4, ids, xy, focus=[0.0, 0.0])
    assert window.complete()[0].tolist() == list(range(50))
    assert window.health.refused == 3 * 9950
    for n in range(100):
        window.push(100 + n * 20.0, ids + 10_000 * n, xy)
    assert len(window._tracks) == 50


def test_random_streams_never_crash():
    rng = np.random.default_rng(0)
    window = Window(4, 0.4, max_tracks=20)
    now = 0.0
    for _ in range(600):
        count = rng.integers(0, 30)
        now += rng.choice([0.1, 0.1, 0.1, 0.0, -0.05, 3.0, -20.0, 50.0])
        stamp = rng.choice([now, now, now, np.nan, np.inf, rng.normal() * 10.0 ** rng.integers(13)])
        xy = rng.normal(0, 10.0 ** rng.integers(0, 12), (count, 2))
        xy[rng.random(count) < 0.1] = np.nan
        window.push(stamp, rng.integers(-5, 40, count), xy)
        ids, positions, _ = window.complete()
        assert len(np.unique(ids)) == len(ids) <= 20
        assert np.isfinite(positions).all()
    assert window.health.frames == 600


def test_the_robots_filter_puts_who_is_lost_far_away():
    window = Window(3, 0.4, hold=2.0)
    for n in range(30):
        lost = 14 <= n < 20
        xy = [[-3000.0, -3000.0] if lost else [n / 10, 0.0], [0.0, 1.0]]
        window.push(n / 10, [1, 2], xy)
        assert np.abs(window.complete()[1]).max(initial=0) < 10
    assert window.health.far_positions == 6
    assert window.health.jumps == 0
    assert window.complete()[0].tolist() == [1, 2]
    utm = Window(1, 0.4, far=np.inf)
    utm.push(0.0, [1], [[5e5, 5e6]])
    assert len(utm.complete()[0]) == 1


def test_who_jumps_is_somebody_new():
    window = Window(3, 0.4)
    known = {}
    for n in range(40):
        xy = [n / 10, 0.0] if n < 18 else [n / 10, 4.0]
        if window.push(n / 10, [1], [xy]):
            known[n] = window.complete()[1]
    assert window.health.jumps == 1
    for n, positions in known.items():
        # No window has both sides of the jump, and a step between them is in none.
        assert len(positions) == (8 <= n <= 16 or n >= 32), n
        assert len(np.unique(positions[..., 1])) <= 1
    anything = Window(3, 0.4, max_speed=np.inf)
    for n in range(20):
        anything.push(n / 10, [1], [[100.0 * (n % 2), 0.0]])
    assert anything.health.jumps == 0


def test_who_was_lost_a_moment_ago_is_extrapolated_and_said_to_be():
    window = Window(4, 0.4, hold=1.0)
    whole = {}
    for n in range(60):
        seen = [1, 2] if not 22 <= n < 28 and n < 45 else [2]
        xy = [[n / 10, 1.0] if id == 1 else [0.0, 0.0] for id in seen]
        if window.push(n / 10, seen, xy):
            ids, positions, extrapolated = window.complete()
            whole[n] = dict(zip(ids.tolist(), extrapolated.tolist()))
            if 1 in whole[n]:
                wanted = n / 10 - 0.4 * np.arange(3, -1, -1)
                assert_allclose(positions[0, :, 0], wanted, atol=1e-9)
    assert [whole[n].get(1) for n in (20, 24, 28)] == [0, 1, 0]
    assert [whole[n].get(1) for n in (44, 48, 52, 56)] == [0, 1, 2, None]
    assert all(each[2] == 0 for n, each in whole.items() if n >= 12)
    assert window.incomplete() == {1: "unseen"}


def test_misuse_is_refused():
    with pytest.raises(InputError, match="xy"):
        Window(2, 0.4).push(0.0, [1], [[1, 2, 3]])
    with pytest.raises(InputError, match="whole"):
        Window(2, 0.4).push(0.0, ["a"], [[1, 2]])
    with pytest.raises(InputError, match="period"):
        Window(2, 0.0)
    with pytest.raises(InputError, match="timeout"):
        Window(2, 0.4, timeout=0.5)
    with pytest.raises(InputError, match="hold"):
        Window(2, 0.4, hold=20.0)
    with pytest.raises(InputError, match="max_tracks"):
        Window(2, 0.4, max_tracks=0)
