import dataclasses

import jax
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from neurosym_jax.data.batching import bucket_of, gather_scenes, make_batches, single_scene
from neurosym_jax.data.tracks import Reading
from neurosym_jax.data.windows import Windows
from neurosym_jax.scene import make_scene, pad_scene

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
        extras={"group": np.arange(1, agents + 1), "heading": rng.normal(size=(agents, 2))},
    )


def test_buckets():
    agents = np.array([1, 2, 4, 5, 8, 9, 17, 64, 65, 128, 129, 1000])
    assert bucket_of(agents).tolist() == [4, 4, 4, 8, 8, 16, 32, 64, 128, 128, 256, 1024]


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
            scene = make_scene(part.position[:, :3], part.position[:, 3:], extras=part.extras)
            alone = pad_scene(scene, bucket).replace(identity=windows.identity[number])
            in_batch = jax.tree.map(lambda array, row=row: array[row], batch.scene)
            assert in_batch.observed.dtype == alone.observed.dtype
            for other in (alone, single_scene(windows, number)):
                jax.tree.map(assert_array_equal, in_batch, other)


def test_a_selection_of_windows_forgets_nothing(windows):
    chosen = np.array([3, 0, 3])
    part = dataclasses.replace(windows, period=0.2, reading=(Reading("r"),)).take(chosen)
    assert (part.period, part.obs_len, part.reading) == (0.2, 3, (Reading("r"),))
    for here, there in zip(
        jax.tree.leaves(gather_scenes(windows, chosen, 4)),
        jax.tree.leaves(gather_scenes(part, np.arange(3), 4)),
        strict=True,
    ):
        assert_array_equal(here, there)
    assert_array_equal(part.agent, windows.agent[windows.rows(chosen)])
    assert_array_equal(windows.take(windows.sizes > 9).sizes, [70, 33, 16])
    assert windows.take(slice(2)).scenes == 2
