import dataclasses
import time
import zlib

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from neurosym_jax.data.recordings import open_source
from neurosym_jax.data.tracks import SNAP, Reading, Tracks, make_tracks, resample
from neurosym_jax.data.windows import (
    Windows,
    bucket_of,
    cut_windows,
    gather_scenes,
    make_batches,
    single_scene,
)
from neurosym_jax.errors import InputError
from neurosym_jax.scene import make_scene, pad_scene

# Scenes and agents of SGAN's test splits of 8 + 8 and 8 + 12 steps.
COUNTS = {
    "eth": ((195, 614), (70, 181)),
    "hotel": ((443, 1714), (301, 1053)),
    "univ": ((955, 27349), (947, 24334)),
    "zara1": ((702, 2875), (602, 2253)),
    "zara2": ((956, 6622), (921, 5833)),
}


def windows_by_loop(tracks: Tracks, length: int, skip: int, min_agents: int):
    """SGAN's windows, written as its loader loops over them: (start, agents, positions)."""
    seen: dict[float, dict[int, np.ndarray]] = {}
    for stamp, agent, position in zip(tracks.stamp, tracks.id, tracks.position):
        seen.setdefault(float(stamp), {})[int(agent)] = position
    stamps = sorted(seen)
    for start in range(0, len(stamps) - length + 1, skip):
        frames = [seen[stamp] for stamp in stamps[start : start + length]]
        if stamps[start + length - 1] - stamps[start] > 0.4 * (length - 0.5):
            continue  # SGAN's loader goes on across a gap in time.
        agents = sorted(set(frames[0]).intersection(*frames))
        if len(agents) >= min_agents:
            steps = [[frame[agent] for agent in agents] for frame in frames]
            yield start, agents, np.array(steps).swapaxes(0, 1)


@st.composite
def recordings(draw) -> Tracks:
    """Agents that come, go and are lost; stamps at which nobody is seen do not exist."""
    agents, frames = draw(st.integers(1, 5)), draw(st.integers(1, 16))
    rng = np.random.default_rng(draw(st.integers(0, 999)))
    present = rng.random((agents, frames)) < draw(st.sampled_from([0.7, 0.9, 1.0]))
    present[-1, -1] = True
    agent, frame = np.nonzero(present)
    position = np.stack([100.0 * agent + frame, -1.0 * frame], axis=1)
    tracks = make_tracks(
        "r", frame * 0.4, rng.permutation(agents)[agent] + 10, position
    )
    return dataclasses.replace(tracks, period=0.4)


@given(
    st.lists(recordings(), min_size=1, max_size=2), st.tuples(*[st.integers(1, 3)] * 4)
)
def test_equal_to_a_loop(parts, numbers):
    obs_len, pred_len, skip, min_agents = numbers
    options = {"skip": skip, "min_agents": min_agents}
    expected = []
    for tracks in parts:
        expected += windows_by_loop(tracks, obs_len + pred_len, **options)
    if not expected:
        with pytest.raises(InputError):
            cut_windows(parts, obs_len, pred_len, **options)
        return
    windows = cut_windows(parts, obs_len, pred_len, **options)
    assert windows.scenes == len(expected)
    assert windows.agents == sum(len(agents) for _, agents, _ in expected)
    assert windows.obs_len == obs_len
    for index, (start, agents, position) in enumerate(expected):
        part = slice(*windows.bounds[index : index + 2])
        assert_array_equal(windows.agent[part], agents)
        assert_array_equal(windows.position[part], position)
        assert_array_equal(windows.identity[index], [zlib.crc32(b"r"), start])


def test_counts_of_the_benchmark(shared):
    source, seconds = open_source(shared / "data/eth_ucy"), 0.0
    for scene, counts in COUNTS.items():
        recordings, training = (
            source.recordings(scene),
            source.recordings(scene, "train"),
        )
        start = time.process_time()
        for pred_len, count in zip((8, 12), counts):
            windows = cut_windows(recordings, 8, pred_len)
            assert (windows.scenes, windows.agents) == count
            assert windows.sizes.min() >= 2
        windows = cut_windows(training, 8, 8)
        assert scene != "zara1" or (windows.scenes, windows.agents) == (2692, 32686)
        seconds += time.process_time() - start
    assert seconds < 1.5


def walk(frames: int, agents: int, name: str = "walk") -> Tracks:
    frame, agent = np.mgrid[:frames, :agents].reshape(2, -1)
    return make_tracks(name, frame * 0.4, agent, np.stack([frame, agent], axis=1))


