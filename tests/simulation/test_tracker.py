"""Tracker faults do what they say, on simulated walks."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.errors import InputError
from neurosym_jax.simulation.scenarios import simulate, simulate_labelled
from neurosym_jax.simulation.tracker import TrackerFaults


def test_dropouts_have_their_rate_and_length():
    faults = TrackerFaults(dropout=0.02, dropout_seconds=1.0)
    tracks, person = simulate_labelled("all-forward", 2, people=8, faults=faults)
    assert_array_equal(tracks.id, person)
    # An alternating renewal process: 1 s lost for every 1 / 0.02 frames kept, a bit more merged.
    assert len(tracks.id) / (8 * 1201) == pytest.approx(0.82, abs=0.05)
    gaps = np.diff(tracks.stamp)[(np.diff(tracks.id) == 0)]
    lost = gaps[gaps > 0.15] - 0.1
    assert lost.mean() == pytest.approx(1.1, abs=0.25)
    assert np.abs(gaps - 0.1).min() < 1e-9


def test_a_lost_person_returns_under_a_new_id():
    faults = TrackerFaults(dropout=0.01, id_switch=1.0)
    tracks, person = simulate_labelled("cross-path", 2, people=8, faults=faults)
    # Every track is one unbroken piece of one person, and new ids count on from the true ones.
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
    path = simulate("all-forward", 2, faults=TrackerFaults(noise=0.0)).position.reshape(2, -1, 2)
    apart = np.linalg.norm(path[0] - path[1], axis=-1)
    frame = np.rint(tracks.stamp * 10).astype(int)
    assert_array_equal(tracks.position, path[person, frame])
    zero = person[tracks.id == 0]
    swapped = np.flatnonzero(np.diff(zero)) + 1
    assert len(swapped) > 5
    assert (apart[swapped] < 0.8).all()


def test_what_is_out_of_range_is_refused():
    for change in ({"scenario": "sideways"}, {"seed": 2**32}, {"people": 0}, {"duration": np.inf}):
        with pytest.raises(InputError, match="must"):
            simulate(**{"scenario": "cross-path", **change})
    with pytest.raises(InputError, match="must"):
        TrackerFaults(dropout=1.5)
