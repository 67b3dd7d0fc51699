"""The window is `data.resample` of what was seen until now, whatever the stream does."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.data.tracks import make_tracks, resample
from neurosym_robot.online.window import Window

EMPTY = np.zeros((0, 2))


def frames(window: Window, stamps, ids=(1,), speed=1.0):
    """Push everybody walking at `speed`."""
    for stamp in stamps:
        xy = np.stack([speed * stamp + np.array(ids, float), np.array(ids, float)], 1)
        assert window.push(stamp, ids, xy)


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_every_frame_has_a_window_of_what_was_seen_until_it(start):
    rng = np.random.default_rng(0)
    stamps = start + np.cumsum(rng.uniform(0.02, 0.3, 120))
    seen = rng.random((120, 5)) < 0.8
    seen[40:70, 2] = False
    walk = rng.normal(0, 0.1, (120, 5, 2)).cumsum(axis=0)
    window, compared = Window(4, 0.4), 0
    for n, (stamp, present, xy) in enumerate(zip(stamps, seen, walk)):
        assert window.push(stamp, np.flatnonzero(present), xy[present])
        ids, positions, extrapolated, *_ = window.complete()
        assert not extrapolated.any()
        if stamp - stamps[0] < 1.2:
            continue
        # Offline from the rows of this frame and those before it alone.
        rows = np.argwhere(seen[: n + 1])
        tracks = make_tracks(
            "r", stamps[rows[:, 0]], rows[:, 1], walk[rows[:, 0], rows[:, 1]]
        )
        grid = resample(tracks, 0.4, start=stamp - 1.2)
        step = np.rint((grid.stamp - stamp) / 0.4).astype(int)
        positions_by_step = {
            (k, i): xy for k, i, xy in zip(step, grid.id.tolist(), grid.position)
        }
        steps = range(-3, 1)
        people = []
        for i in np.flatnonzero(present):
            if all((k, i) in positions_by_step for k in steps):
                people.append(i)
        assert ids.tolist() == people
        for i, position in zip(ids.tolist(), positions):
            expected = [positions_by_step[k, i] for k in steps]
            assert_allclose(position, expected, atol=1e-6 if start else 1e-12)
            compared += 1
    assert compared > 200


def test_stamps_that_are_refused_change_nothing_and_a_clock_set_back_begins_anew():
    window = Window(3, 0.4)
    frames(window, 1000 + np.arange(15) / 10)
    before = window.complete()
    for stamp in (1001.4, 1001.3, np.nan, np.inf, -1e300):
        assert not window.push(stamp, [1, 2], np.ones((2, 2)))
    health = window.health
    stamps = "duplicate_stamps", "backward_stamps", "bad_stamps"
    assert [health[name] for name in stamps] == [1, 1, 3]
    odd = [[np.nan, 0], [1, 1], [1, 1], [1e30, 0], [-3000.0, -3000.0]]
    other = Window(1, 0.4)
    assert other.push(0.0, [2, 3, 3, 4, 5], odd)
    people = "bad_positions", "duplicate_ids", "far_positions"
    assert [other.health[name] for name in people] == [1, 1, 2]
    assert other.complete()[0].tolist() == [3]
    for earlier, later in zip(before, window.complete()):
        assert_array_equal(earlier, later)
    assert window.push(5.0, [1], [[6.0, 1.0]])
    assert health["clock_resets"] == 1
    assert len(window.complete()[0]) == 0
    frames(window, 5.1 + np.arange(12) / 10)
    assert len(window.complete()[0]) == 1


def test_two_older_frames_in_a_row_are_a_clock_set_back():
    window = Window(3, 0.4)
    frames(window, np.arange(15) / 10)
    accepted = [
        window.push(stamp, [1], [[0.0, 0.0]]) for stamp in (1.2, 1.5, 1.3, 1.35, 1.45)
    ]
    assert accepted == [False, True, False, True, True]
    assert (window.health["backward_stamps"], window.health["clock_resets"]) == (2, 1)
    assert len(window.complete()[0]) == 0


def test_a_pause_breaks_windows_and_a_short_gap_does_not():
    window = Window(3, 0.4)
    frames(window, np.arange(13) / 10)
    frames(window, [2.1])
    assert len(window.complete()[0]) == 1
    frames(window, [3.5])
    nobody = window.complete()[0]
    assert (len(nobody), window.health["pauses"]) == (0, 1)
    assert window.incomplete(nobody) == {1: "short"}
    frames(window, 3.6 + np.arange(10) / 10)
    assert len(window.complete()[0]) == 1
    frames(window, [1000.0])
    assert window.incomplete(nobody) == {1: "short"}
    assert window.health["forgotten"] == 1


def test_floods_of_ids_are_bounded_and_the_nearest_are_followed():
    window = Window(2, 0.4, max_tracks=50)
    ids = np.arange(10_000)
    xy = np.stack([ids / 100.0, np.zeros(10_000)], 1)
    for n in range(3):
        window.push(n * 0.4, ids, xy, focus=[0.0, 0.0])
    assert window.complete()[0].tolist() == list(range(50))
    assert window.health["refused"] == 3 * 9950
    for n in range(100):
        window.push(100 + n * 20.0, ids + 10_000 * n, xy)
    assert window._places.shape[1] == 50
    assert len(window._stamps) <= 3


def test_who_jumps_is_somebody_new():
    window = Window(3, 0.4)
    for n in range(40):
        window.push(n / 10, [1], [[n / 10, 0.0] if n < 18 else [n / 10, 4.0]])
        positions = window.complete()[1]
        assert len(positions) == (8 <= n < 18 or n >= 26), n
        assert len(np.unique(positions[..., 1])) <= 1
    assert window.health["jumps"] == 1


@pytest.mark.parametrize("period", [0.1, 0.4])
def test_a_cyclist_at_12_metres_a_second_is_one_person(period):
    """Also one who brakes; but a standing person is not in another place at once."""
    window = Window(3, 0.4)
    for n in range(20):
        t = n * period
        window.push(t, [1, 2], [[12 * t, 0.0], [12 * t - min(t, 2) ** 2, 5.0]])
    assert window.health["jumps"] == 0
    assert window.complete().ids.tolist() == [1, 2]
    window = Window(3, 0.4)
    for n in range(20):
        window.push(n * 0.1, [1], [[2.0 * (n >= 10), 0.0]])
    assert window.health["jumps"] == 1


def test_who_was_lost_a_moment_ago_is_extrapolated_and_said_to_be():
    window, steps = Window(4, 0.4, hold=1.0), {}
    for n in range(60):
        seen = [1, 2] if not 22 <= n < 28 and n < 45 else [2]
        xy = [[n / 10, 1.0] if id == 1 else [0.0, 0.0] for id in seen]
        window.push(n / 10, seen, xy)
        ids, positions, extrapolated, *_ = window.complete()
        steps[n] = dict(zip(ids.tolist(), extrapolated.tolist()))
        if 1 in steps[n]:
            assert_allclose(
                positions[0, :, 0], n / 10 - 0.4 * np.arange(3, -1, -1), atol=1e-9
            )
    assert [steps[n].get(1) for n in (21, 22, 25, 26, 27, 28)] == [0, 1, 1, 2, 2, 0]
    assert [steps[n].get(1) for n in (44, 48, 54, 55)] == [0, 1, 3, None]
    assert all(state[2] == 0 for n, state in steps.items() if n >= 12)


def test_the_past_is_kept_for_scores_and_no_longer():
    window = Window(2, 0.4, memory=5.0, timeout=2.0, max_gap=1.0)
    for stamp in np.arange(0, 30, 0.5):
        window.push(stamp, [1], [[stamp, 0.0]])
    assert_allclose(window.resampled([1], [24.7, 20.0])[0, :, 0], [24.7, np.nan])


def test_who_was_seen_twice_has_a_window_by_a_line():
    """It walks on as it did, backwards; what was seen is said."""
    window, whole = (Window(8, 0.4, min_seen=n) for n in (0.0, np.inf))
    for n in range(40):
        for one in (window, whole):
            xy = [[0.12 * n, 1.0], [0.0, 0.0]] if n >= 10 else [[0.0, 0.0]]
            one.push(n / 10, [5, 6] if n >= 10 else [6], xy)
        observed = window.complete()
        people = observed.ids.tolist()
        assert (5 in people, 6 in people) == (n >= 11, n >= 1), n
        for row, first in ((people.index(id), 10 * (id == 5)) for id in people):
            since = min((n - first) / 10, 2.8)
            assert observed.seen[row] == pytest.approx(since)
            assert (observed.doubt[row] == 0) == (since > 2.79)
            # A line through two frames tells two steps.
            count = max(int(since / 0.4 + 1e-6) + 1, 2)
            assert_array_equal(observed.sighted[row], np.arange(8) >= 8 - count)
            way = 0.12 * (n - 4 * np.arange(7, -1, -1)) * (first > 0)
            # Two frames may err: a third of the velocity is not believed yet.
            error = np.abs(observed.positions[row, :, 0] - way).max()
            assert error < (1.2 if since < 0.15 else 0.2 / since)
        expected = whole.complete()
        rows = np.isin(observed.ids, expected.ids)
        assert_array_equal(observed.positions[rows], expected.positions)


def test_a_line_is_through_all_that_was_seen_for_a_moment():
    """Errors of 5 cm at 10 Hz: a line through nine frames errs less than two of them."""
    rng, errors = np.random.default_rng(0), []
    for _ in range(100):
        window = Window(8, 0.4, min_seen=0.0)
        for n in range(9):
            noise = rng.normal(0, 0.05, 2)
            window.push(n / 10, [1], [np.add([0.12 * n, 3.0], noise)])
        positions = window.complete().positions[0]
        errors.append((positions[-1] - positions[-2]) / 0.4 - [1.2, 0])
    assert np.std(errors) < 0.08
    assert np.abs(np.mean(errors, axis=0)).max() < 0.02


def test_a_line_is_told_what_is_asked_of_it():
    window = Window(8, 0.4, min_seen=0.8, hold=1.0)
    for n in range(20):
        # Before a gap of more than a second it is another track.
        seen = n < 3 or n >= 16
        window.push(n / 5, [1] if seen else [], [[0.2 * n, 0.0]] if seen else EMPTY)
        assert window.complete().ids.tolist() == []
    window.push(4.0, [1], [[4.0, 0.0]])
    assert window.complete().seen == pytest.approx(0.8)
    # Out of sight, it goes on.
    window.push(4.5, [], EMPTY)
    observed = window.complete()
    assert observed.extrapolated.tolist() == [2]
    assert_allclose(observed.positions[0, -1], [4.5, 0.0], atol=0.02)
