"""People found again behind occlusions: IDF1 on simulated recordings, and what must not happen."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.commands._running import run_command
from neurosym_jax.data.recordings import read_any
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.simulation.scenarios import TrackerFaults, simulate_labelled
from neurosym_robot.commands import stitch as command
from neurosym_robot.tracking.following import frames_of_tracks
from neurosym_robot.tracking.kalman import CROWD, KalmanFilter
from neurosym_robot.tracking.stitching import (
    FRESH,
    LinkOptions,
    OnlineStitcher,
    stitch,
    stitched_ids,
)
from studies.experiment.identity import idf1

FAULTS = TrackerFaults(dropout=0.005, dropout_seconds=1.0, id_switch=1.0)


def live(tracks, stitcher: OnlineStitcher | None = None) -> np.ndarray:
    """[R] ids given frame by frame."""
    stitcher, numbers = stitcher or OnlineStitcher(), np.zeros(len(tracks.id), int)
    order = np.lexsort((tracks.id, tracks.stamp))
    numbers[order] = np.concatenate(
        [stitcher.push(*frame) for frame in frames_of_tracks(tracks)]
    )
    return numbers


def people(ids: np.ndarray) -> set[int]:
    return set(ids.tolist())


def broken(gap: float = 1.0, then: int = 7):
    """A walk along x at 1 m/s at 10 Hz for 4 s, lost for `gap` and found as `then`."""
    stamp = np.concatenate([np.arange(20) / 10, 1.9 + gap + np.arange(20) / 10])
    return make_tracks(
        "r", stamp, np.repeat([3, then], 20), np.stack([stamp, stamp * 0], 1)
    )


@pytest.mark.slow
@pytest.mark.parametrize(("count", "least"), [(2, 0.97), (8, 0.9)])
def test_ids_follow_people(count, least):
    scores = []
    for seed in range(3):
        tracks, person = simulate_labelled("cross-path", seed, 60.0, count, FAULTS)
        numbers = live(tracks)
        assert_array_equal(stitched_ids(tracks)[0], numbers)
        scores.append([idf1(person, tracks.id), idf1(person, numbers)])
    raw, mended = np.mean(scores, axis=0)
    assert raw < 0.6
    assert mended > least


def test_idf1():
    assert idf1([1, 1, 2, 2], [5, 5, 9, 9]) == 1
    assert idf1([1, 1, 1, 1], [5, 5, 6, 6]) == 0.5
    assert idf1([1, 1, -1], [5, -1, 5]) == 0.5
    assert idf1([1, 1], [-1, -1]) == 0


def test_a_broken_track_is_joined_and_filled():
    mended = stitch(broken())
    assert (mended.before, mended.joined) == (2, 1)
    tracks = mended.tracks
    assert len(tracks.id) - len(broken().id) == 9
    assert people(tracks.id) == {3}
    assert_allclose(tracks.position[:, 0], tracks.stamp, atol=1e-9)
    assert_allclose(np.diff(tracks.stamp), 0.1, atol=1e-9)
    assert len(stitch(broken(), fill=0.5).tracks.id) == len(broken().id)
    assert_array_equal(live(broken()), 3)  # The newcomer is published at once.


def test_far_or_late_or_at_the_same_time_is_somebody_else():
    options = LinkOptions(max_gap=2.0)
    assert stitch(broken(gap=2.5), options).joined == 0
    assert people(live(broken(gap=2.5), OnlineStitcher(options))) == {3, 7}
    far = broken()
    far.position[far.id == 7, 1] += 4
    assert stitch(far).joined == 0
    pair = make_tracks(
        "r", [0, 1, 0, 1], [1, 1, 2, 2], [[0, 0], [0, 0], [5, 0], [5, 0]]
    )
    assert stitch(pair).joined == 0


def test_the_nearest_pair_is_linked_first_and_each_track_once():
    stitcher = OnlineStitcher()
    for n in range(10):
        stitcher.push(n / 10, [1, 2], [[n / 10, 0.0], [n / 10, 1.0]])
    # Both newcomers could be either; 2 is expected 0.1 m from the second.
    ids = stitcher.push(1.5, [8, 9], [[1.5, 0.5], [1.5, 0.9]])
    assert ids.tolist() == [1, 2]
    assert stitcher.joined == 2
    other = OnlineStitcher()
    for n in range(10):
        other.push(n / 10, [1, 2], [[n / 10, 0.0], [n / 10, 0.5]])
    assert other.push(1.5, [8, 9], [[1.5, 0.45], [1.5, 0.1]]).tolist() == [2, 1]
    # Who comes back under an id that somebody else has now is somebody new.
    ids = stitcher.push(1.6, [8, 9, 1], [[1.6, 0.5], [1.6, 0.9], [9.0, 9.0]])
    assert ids.tolist() == [1, 2, FRESH + 1]


def test_who_was_seen_three_times_walks_on_and_who_was_seen_once_stands():
    for points, x in ((1, 0.1), (3, 1.2)):
        stitcher = OnlineStitcher()
        for n in range(points):
            stitcher.push(n / 10, [1], [[n / 10, 0.0]])
        assert stitcher.push(1.2, [2], [[x, 0.0]]).tolist() == [1]


def test_nobody_is_withheld_and_sentinels_are_left_alone():
    stitcher = OnlineStitcher(max_tracks=2)
    xy = [[0.0, 0.0], [5.0, 0.0], [9.0, 0.0], [-3000.0, -3000.0]]
    for n in range(3):
        assert stitcher.push(n / 10, [4, 5, 6, 7], xy).tolist() == [4, 5, 6, 7]
    # A frame of the same moment changes nothing, and a clock set back begins anew.
    assert stitcher.push(0.2, [8], [[5.0, 0.0]]).tolist() == [8]
    assert stitcher.push(0.1, [8], [[5.0, 0.0]]).tolist() == [8]
    assert stitcher.joined == 0


def test_who_is_seen_briefly_is_left_out_of_a_recording():
    t = np.arange(60) / 10
    walk = np.stack([t, 0 * t], 1)
    tracks = make_tracks(
        "r",
        np.concatenate([t, [2.0, 2.1]]),
        np.concatenate([np.full(60, 1), [8, 8]]),
        np.concatenate([walk, [[0, 4], [0, 4.1]]]),
    )
    mended = stitch(tracks)
    assert (mended.ghosts, people(mended.tracks.id)) == (2, {1})
    with pytest.raises(InputError, match="nobody is seen for 1 s"):
        stitch(tracks.take(tracks.id != 1))


def test_a_jump_is_somebody_new():
    t = np.arange(80) / 10
    xy = np.stack([np.where(t < 4, t, t + 10), 0 * t], 1)
    numbers = live(make_tracks("r", t, np.full(80, 5), xy))
    before, after = people(numbers[:40]), people(numbers[40:])
    assert before == {5}
    assert len(after) == 1


def test_the_command(tmp_path, capsys):
    source, out = tmp_path / "in.txt", tmp_path / "out.txt"
    command.write_text(source, broken(), 0.1)
    for status, reason in ((0, "2 ids became 1: 1 joins"), (2, "already there")):
        with pytest.raises(SystemExit) as done:
            run_command(command.Options, command.run, [str(source), "--out", str(out)])
        assert done.value.code == status
        assert reason in "".join(capsys.readouterr())
    (tracks,) = read_any(out, frame_period=0.1)
    assert_allclose(tracks.stamp, stitch(broken()).tracks.stamp, atol=1e-9)


def test_people_without_ids_keep_those_that_they_are_given():
    rng = np.random.default_rng(0)
    for scenario in ("all-forward", "cross-path"):
        nearest, true, numbers = KalmanFilter(), [], []
        for frame in frames_of_tracks(simulate_labelled(scenario, 1, 40.0, 4)[0]):
            order = rng.permutation(len(frame.ids))
            numbers.extend(nearest.push(frame.stamp, frame.xy[order]))
            true.extend(frame.ids[order])
        assert idf1(true, numbers) > 0.97
    nearest = KalmanFilter()
    (person,) = nearest.push(0.0, [[0.0, 0.0]])
    assert nearest.push(4.0, [[0.0, 0.0]]) == [person]
    assert nearest.push(8.1, [[0.0, 0.0]]) != [person]
    for n in range(5):
        ids = nearest.push(
            9 + n / 10, rng.uniform(0, 1000, (3000, 2)) * [[1.0, np.nan]]
        )
        assert len(np.unique(ids)) == 3000
        ids = nearest.push(9.05 + n / 10, rng.uniform(0, 1000, (3000, 2)))
    assert len(nearest.numbers) <= CROWD
    assert len(nearest.push(np.nan, [[0.0, 0.0]])) == 1


def test_ids_that_a_tracker_swaps_are_swapped_back():
    stitcher = OnlineStitcher()
    for n in range(60):
        ids = [2, 1] if n % 20 >= 10 else [1, 2]
        xy = [[n / 10, 0.0], [n / 10, 0.8]]
        assert stitcher.push(n / 10, ids, xy).tolist() == [1, 2]
    assert stitcher.joined == 10
