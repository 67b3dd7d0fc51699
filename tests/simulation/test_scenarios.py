"""Plausible walks that do what their scenario says, and trackers whose faults do what they say."""

import functools

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.errors import InputError
from neurosym_jax.simulation.scenarios import (
    ROOM,
    TrackerFaults,
    simulate,
    simulate_labelled,
)

SCENARIOS = ["all-forward", "cross-path"]
SEEDS = range(4)


@functools.cache
def exact(scenario, seed, people=2):
    """[P, F, 2] true positions at 10 Hz."""
    tracks = simulate(scenario, seed, people=people, faults=TrackerFaults(noise=0.0))
    return tracks.position.reshape(people, -1, 2)


def apart(path):
    """[pairs, F] metres between every two people at each frame."""
    first, second = np.triu_indices(len(path), 1)
    return np.linalg.norm(path[first] - path[second], axis=-1)


def crossings(first, second):
    """How often two polylines [F, 2] cross each other."""

    def side(origin, end, point):
        a, b = end - origin, point - origin
        return np.sign(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])

    p, q, r, s = first[:-1, None], first[1:, None], second[None, :-1], second[None, 1:]
    return int(
        ((side(p, q, r) != side(p, q, s)) & (side(r, s, p) != side(r, s, q))).sum()
    )


@pytest.mark.parametrize("people", [2, 8])
@pytest.mark.parametrize("scenario", SCENARIOS)
def test_people_walk_at_walking_speed_inside_the_room(scenario, people):
    for seed in SEEDS:
        path = exact(scenario, seed, people)
        assert path.min() > 0.2
        assert (path < np.array(ROOM) - 0.2).all()
        speed = np.linalg.norm(np.diff(path, axis=1), axis=-1) * 10
        assert speed.max() < 1.8
        assert 0.8 < np.median(speed) < 1.35
        # The rest is turning and waiting; no person just stands.
        assert (speed > 0.3).mean() > 0.7
        # No jolts: a person changes velocity by less than 1 m/s within two tenths of a
        # second.
        jolt = (
            np.linalg.norm(path[:, 4:] - 2 * path[:, 2:-2] + path[:, :-4], axis=-1)
            / 0.2
        )
        assert jolt.max() < 1.0
        assert apart(path).min() > 0.3


def test_all_forward_walks_abreast_to_the_end_and_back():
    for seed in SEEDS:
        path = exact("all-forward", seed)
        assert 0.7 < np.median(apart(path)) < 0.9
        velocity = np.diff(path, axis=1) * 10
        moving = (np.linalg.norm(velocity, axis=-1) > 0.8).all(axis=0)
        assert moving.mean() > 0.6
        # The same way at the same time, and side by side rather than in file.
        assert (velocity[0] * velocity[1]).sum(-1)[moving].min() > 0
        gap = np.abs(path[0] - path[1])[1:][moving]
        assert np.median(gap[:, 1]) < 0.2 < 0.6 < np.median(gap[:, 0])
        middle = np.sign(path[0, :, 1] - ROOM[1] / 2)
        assert (np.diff(middle) != 0).sum() >= 12
        assert path[..., 1].min() < 1.6
        assert path[..., 1].max() > ROOM[1] - 1.6


def test_cross_path_crosses_and_avoids():
    for seed in SEEDS:
        path = exact("cross-path", seed)
        assert crossings(path[0], path[1]) >= 12
        # They do meet, and not only in space: again and again within two metres.
        near = apart(path)[0] < 2.0
        assert (np.diff(near.astype(int)) == 1).sum() >= 8


def test_a_seed_is_the_walk_the_noise_and_the_losses_that_it_was_under_x64_too():
    faults = TrackerFaults(dropout=0.02, id_switch=0.5)
    tracks = simulate("all-forward", 0, 20.0, faults=faults)
    assert (len(tracks.id), len(set(tracks.id))) == (290, 7)
    assert len(simulate("all-forward", 1, 20.0, faults=faults).id) != 290
    stood = [[2.56176, 1.45595], [3.37739, 1.4845]]
    np.testing.assert_allclose(tracks.position[tracks.stamp == 0], stood, atol=1e-4)
    with jax.enable_x64(True):
        double = simulate("all-forward", 0, 20.0, faults=faults)
    assert_array_equal(double.id, tracks.id)
    # Ten seconds, in which rounding has no time to grow.
    early = tracks.stamp < 10
    np.testing.assert_allclose(
        double.position[early], tracks.position[early], atol=1e-3
    )


def test_dropouts_have_their_rate_and_length():
    faults = TrackerFaults(dropout=0.02, dropout_seconds=1.0)
    tracks, person = simulate_labelled("all-forward", 2, people=8, faults=faults)
    assert_array_equal(tracks.id, person)
    # An alternating renewal process: 1 s lost for every 1 / 0.02 frames kept, a bit
    # more merged.
    assert len(tracks.id) / (8 * 1201) == pytest.approx(0.82, abs=0.05)
    gaps = np.diff(tracks.stamp)[(np.diff(tracks.id) == 0)]
    lost = gaps[gaps > 0.15] - 0.1
    assert lost.mean() == pytest.approx(1.1, abs=0.25)
    assert np.abs(gaps - 0.1).min() < 1e-9


def test_a_lost_person_returns_under_a_new_id():
    faults = TrackerFaults(dropout=0.01, id_switch=1.0)
    tracks, person = simulate_labelled("cross-path", 2, people=8, faults=faults)
    # Every track is one unbroken piece of one person, and new ids count on from the
    # true ones.
    assert (np.diff(tracks.stamp)[np.diff(tracks.id) == 0] < 0.15).all()
    ids, first = np.unique(tracks.id, return_index=True)
    assert len(ids) > 20
    assert_array_equal(ids, np.arange(len(ids)))
    assert_array_equal(person, person[first][np.searchsorted(ids, tracks.id)])
    assert set(person) == set(range(8))


def test_swaps_happen_between_people_who_are_close():
    faults = TrackerFaults(noise=0.0, id_swap=0.05)
    tracks, person = simulate_labelled("all-forward", 2, faults=faults)
    assert_array_equal(np.unique(tracks.id), [0, 1])
    path = exact("all-forward", 2)
    frame = np.rint(tracks.stamp * 10).astype(int)
    assert_array_equal(tracks.position, path[person, frame])
    zero = person[tracks.id == 0]
    swapped = np.flatnonzero(np.diff(zero)) + 1
    assert len(swapped) > 5
    assert (apart(path)[0, swapped] < 0.8).all()


def test_values_out_of_range_are_refused():
    for change in (
        {"scenario": "sideways"},
        {"seed": 2**32},
        {"people": 0},
        {"duration": np.inf},
    ):
        with pytest.raises(InputError, match="must"):
            simulate(**{"scenario": "cross-path", **change})
    with pytest.raises(InputError, match="must"):
        TrackerFaults(dropout=1.5)
