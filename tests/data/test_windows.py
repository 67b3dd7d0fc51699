import dataclasses
import time
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from neurosym_jax.data.formats import read_any
from neurosym_jax.data.readers.eth_ucy import SCENES, read_split
from neurosym_jax.data.tracks import SNAP, Tracks, make_tracks, on_grid, resample
from neurosym_jax.data.windows import cut_windows
from neurosym_jax.errors import InputError

# Scenes and agents of SGAN's test splits, by (scene, pred_len); obs_len is 8.
COUNTS = {
    ("eth", 8): (195, 614),
    ("eth", 12): (70, 181),
    ("hotel", 8): (443, 1714),
    ("hotel", 12): (301, 1053),
    ("univ", 8): (955, 27349),
    ("univ", 12): (947, 24334),
    ("zara1", 8): (702, 2875),
    ("zara1", 12): (602, 2253),
    ("zara2", 8): (956, 6622),
    ("zara2", 12): (921, 5833),
}


def windows_by_loop(tracks: Tracks, length: int, skip: int, min_agents: int):
    """SGAN's windows, written as its loader loops over them: (start, agents, positions)."""
    seen: dict[float, dict[int, np.ndarray]] = {}
    for stamp, agent, position in zip(tracks.stamp, tracks.id, tracks.position):
        seen.setdefault(float(stamp), {})[int(agent)] = position
    stamps = sorted(seen)
    scenes = []
    for start in range(0, len(stamps) - length + 1, skip):
        frames = [seen[stamp] for stamp in stamps[start : start + length]]
        if stamps[start + length - 1] - stamps[start] > 0.4 * (length - 0.5):
            continue  # SGAN's loader goes on across a gap in time.
        agents = [agent for agent in sorted(frames[0]) if all(agent in frame for frame in frames)]
        if len(agents) >= min_agents:
            rows = [[frame[agent] for frame in frames] for agent in agents]
            scenes.append((start, agents, np.array(rows)))
    return scenes


@st.composite
def recordings(draw) -> Tracks:
    """Agents that come, go and are lost; stamps at which nobody is seen do not exist."""
    agents = draw(st.integers(1, 5))
    frames = draw(st.integers(1, 16))
    flat = draw(st.lists(st.booleans(), min_size=agents * frames, max_size=agents * frames))
    present = np.array(flat).reshape(agents, frames)
    present[draw(st.integers(0, agents - 1)), draw(st.integers(0, frames - 1))] = True
    # Mostly present, so that whole windows are common.
    present |= np.random.default_rng(draw(st.integers(0, 99))).random(present.shape) < 0.7
    agent, frame = np.nonzero(present)
    ids = np.array(draw(st.permutations(range(10, 10 + agents))))
    position = np.stack([100.0 * agent + frame, -1.0 * frame], axis=1)
    tracks = make_tracks("r", frame * 0.4, ids[agent], position)
    return dataclasses.replace(tracks, period=0.4)


@given(
    st.lists(recordings(), min_size=1, max_size=2),
    st.integers(1, 3),
    st.integers(1, 3),
    st.integers(1, 3),
    st.integers(1, 3),
)
def test_equal_to_a_loop(parts, obs_len, pred_len, skip, min_agents):
    length = obs_len + pred_len
    wanted = [
        scene for tracks in parts for scene in windows_by_loop(tracks, length, skip, min_agents)
    ]
    if not wanted:
        with pytest.raises(InputError):
            cut_windows(parts, obs_len, pred_len, skip=skip, min_agents=min_agents)
        return
    windows = cut_windows(parts, obs_len, pred_len, skip=skip, min_agents=min_agents)
    assert windows.scenes == len(wanted)
    assert windows.agents == sum(len(agents) for _, agents, _ in wanted)
    assert windows.obs_len == obs_len
    for index, (start, agents, position) in enumerate(wanted):
        part = slice(*windows.bounds[index : index + 2])
        assert_array_equal(windows.agent[part], agents)
        assert_array_equal(windows.position[part], position)
        assert_array_equal(windows.identity[index], [zlib.crc32(b"r"), start])


