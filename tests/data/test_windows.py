import time
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from neurosym_jax.data.eth_ucy import read_split
from neurosym_jax.data.tracks import Tracks, make_tracks
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
    return make_tracks("r", frame * 0.4, ids[agent], position)


@settings(max_examples=150, deadline=None)
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


def test_the_largest_split_is_cut_fast(shared):
    recordings = read_split(shared / "data/eth_ucy", "univ", "test")
    seconds = []
    for _ in range(3):
        start = time.process_time()
        cut_windows(recordings, 8, 12)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 0.4


def walk(frames: int, agents: int, name: str = "walk") -> Tracks:
    frame, agent = np.mgrid[:frames, :agents].reshape(2, -1)
    return make_tracks(name, frame * 0.4, agent, np.stack([frame, agent], axis=1))


def test_too_few_frames():
    with pytest.raises(InputError, match="short: too few frames: 15 where a window needs 16"):
        cut_windows([walk(15, 3, "short")], 8, 8)


def test_nobody_stays():
    with pytest.raises(InputError, match="lonely: no 16 consecutive frames have at least 2 people"):
        cut_windows([walk(40, 1, "lonely")], 8, 8)


def test_no_recordings():
    with pytest.raises(InputError, match="no recordings"):
        cut_windows([], 8, 8)


def test_one_agent_where_asked():
    assert cut_windows([walk(20, 1)], 8, 8, min_agents=1).scenes == 5
