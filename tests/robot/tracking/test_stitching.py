"""People found again behind occlusions: IDF1 on simulated recordings, and what must not happen."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from neurosym_jax.commands._running import run_command
from neurosym_jax.data.readers.eth_ucy import read_text
from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.simulation.scenarios import simulate_labelled
from neurosym_jax.simulation.tracker import TrackerFaults
from neurosym_robot.commands import stitch as stitch_verb
from neurosym_robot.commands.stitch import Options, write_text
from neurosym_robot.tracking.identity import idf1
from neurosym_robot.tracking.linking import LinkOptions
from neurosym_robot.tracking.live import NOBODY, OnlineStitcher
from neurosym_robot.tracking.stitching import inside, stitch, stitched_ids

FAULTS = TrackerFaults(dropout=0.005, dropout_seconds=1.0, id_switch=1.0)


def live(tracks, stitcher: OnlineStitcher) -> np.ndarray:
    """[R] ids given frame by frame."""
    given = np.zeros(len(tracks.id), int)
    order = np.argsort(tracks.stamp, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(tracks.stamp[order])) + 1):
        given[rows] = stitcher.push(tracks.stamp[rows[0]], tracks.id[rows], tracks.position[rows])
    return given


def broken(gap: float = 1.0, then: int = 7):
    """A walk along x at 1 m/s at 10 Hz for 4 s, lost for `gap` and found as `then`."""
    stamp = np.concatenate([np.arange(20) / 10, 1.9 + gap + np.arange(20) / 10])
    return make_tracks("r", stamp, np.repeat([3, then], 20), np.stack([stamp, stamp * 0], 1))


@pytest.mark.parametrize(
    ("people", "offline", "online"), [(2, 0.98, 0.97), (4, 0.97, 0.96), (8, 0.97, 0.94)]
)
def test_ids_follow_people(people, offline, online):
    scores = []
    for seed in range(3):
        tracks, person = simulate_labelled("cross-path", seed, 60.0, people, FAULTS)
        given = [tracks.id, stitched_ids(tracks)[0], live(tracks, OnlineStitcher())]
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
    with pytest.raises(InputError):
        idf1([-1], [-1])
    with pytest.raises(InputError):
        idf1([1], [1, 2])


def test_a_broken_track_is_joined_and_filled():
    mended = stitch(broken())
    assert [(j.old, j.new) for j in mended.joins] == [(3, 7)]
    tracks = mended.tracks
    assert mended.filled == len(tracks.id) - len(broken().id) == 9
    assert set(tracks.id.tolist()) == {3}
    assert_allclose(tracks.position[:, 0], tracks.stamp, atol=1e-9)
    assert_allclose(np.diff(tracks.stamp), 0.1, atol=1e-9)
    assert stitch(broken(), fill=0.5).filled == 0
    given = live(broken(), OnlineStitcher())
    # Whether somebody new is a ghost is waited for, live.
    assert set(given.tolist()) - {NOBODY} == {3}
    assert (given == NOBODY).sum() <= 6
    assert_array_equal(live(broken(), OnlineStitcher(LinkOptions(least=0.0))), 3)


def test_far_or_late_or_at_the_same_time_is_somebody_else():
    options = LinkOptions(max_gap=2.0)
    assert stitch(broken(gap=2.5), options).joins == []
    assert set(live(broken(gap=2.5), OnlineStitcher(options)).tolist()) == {3, 7, NOBODY}
    far = broken()
    far.position[far.id == 7, 1] += 4
    assert stitch(far).joins == []
    both = make_tracks("r", [0, 1, 0, 1], [1, 1, 2, 2], [[0, 0], [0, 0], [5, 0], [5, 0]])
    assert stitch(both).joins == []


def test_a_manual_map_overrides():
    assert set(stitch(broken(), ids={7: 50}).tracks.id) == {3, 50}
    assert set(stitch(broken(gap=9.0), ids={7: 3}).tracks.id) == {3}
    both = make_tracks("r", [0, 1, 0, 1], [1, 1, 2, 2], np.zeros((4, 2)))
    with pytest.raises(InputError, match="seen"):
        stitch(both, ids={1: 2})


def test_points_outside_the_map_are_dropped():
    mended = stitch(broken(), polygon=[[-1, -1], [1.55, -1], [1.55, 1], [-1, 1]])
    assert (mended.outside, mended.tracks.position[:, 0].max() <= 1.5) == (24, True)
    with pytest.raises(InputError, match="inside"):
        stitch(broken(), polygon=[[9, 9], [10, 9], [9, 10]])
    with pytest.raises(InputError, match="corners"):
        inside(np.zeros((1, 2)), [[0, 0], [1, 1]])


def test_random_live_streams_never_crash_and_stay_bounded():
    rng = np.random.default_rng(0)
    stitcher = OnlineStitcher(forget=10.0, max_tracks=30)
    for n in range(300):
        count = 10_000 if n % 100 == 5 else rng.integers(0, 20)
        stamp = rng.choice([n / 10, n / 10, np.nan, -np.inf, n / 10 - 100])
        xy = rng.normal(0, 5, (count, 2))
        xy[rng.random(count) < 0.1] = np.nan
        assert len(stitcher.push(stamp, rng.integers(0, 50 + n, count), xy)) == count
        assert len(stitcher._follower.tracks) <= 30


def people(stamps, *ways) -> tuple:
    """Tracks of people by (id of each stamp, position of each stamp)."""
    count = len(ways)
    return make_tracks(
        "r",
        np.tile(stamps, count),
        np.concatenate([np.broadcast_to(ids, len(stamps)) for ids, _ in ways]),
        np.concatenate([xy for _, xy in ways]),
    )


def both_ways(tracks) -> list[np.ndarray]:
    """Ids offline and live."""
    return [stitched_ids(tracks)[0], live(tracks, OnlineStitcher())]


def test_ids_that_are_swapped_where_ways_cross_are_put_right():
    t = np.arange(60) / 10
    along, across = np.stack([t, 0 * t], 1), np.stack([0 * t + 3.05, t - 2.6], 1)
    ids = np.where(t < 2.9, 1, 2)
    tracks = people(t, (ids, along), (3 - ids, across))
    for given in both_ways(tracks):
        for xy in (along, across):
            of = [np.flatnonzero((tracks.position == place).all(axis=1))[0] for place in xy]
            assert len(set(given[of].tolist()) - {NOBODY}) == 1


def test_who_leaves_is_not_who_enters_by_that_door():
    t = np.arange(80) / 10
    x = 1.3 * np.concatenate([t[:30], 3.0 - (t[50:] - 5.0)])
    stamp, ids = np.concatenate([t[:30], t[50:]]), np.repeat([1, 2], 30)
    tracks = make_tracks("r", stamp, ids, np.stack([x, 0 * x], 1))
    for given in both_ways(tracks):
        assert set(given.tolist()) - {NOBODY} == {1, 2}


def test_ghosts_and_sentinels_are_nobody():
    t = np.arange(60) / 10
    walk = np.stack([t, 0 * t], 1)
    stamp = np.concatenate([t, [2.0, 2.1], t[30:45]])
    ids = np.concatenate([np.full(60, 1), [8, 8], np.full(15, 9)])
    xy = np.concatenate([walk, [[0, 4], [0, 4.1]], np.full((15, 2), -3000.0)])
    tracks = make_tracks("r", stamp, ids, xy)
    for given in both_ways(tracks):
        assert (given[tracks.id != 1] == NOBODY).all()
        assert set(given[tracks.id == 1].tolist()) - {NOBODY} == {1}
    assert stitch(tracks).ghosts == 17


def test_a_tracker_without_ghosts_has_its_newcomers_published_at_once():
    stitcher = OnlineStitcher()
    for n in range(20):  # People who come one after the other, twenty metres apart.
        ids = [stitcher.push(3 * n + t / 10, [n], [[20.0 * n, t / 10]]).item() for t in range(20)]
        assert ids[-1] == n
        assert (ids[0] == n) == (n >= 10), n


def test_a_jump_is_somebody_new():
    t = np.arange(80) / 10
    xy = np.stack([np.where(t < 4, t, t + 10), 0 * t], 1)
    for given in both_ways(make_tracks("r", t, np.full(80, 5), xy)):
        before, after = set(given[:40].tolist()) - {NOBODY}, set(given[40:].tolist()) - {NOBODY}
        assert before == {5}
        assert len(after) == 1
        assert not after & before


def verb(arguments: list[str]) -> None:
    run_command(Options, stitch_verb.run, arguments)


def test_the_verb(tmp_path, capsys):
    source, out, ids = tmp_path / "in.txt", tmp_path / "out.txt", tmp_path / "ids.json"
    write_text(source, broken(), 0.1)
    ids.write_text('{"99": 1}')
    with pytest.raises(SystemExit) as done:
        verb([str(source), "--out", str(out), "--report", "--ids", str(ids)])
    assert done.value.code == 0
    assert "7 goes on as 3 after 1.0 s" in capsys.readouterr().out
    tracks = read_text(out, period=0.1)
    assert_allclose(tracks.stamp, stitch(broken()).tracks.stamp, atol=1e-9)
    ids.write_text("[1]")
    other = str(tmp_path / "other.txt")
    for arguments in ([str(out)], [other, "--ids", str(ids)], [other, "--polygon", str(ids)]):
        with pytest.raises(SystemExit) as done:
            verb([str(source), "--out", *arguments])
        assert done.value.code == 2
