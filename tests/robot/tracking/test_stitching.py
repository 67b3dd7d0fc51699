"""People found again behind occlusions: IDF1 on simulated recordings, and what must not happen."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.commands._running import run_command
from neurosym_jax.data.formats import read_any
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.simulation.scenarios import TrackerFaults, simulate_labelled
from neurosym_robot.commands import stitch as command
from neurosym_robot.tracking.following import (
    CROWD,
    FORGET,
    Follower,
    NearestIds,
    frames_of_tracks,
)
from neurosym_robot.tracking.stitching import (
    NOBODY,
    LinkOptions,
    OnlineStitcher,
    stitch,
    stitched_ids,
)
from studies.stitching.scoring import idf1

FAULTS = TrackerFaults(dropout=0.005, dropout_seconds=1.0, id_switch=1.0)


def live(tracks, stitcher: OnlineStitcher | None = None) -> np.ndarray:
    """[R] ids given frame by frame."""
    stitcher, given = stitcher or OnlineStitcher(), np.zeros(len(tracks.id), int)
    order = np.lexsort((tracks.id, tracks.stamp))
    given[order] = np.concatenate([stitcher.push(*frame) for frame in frames_of_tracks(tracks)])
    return given


def both_ways(tracks) -> list[np.ndarray]:
    """Ids offline and live."""
    return [stitched_ids(tracks)[0], live(tracks)]


def people(ids: np.ndarray) -> set[int]:
    return set(ids.tolist()) - {NOBODY}


def broken(gap: float = 1.0, then: int = 7):
    """A walk along x at 1 m/s at 10 Hz for 4 s, lost for `gap` and found as `then`."""
    stamp = np.concatenate([np.arange(20) / 10, 1.9 + gap + np.arange(20) / 10])
    return make_tracks("r", stamp, np.repeat([3, then], 20), np.stack([stamp, stamp * 0], 1))


@pytest.mark.parametrize(("count", "offline", "online"), [(2, 0.98, 0.97), (8, 0.97, 0.94)])
def test_ids_follow_people(count, offline, online):
    scores = []
    for seed in range(3):
        tracks, person = simulate_labelled("cross-path", seed, 60.0, count, FAULTS)
        given = [tracks.id, *both_ways(tracks)]
        scores.append([idf1(person, np.where(each == NOBODY, -1, each)) for each in given])
    raw, joined, lived = np.mean(scores, axis=0)
    assert raw < 0.6
    assert joined > offline
    assert lived > online


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
    given = live(broken())
    # Whether somebody new is a ghost is waited for, live.
    assert people(given) == {3}
    assert (given == NOBODY).sum() <= 6
    assert_array_equal(live(broken(), OnlineStitcher(LinkOptions(least=0.0))), 3)


def test_far_or_late_or_at_the_same_time_is_somebody_else():
    options = LinkOptions(max_gap=2.0)
    assert stitch(broken(gap=2.5), options).joined == 0
    assert people(live(broken(gap=2.5), OnlineStitcher(options))) == {3, 7}
    far = broken()
    far.position[far.id == 7, 1] += 4
    assert stitch(far).joined == 0
    both = make_tracks("r", [0, 1, 0, 1], [1, 1, 2, 2], [[0, 0], [0, 0], [5, 0], [5, 0]])
    assert stitch(both).joined == 0


def test_ids_that_are_swapped_where_ways_cross_are_put_right():
    t = np.arange(60) / 10
    along, across = np.stack([t, 0 * t], 1), np.stack([0 * t + 3.05, t - 2.6], 1)
    ids = np.where(t < 2.9, 1, 2)
    tracks = make_tracks(
        "r", np.tile(t, 2), np.append(ids, 3 - ids), np.concatenate([along, across])
    )
    for given in both_ways(tracks):
        for xy in (along, across):
            of = [np.flatnonzero((tracks.position == place).all(axis=1))[0] for place in xy]
            assert len(people(given[of])) == 1


def test_who_leaves_is_not_who_enters_by_that_door():
    t = np.arange(80) / 10
    x = 1.3 * np.concatenate([t[:30], 3.0 - (t[50:] - 5.0)])
    stamp, ids = np.concatenate([t[:30], t[50:]]), np.repeat([1, 2], 30)
    for given in both_ways(make_tracks("r", stamp, ids, np.stack([x, 0 * x], 1))):
        assert people(given) == {1, 2}


def test_ghosts_and_sentinels_are_nobody():
    t = np.arange(60) / 10
    stamp = np.concatenate([t, [2.0, 2.1], t[30:45]])
    ids = np.concatenate([np.full(60, 1), [8, 8], np.full(15, 9)])
    walk = np.stack([t, 0 * t], 1)
    xy = np.concatenate([walk, [[0, 4], [0, 4.1]], np.full((15, 2), -3000.0)])
    tracks = make_tracks("r", stamp, ids, xy)
    for given in both_ways(tracks):
        assert (given[tracks.id != 1] == NOBODY).all()
        assert people(given[tracks.id == 1]) == {1}
    assert stitch(tracks).ghosts == 17
    with pytest.raises(InputError, match="nobody is seen for 1 s"):
        stitch(tracks.take(tracks.id != 1))


def test_newcomers_are_published_at_once_or_where_a_tracker_has_ghosts_after_a_second():
    stitcher = OnlineStitcher()
    for n in range(20):  # People who come one after the other, twenty metres apart.
        ids = [stitcher.push(3 * n + t / 10, [n], [[20.0 * n, t / 10]]).item() for t in range(20)]
        assert ids[-1] == n
        assert (ids[0] == n) == (n == 0 or n >= 10), n  # The first is there from the start.
    stitcher = OnlineStitcher()
    for n in range(20):  # Each is seen twice.
        assert (stitcher.push(n, [n], [[20.0 * n, 0.0]]).item() == NOBODY) == (n > 0)
        assert n == 0 or stitcher.push(n + 0.1, [n], [[20.0 * n, 0.0]]).item() == NOBODY
    ids = [stitcher.push(30 + t / 10, [99], [[0.0, t / 10]]).item() for t in range(15)]
    assert ids == [NOBODY] * 10 + [99] * 5


def test_a_newcomer_goes_on_at_once_unless_others_were_new():
    found = broken()  # 0.5 of the distance allowed from where it is expected
    found.position[found.id == 7, 1] += 0.7
    assert_array_equal(live(found), 3)
    stamp = np.append(found.stamp, 0.5 + np.arange(30) / 10)  # Another enters meanwhile.
    xy = np.append(found.position, np.stack([50 + stamp[40:], 0 * stamp[40:]], 1), 0)
    tracks = make_tracks("r", stamp, np.append(found.id, np.full(30, 5)), xy)
    given = live(tracks)[tracks.id == 7]
    assert given[0] == NOBODY
    assert (given[3:] == 3).all()


def test_a_jump_is_somebody_new():
    t = np.arange(80) / 10
    xy = np.stack([np.where(t < 4, t, t + 10), 0 * t], 1)
    for given in both_ways(make_tracks("r", t, np.full(80, 5), xy)):
        before, after = people(given[:40]), people(given[40:])
        assert before == {5}
        assert len(after) == 1
        assert not after & before


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
        nearest, true, given = NearestIds(), [], []
        for frame in frames_of_tracks(simulate_labelled(scenario, 1, 40.0, 4)[0]):
            order = rng.permutation(len(frame.ids))
            given.extend(nearest.push(frame.stamp, frame.xy[order]))
            true.extend(frame.ids[order])
        assert idf1(true, given) > 0.97
    nearest = NearestIds()
    (one,) = nearest.push(0.0, [[0.0, 0.0]])
    assert nearest.push(FORGET, [[0.0, 0.0]]) == [one]
    assert nearest.push(2 * FORGET + 0.1, [[0.0, 0.0]]) != [one]
    for n in range(5):
        ids = nearest.push(3 + n / 10, rng.uniform(0, 1000, (3000, 2)) * [[1.0, np.nan]])
        assert len(np.unique(ids)) == 3000
        ids = nearest.push(3.05 + n / 10, rng.uniform(0, 1000, (3000, 2)))
    assert len(nearest._follower.tracks) <= CROWD
    assert len(nearest.push(np.nan, [[0.0, 0.0]])) == 1


@pytest.mark.parametrize(
    ("frames", "wanted"),
    [  # (seconds, ids, x): the last people's tracks, numbered in the order of their start
        pytest.param([(0, [1], [0]), (1, [1], [1]), (2, [9], [2])], [0], id="speed of two points"),
        pytest.param([(0, [1], [0]), (1, [1, 1], [0, 0.1])], [0, 1], id="one id twice"),
        pytest.param([(0, [1], [0]), (0.8, [1, 9], [50, 0])], [1, 2], id="lost, and its id jumps"),
        pytest.param([(0, [1], [0]), (0.1, [1], [1.5]), (1.1, [1], [16.8])], [1], id="too fast"),
        pytest.param(
            [(0, [1, 2], [0, 1.2]), (0.1, [1, 2], [0, 1.2]), (0.4, [1, 2], [0.5, -0.7])],
            [0, 1],
            id="an id is worth 0.2 m",
        ),
    ],
)
def test_tracks_from_frame_to_frame(frames, wanted):
    follower, known = Follower(60.0, 9, recent=1.0 if wanted == [0] else 0.5), {}
    for stamp, ids, x in frames:
        tracks = follower.push(stamp, ids, np.stack([np.array(x, float), np.zeros(len(x))], axis=1))
        found = [known.setdefault(id(track), len(known)) for track in tracks]
    assert found == wanted
