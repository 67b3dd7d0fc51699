"""Grids of a recording whose phase jumps: windows are those of exact annotations, written as loops.

How a track is interpolated on one grid is tested in `test_tracks`.
"""

import itertools
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neurosym_jax.data import cut_windows, make_tracks, on_grid, resample, windows_from
from neurosym_jax.data.tracks import describe_readings

STRIDE = 10  # frames in 0.4 s


def piece(seed, first, people=4, steps=12):
    """Rows [R, 4] frame, agent, x, y of people who turn a little, annotated every STRIDE frames."""
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0, 6.28, (people, 1)) + rng.normal(
        0, 0.1, (people, steps)
    ).cumsum(axis=1)
    path = 0.5 * np.stack([np.cos(turn), np.sin(turn)], axis=-1).cumsum(axis=1)
    path += rng.uniform(0, 9, (people, 1, 2))
    agent, step = np.mgrid[:people, :steps]
    rows = np.column_stack(
        [first + STRIDE * step.ravel(), agent.ravel(), *path.reshape(-1, 2).T]
    )
    return rows[rng.random(len(rows)) > 0.03]


def exact_windows(rows, length=8):
    """How often each scene occurs whose people are annotated at every one of `length` steps."""
    seen = {(int(frame), int(agent)): (x, y) for frame, agent, x, y in rows}
    scenes = Counter()
    for start in {int(frame) for frame in rows[:, 0]}:
        steps = range(start, start + STRIDE * length, STRIDE)
        ids = {agent for _, agent in seen}
        ways = []
        for agent in ids:
            way = tuple(seen.get((step, agent)) for step in steps)
            if None not in way:
                ways.append(way)
        if len(ways) >= 2:
            scenes[frozenset(ways)] += 1
    return scenes


def scenes_of(rows, length=8, max_gap=0.4, sign=1):
    """The same, cut by the package: without gaps filled, so that every point is an annotation."""
    tracks = make_tracks("r", sign * rows[:, 0] * 0.04, rows[:, 1], rows[:, 2:])
    windows = cut_windows([on_grid(tracks, max_gap=max_gap)], 4, length - 4)
    counts = Counter()
    for scene in np.split(windows.position, windows.bounds[1:-1]):
        counts[frozenset(tuple(map(tuple, way)) for way in scene)] += 1
    return counts, windows


@settings(max_examples=30, deadline=None)
@given(
    seeds=st.lists(st.integers(0, 999), min_size=1, max_size=3),
    gaps=st.lists(st.integers(11, 90), min_size=3, max_size=3),
    stray=st.tuples(st.integers(-99, 700), st.integers(0, 1)),
)
def test_no_phase_costs_a_window(seeds, gaps, stray):
    """Pieces of any phase, a stray row anywhere, before the first too, and time reversed."""
    parts, first = [], 0
    for number, seed in enumerate(seeds):
        rows = piece(seed, first)
        rows[:, 1] += 100 * number
        parts.append(rows)
        first = int(parts[-1][:, 0].max()) + 30 + gaps[number]
    rows = np.concatenate(parts)
    expected = sum(map(exact_windows, parts), Counter())
    if not expected:
        return
    scenes, windows = scenes_of(rows)
    assert scenes == expected
    assert windows.reading[0].interpolated == 0
    assert scenes_of(np.vstack([[stray[0], 999, *2 * [stray[1]]], rows]))[0] == expected
    assert scenes_of(rows, sign=-1)[0].total() == expected.total()


def test_a_phase_that_jumps_while_people_are_seen():
    """The recorder skips half a step, in a gap that interpolation would bridge."""
    early = piece(0, 0)
    late = piece(0, int(early[:, 0].max()) + 15)
    rows = np.concatenate([early, late])
    scenes, windows = scenes_of(rows, max_gap=1.0)
    parts = [scenes_of(part, max_gap=1.0) for part in (early, late)]
    assert scenes == parts[0][0] + parts[1][0]
    assert windows.reading[0].gaps == 1


def test_two_pieces_of_a_file(shared):
    """The right numbers: 10 scenes, 140 people, constant velocity errs by 1.675 m."""
    path = shared / "cases/tables/two_phases.txt"
    windows = windows_from(path, 8, 12)
    assert (windows.scenes, windows.agents) == (10, 140)
    last, speed = (
        windows.position[:, 7],
        windows.position[:, 7] - windows.position[:, 6],
    )
    forecast = last[:, None] + np.arange(1, 13)[:, None] * speed[:, None]
    errors = np.linalg.norm(forecast - windows.position[:, 8:], axis=-1)
    assert np.mean(errors) == pytest.approx(1.675, abs=5e-4)
    rows = np.loadtxt(path)
    positions = {tuple(point) for point in rows[:, 2:]}
    assert {tuple(point) for point in windows.position.reshape(-1, 2)} <= positions


def test_a_minority_is_interpolated_and_counted(tmp_path):
    """Two people on the grid, one 5 frames late: his points, and no others, are no annotations."""
    rows = [
        (10 * step + 5 * (agent == 2), agent, 0.5 * step, 2 * agent)
        for step, agent in itertools.product(range(20), range(3))
    ]
    (tmp_path / "late.txt").write_text(
        "\n".join("{} {} {} {}".format(*row) for row in rows)
    )
    windows = windows_from(tmp_path / "late.txt", 4, 4)
    assert windows.sizes.tolist() == [2, *[3] * 12]
    assert windows.reading[0].interpolated == 19
    assert "19 points of windows interpolated" in describe_readings(windows.reading)


def test_who_is_seen_first_does_not_set_the_phase():
    """One person 5 frames off, seen alone for four steps: the two who come later set the grid."""
    early = [(10 * step + 5, 2, 0.4 * step, 7.0) for step in range(20)]
    pair = [
        (40 + 10 * step, agent, 0.5 * step, 2.0 * agent)
        for step, agent in itertools.product(range(20), (0, 1))
    ]
    for rows in (early + pair, pair + early):
        table = np.array(rows)
        tracks = make_tracks("r", 0.04 * table[:, 0], table[:, 1], table[:, 2:])
        grid = on_grid(tracks)
        own = grid.id < 2
        np.testing.assert_array_equal(grid.known[own], grid.stamp[own])
        assert own.sum() == 40
        assert (grid.known[~own] > grid.stamp[~own]).all()


def test_25_frames_a_second_keep_the_first_moment():
    """No phase has a majority: the grid begins where the recording does, stray rows apart."""
    frame, agent = np.mgrid[:400, :3].reshape(2, -1)
    position = np.stack([0.05 * frame, agent], axis=1)
    tracks = make_tracks("r", 0.04 * (frame + 3), agent, position)
    stray = make_tracks(
        "r",
        np.append(tracks.stamp, -0.03),
        np.append(tracks.id, 9),
        np.vstack([tracks.position, [[0, 0]]]),
    )
    grids = [resample(recording, 0.4) for recording in (tracks, stray)]
    for grid in grids:
        assert grid.step is not None
        np.testing.assert_allclose(
            grid.stamp[grid.id == 0], 0.12 + 0.4 * np.arange(40), atol=1e-9
        )