def test_refused():
    stamp = np.cumsum(np.linspace(0.3, 0.5, 40))
    free = make_tracks("free", stamp, np.ones(40, int), np.zeros((40, 2)))
    slow = dataclasses.replace(walk(20, 2), stamp=walk(20, 2).stamp * 2)
    for recordings, message in (
        ([], "no recordings"),
        (
            [walk(9, 2, "shorter"), walk(15, 3, "short")],
            "short: no 16 consecutive steps .* more than 15; evaluate and train take shorter",
        ),
        (
            [walk(40, 1, "lonely")],
            "lonely: no 16 consecutive steps have at least 2 people throughout: some people",
        ),
        ([free], "free: its stamps are on no one grid: use data.on_grid"),
        ([walk(20, 2), slow], r"steps of 0\.4 to 0\.8 s: choose one"),
    ):
        with pytest.raises(InputError, match=message):
            cut_windows(recordings, 8, 8)
    for name, wrong in (
        ("obs_len", 0),
        ("pred_len", -3),
        ("skip", 0),
        ("min_agents", 0),
    ):
        with pytest.raises(InputError, match=f"{name} must be at least 1"):
            cut_windows([walk(40, 2)], **{"obs_len": 8, "pred_len": 8, name: wrong})


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
    stamp = [
        rng.uniform(0, 0.4) + np.cumsum(step + jitter * rng.random(60))
        for _ in range(3)
    ]
    ids = np.repeat(np.arange(3), 60)
    stamp, position = np.concatenate(stamp), rng.normal(size=(180, 2)).cumsum(axis=0)
    is_present = rng.random(180) >= lost
    stamp, ids, position = stamp[is_present], ids[is_present], position[is_present]
    moment = stamp.min() + 0.4 * line
    other = np.where(
        (stamp > moment + SNAP)[:, None], rng.normal(size=position.shape), position
    )

    def observed(points):
        try:
            grid = resample(make_tracks("r", stamp, ids, points), 0.4)
            windows = cut_windows([grid], 4, 3)
        except InputError:
            return None
        scene = np.repeat(windows.identity[:, 1], windows.sizes)
        early = np.unique(grid.stamp)[scene + 3] <= moment + SNAP
        return windows, early, np.stack([scene, windows.agent], 1)

    result, changed = observed(position), observed(other)
    if result is None or changed is None:
        assert result is changed
        return
    (before, early, agents), (after, _, same) = result, changed
    assert_array_equal(agents, same)
    assert_array_equal(before.position[early, :4], after.position[early, :4])


def test_what_is_foreseen():
    """At 0.4 s a walker was last seen at 0.3 s, at 1 m/s; he then turned round."""
    stamp = [0, 0.1, 0.3, 0.5, 0.9]
    walk = make_tracks(
        "r", stamp, [1] * 5, np.stack([[0, 0.1, 0.3, 0.1, 0.1], [0] * 5], 1)
    )
    windows = cut_windows([resample(walk, 0.4, start=0)], 2, 1, min_agents=1)
    np.testing.assert_allclose(windows.position[0, :, 0], [0, 0.4, 0.1], atol=1e-12)
    # As a step of the future the same point lies between what was seen before and after
    # it.
    windows = cut_windows([resample(walk, 0.4, start=0)], 1, 2, min_agents=1)
    np.testing.assert_allclose(windows.position[0, :, 0], [0, 0.2, 0.1], atol=1e-12)


def test_extras_of_all_recordings_or_of_none():
    first, other = (
        make_tracks(name, np.arange(5) * 0.4, [1] * 5, np.zeros((5, 2)), extras)
        for name, extras in (("one", {"group": [1, 2, 3, 4, 5]}), ("other", {}))
    )
    windows = cut_windows([first, first], 2, 1, min_agents=1)
    assert windows.extras["group"].tolist() == [2, 3, 4] * 2, (
        "at the last observed step"
    )
    with pytest.raises(InputError, match="one, other: their extras differ"):
        cut_windows([first, other], 2, 1, min_agents=1)


SIZES = (1, 4, 5, 2, 70, 9, 4, 33, 16)


@pytest.fixture(scope="module")
def windows() -> Windows:
    rng = np.random.default_rng(0)
    agents = sum(SIZES)
    return Windows(
        position=rng.normal(size=(agents, 7, 2)).cumsum(axis=1) + np.array([4e5, 5e6]),
        agent=np.arange(agents),
        bounds=np.cumsum([0, *SIZES]),
        identity=rng.integers(2**32, size=(len(SIZES), 2), dtype=np.uint32),
        obs_len=3,
        extras={
            "group": np.arange(1, agents + 1),
            "heading": rng.normal(size=(agents, 2)),
        },
    )


def test_buckets():
    agents = np.array([1, 2, 4, 5, 8, 9, 17, 64, 65, 128, 129, 1024, 1025, 2049])
    expected = [4, 4, 4, 8, 8, 16, 32, 64, 128, 128, 256, 1024, 2048, 3072]
    assert bucket_of(agents).tolist() == expected


@pytest.mark.parametrize("slots", [1, 16, 256])
def test_every_scene_is_in_one_batch_as_it_is_alone(windows, slots):
    batches = make_batches(windows, slots)
    index = np.concatenate([batch.index for batch in batches])
    assert sorted(index[index >= 0]) == list(range(len(SIZES)))
    for batch in batches:
        scenes, bucket = batch.scene.valid.shape
        assert len(batch.index) == scenes
        assert scenes * bucket <= max(slots, bucket)
        for row, number in enumerate(batch.index):
            if number < 0:
                assert not batch.scene.valid[row].any()
                continue
            part = windows.take(np.array([number]))
            scene = make_scene(
                part.position[:, :3], part.position[:, 3:], extras=part.extras
            )
            alone = pad_scene(scene, bucket).replace(identity=windows.identity[number])
            in_batch = jax.tree.map(lambda array, row=row: array[row], batch.scene)
            assert in_batch.observed.dtype == alone.observed.dtype
            for other in (alone, single_scene(windows, number)):
                jax.tree.map(assert_array_equal, in_batch, other)


def test_a_selection_of_windows_forgets_nothing(windows):
    chosen = np.array([3, 0, 3])
    part = dataclasses.replace(windows, period=0.2, reading=(Reading("r"),)).take(
        chosen
    )
    assert (part.period, part.obs_len, part.reading) == (0.2, 3, (Reading("r"),))
    for leaf, other in zip(
        jax.tree.leaves(gather_scenes(windows, chosen, 4)),
        jax.tree.leaves(gather_scenes(part, np.arange(3), 4)),
        strict=True,
    ):
        assert_array_equal(leaf, other)
    assert_array_equal(part.agent, windows.agent[windows.rows(chosen)])
    assert_array_equal(windows.take(windows.sizes > 9).sizes, [70, 33, 16])
    assert windows.take(slice(2)).scenes == 2
