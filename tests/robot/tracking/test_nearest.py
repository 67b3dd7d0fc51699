"""People without ids keep the ones they are given."""

import numpy as np

from neurosym_jax.simulation.scenarios import simulate_labelled
from neurosym_robot.online.frames import frames_of_tracks
from neurosym_robot.tracking.following import CROWD, FORGET, NearestIds
from neurosym_robot.tracking.identity import idf1


def test_ids_follow_people_whatever_their_order():
    rng = np.random.default_rng(0)
    for scenario, people in (("all-forward", 4), ("cross-path", 4)):
        tracks, person = simulate_labelled(scenario, 1, 40.0, people)
        assert (tracks.id == person).all()
        nearest, true, given = NearestIds(), [], []
        for frame in frames_of_tracks(tracks):
            order = rng.permutation(len(frame.ids))
            given.extend(nearest.push(frame.stamp, frame.xy[order]))
            true.extend(frame.ids[order])
        assert idf1(true, given) > 0.97


def test_who_is_gone_for_long_is_somebody_new():
    nearest = NearestIds()
    (one,) = nearest.push(0.0, [[0.0, 0.0]])
    assert nearest.push(FORGET, [[0.0, 0.0]]) == [one]
    assert nearest.push(2 * FORGET + 0.1, [[0.0, 0.0]]) != [one]
    (far,) = nearest.push(2 * FORGET + 0.2, [[5.0, 0.0]])
    assert far not in (one, nearest.push(1.0, [[5.0, 0.0]])[0])


def test_nonsense_is_nobody_and_memory_is_bounded():
    nearest = NearestIds()
    first = nearest.push(0.0, [[np.nan, 0.0], [1.0, 1.0]])
    second = nearest.push(0.1, [[1.0, 1.0], [np.nan, 0.0]])
    assert second[0] == first[1]
    assert second[1] not in first
    assert nearest.push(0.2, []).shape == (0,)
    for n in range(20):
        ids = nearest.push(0.3 + n / 10, np.random.default_rng(n).uniform(0, 1000, (3000, 2)))
        assert len(np.unique(ids)) == 3000
    assert len(nearest._follower.tracks) <= CROWD
    assert len(nearest.push(np.nan, [[0.0, 0.0]])) == 1