@pytest.mark.parametrize("scene", sorted({scene for scene, _ in COUNTS}))
def test_counts_of_the_benchmark(shared, scene):
    recordings = read_split(shared / "data/eth_ucy", scene, "test")
    for pred_len in (8, 12):
        windows = cut_windows(recordings, 8, pred_len)
        assert (windows.scenes, windows.agents) == COUNTS[scene, pred_len]
        assert windows.sizes.min() >= 2


def test_counts_of_a_training_split(shared):
    recordings = read_split(shared / "data/eth_ucy", "zara1", "train")
    windows = cut_windows(recordings, 8, 8)
    assert (windows.scenes, windows.agents) == (2692, 32686)


@pytest.mark.filterwarnings("ignore:.*needs --eth-stride 6")
def test_no_published_window_is_lost_to_a_gap(shared):
    """Over all files of ETH/UCY and both horizons, as SGAN's loader cuts them, gaps or none."""
    recordings = [read_any(path)[0] for path in (shared / "data/eth_ucy").glob("*/*.txt")]
    careless = sum(
        len(windows_by_loop(dataclasses.replace(tracks, stamp=step * 0.4), 8 + pred_len, 1, 2))
        for tracks in recordings
        for step in [np.unique(tracks.stamp, return_inverse=True)[1]]
        for pred_len in (8, 12)
    )
    cut = [cut_windows(map(on_grid, recordings), 8, pred_len) for pred_len in (8, 12)]
    assert careless == sum(windows.scenes for windows in cut) == 15_382
    gaps = {found.recording: found.gaps for found in cut[0].reading}
    assert gaps["biwi_eth"] > 10
    assert gaps["crowds_zara01"] == 3
    assert gaps["students003"] == 0


def test_windows_do_not_cross_gaps():
    """Ten steps, a pause of an hour, ten more: as many windows as both parts have alone."""
    steps = walk(10, 2)
    whole = make_tracks(
        "pause",
        np.concatenate([steps.stamp, steps.stamp + 3600]),
        np.concatenate([steps.id, steps.id]),
        np.concatenate([steps.position, steps.position]),
    )
    windows = cut_windows([whole], 4, 4)
    assert windows.scenes == 2 * cut_windows([steps], 4, 4).scenes
    (found,) = windows.reading
    assert (found.recording, found.rows, found.gaps) == ("pause", 40, 1)


def test_steps_longer_than_what_is_filled_are_refused():
    """Data of 2 s steps has no steps of 0.4 s, and is not silently used as if it had."""
    sparse = dataclasses.replace(walk(40, 2, "sparse"), stamp=walk(40, 2).stamp * 5)
    with pytest.raises(InputError, match="sparse: no 16 consecutive steps"):
        cut_windows([on_grid(sparse, 0.4)], 8, 8)
    assert cut_windows([on_grid(sparse, 2.0)], 8, 8).period == 2.0


def test_the_whole_benchmark_is_read_and_cut_in_time(shared):
    start = time.process_time()
    for scene in SCENES:
        for split in ("train", "val", "test"):
            cut_windows(read_split(shared / "data/eth_ucy", scene, split), 8, 8)
    assert time.process_time() - start < 1.5


def walk(frames: int, agents: int, name: str = "walk") -> Tracks:
    frame, agent = np.mgrid[:frames, :agents].reshape(2, -1)
    return make_tracks(name, frame * 0.4, agent, np.stack([frame, agent], axis=1))


def test_refused():
    stamp = np.cumsum(np.linspace(0.3, 0.5, 40))
    free = make_tracks("free", stamp, np.ones(40, int), np.zeros((40, 2)))
    slow = dataclasses.replace(walk(20, 2), stamp=walk(20, 2).stamp * 2)
    for recordings, message in (
        ([], "no recordings"),
        ([walk(15, 3, "short")], "short: no 16 consecutive steps .* has 15"),
        ([walk(40, 1, "lonely")], "lonely: no 16 consecutive steps have at least 2 people"),
        ([free], "free: its stamps are on no one grid: use data.on_grid"),
        ([walk(20, 2), slow], r"steps of 0\.4 to 0\.8 s: choose one"),
    ):
        with pytest.raises(InputError, match=message):
            cut_windows(recordings, 8, 8)


def test_one_agent_where_asked():
    assert cut_windows([walk(20, 1)], 8, 8, min_agents=1).scenes == 5


@given(
    seed=st.integers(0, 999),
    step=st.floats(0.05, 0.7),
    jitter=st.floats(0, 0.3),
    lost=st.floats(0, 0.3),
    line=st.integers(3, 20),
)
def test_what_is_observed_knows_nothing_of_the_future(seed, step, jitter, lost, line):
    """Whatever happens after the last observed step, bit for bit; clocks are the agents' own."""
    rng = np.random.default_rng(seed)
    stamp = [rng.uniform(0, 0.4) + np.cumsum(step + jitter * rng.random(60)) for _ in range(3)]
    ids = np.repeat(np.arange(3), 60)
    stamp, position = np.concatenate(stamp), rng.normal(size=(180, 2)).cumsum(axis=0)
    kept = rng.random(180) >= lost
    stamp, ids, position = stamp[kept], ids[kept], position[kept]
    moment = stamp.min() + 0.4 * line
    other = np.where((stamp > moment + SNAP)[:, None], rng.normal(size=position.shape), position)

    def observed(points):
        try:
            grid = resample(make_tracks("r", stamp, ids, points), 0.4)
            windows = cut_windows([grid], 4, 3)
        except InputError:
            return None
        scene = np.repeat(windows.identity[:, 1], windows.sizes)
        early = np.unique(grid.stamp)[scene + 3] <= moment + SNAP
        return windows, early, np.stack([scene, windows.agent], 1)

    found, changed = observed(position), observed(other)
    if found is None or changed is None:
        assert found is changed
        return
    (before, early, which), (after, _, same) = found, changed
    assert_array_equal(which, same)
    assert_array_equal(before.position[early, :4], after.position[early, :4])


def test_what_is_foreseen():
    """At 0.4 s a walker was last seen at 0.3 s, at 1 m/s; he then turned round."""
    stamp = [0, 0.1, 0.3, 0.5, 0.9]
    walk = make_tracks("r", stamp, [1] * 5, np.stack([[0, 0.1, 0.3, 0.1, 0.1], [0] * 5], 1))
    windows = cut_windows([resample(walk, 0.4)], 2, 1, min_agents=1)
    np.testing.assert_allclose(windows.position[0, :, 0], [0, 0.4, 0.1], atol=1e-12)
    # As a step of the future the same point lies between what was seen before and after it.
    windows = cut_windows([resample(walk, 0.4)], 1, 2, min_agents=1)
    np.testing.assert_allclose(windows.position[0, :, 0], [0, 0.2, 0.1], atol=1e-12)


def test_nobody_is_foreseen_across_a_gap_or_from_one_point():
    tracks = make_tracks(
        "r", [0.1, 2.1, 2.5, 2.7], [1] * 4, np.array([[9.0, 9], [1, 1], [2, 1], [2, 1]])
    )
    grid = resample(tracks, 0.4, start=0.0)
    assert_array_equal(grid.stamp.round(9), [2.4])
    assert_array_equal(grid.foreseen, [[1, 1]])
    assert_array_equal(grid.known, [2.5])


def test_extras_of_all_recordings_or_of_none():
    one, other = (
        make_tracks(name, np.arange(4) * 0.4, [1] * 4, np.zeros((4, 2)), extras)
        for name, extras in (("one", {"group": [1, 2, 3, 4]}), ("other", {}))
    )
    windows = cut_windows([one, one], 2, 1, min_agents=1)
    assert windows.extras["group"].tolist() == [2, 3, 2, 3], "at the last observed step"
    with pytest.raises(InputError, match="one, other: their extras differ"):
        cut_windows([one, other], 2, 1, min_agents=1)
