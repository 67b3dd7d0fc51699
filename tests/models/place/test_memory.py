"""Moments: who is found, what is kept, and what nothing changes."""

import jax
import numpy as np
import pytest

from neurosym_jax.models.place.memory import (
    CELL,
    COMPONENTS,
    ENOUGH,
    KERNELS,
    POINTS,
    empty_memory,
    features,
    forget,
    recall,
    remember,
)

STEPS = 4
NAMES = list(COMPONENTS)
RIGHT, UP = np.array([1.2, 0.0]), np.array([0.0, 1.2])


def moments(position, velocity, count=1):
    """[n, 6] the same moment `count` times."""
    row = np.concatenate([position, velocity, velocity])
    return np.tile(row, (count, 1)).astype(np.float32)


def after(memory, moment, onward, people, time=0.0, error=np.inf):
    """A memory with further moments; `onward [2]` is where all of them ended.

    Every forecast was wrong by `error`; of an infinite one, there was none.
    """
    count = len(moment)
    way = np.broadcast_to(onward, (count, 2))[:, None] * np.linspace(0.25, 1, STEPS)[
        :, None
    ].astype(np.float32)
    stamps = np.full(count, time, np.float32)
    numbers = np.asarray(people, np.int32)
    wrong = np.full_like(way, error)
    return remember(KERNELS, memory, moment, way, wrong, numbers, stamps)


def weights(memory, moment):
    """Total weight by kernel of what is recalled for one moment."""
    return dict(
        zip(NAMES, np.asarray(recall(KERNELS, memory, moment).weight[0].sum(1)))
    )


def test_nothing_is_recalled_of_an_empty_memory():
    found = recall(KERNELS, empty_memory(100, STEPS), moments([0, 0], RIGHT))
    # As many ways on that are turned, as many errors, and as many points halfway.
    assert found.onward.shape == (1, 4 * POINTS, STEPS, 2)
    parts = [0.0] * (2 * POINTS) + [1.0] * POINTS + [0.5] * POINTS
    assert found.mean_part.tolist() == parts
    assert not np.any(found.weight)


@pytest.mark.slow
def test_what_people_did_from_here_is_found_among_thousands():
    rng = np.random.default_rng(0)
    memory = empty_memory(10_000, STEPS)
    for batch in range(16):
        others = np.concatenate(
            [rng.uniform(-40, 40, (512, 2)), rng.normal(0, 1, (512, 4))], axis=1
        ).astype(np.float32)
        memory = after(memory, others, [0, 0], batch * 512 + np.arange(512))
    memory = after(memory, moments([5, 5], RIGHT, 12), [3, 1], 100_000 + np.arange(12))
    found = recall(KERNELS, memory, moments([5.1, 5], RIGHT))
    near = np.asarray(found.weight[0, NAMES.index("near")])
    end = near @ np.asarray(found.onward[0, :, -1])
    assert near.sum() == pytest.approx(1)
    assert end == pytest.approx([3, 1], abs=0.3)


def test_kernels_differ_in_place_and_velocity():
    memory = empty_memory(100, STEPS)
    memory = after(memory, moments([0, 0], RIGHT, ENOUGH), [1, 0], np.arange(ENOUGH))
    here = weights(memory, moments([0, 0], RIGHT))
    elsewhere = weights(memory, moments([500, 0], RIGHT))
    back = weights(memory, moments([0, 0], -RIGHT))
    faster = weights(memory, moments([0, 0], 2 * RIGHT))
    one = pytest.approx(1)
    # Of these people there was no forecast that could be wrong.
    nothing = dict.fromkeys(NAMES, 0)
    found = {"near": one, "around": one, "manner": one, "gait": one}
    assert here == nothing | found | {"halfway near": one}
    assert elsewhere == nothing | {"manner": one, "gait": one}
    assert back == nothing | {"gait": one}
    assert faster == nothing


def test_errors_of_forecasts_are_recalled_where_they_were_made():
    memory = empty_memory(100, STEPS)
    few = ENOUGH // 2
    here = moments([0, 0], RIGHT, few)
    memory = after(memory, here, [1, 0], np.arange(few), error=0.25)
    # Of others there was no forecast, and so no error.
    memory = after(memory, here, [1, 0], few + np.arange(few))
    found = recall(KERNELS, memory, moments([0.1, 0], RIGHT))
    for name in ("errors near", "errors around"):
        weight = np.asarray(found.weight[0, NAMES.index(name)])
        assert weight.sum() == pytest.approx(0.5)
        assert (found.mean_part[weight > 0] == 1).all()
        assert (np.asarray(found.onward[0])[weight > 0] == 0.25).all()
    is_error = np.asarray(found.mean_part) == 1
    assert not np.asarray(found.weight[0, : len(KERNELS), is_error]).any()
    elsewhere = weights(memory, moments([50, 0], RIGHT))
    assert elsewhere["errors near"] == elsewhere["errors around"] == 0


def test_halfway_are_the_ways_with_half_of_what_the_network_expects():
    memory = empty_memory(100, STEPS)
    here = moments([0, 0], RIGHT, ENOUGH)
    memory = after(memory, here, [1, 0], np.arange(ENOUGH))
    found = recall(KERNELS, memory, moments([0.1, 0], RIGHT))
    weight = np.asarray(found.weight[0, NAMES.index("halfway near")])
    assert weight.sum() == pytest.approx(1)
    expected = np.broadcast_to([3.0, 2.0], (1, STEPS, 2))
    ways = np.asarray(found.ways(expected)[0])[weight > 0]
    near = np.asarray(found.weight[0, NAMES.index("near")])
    alike = np.asarray(found.onward[0])[near > 0]
    assert ways == pytest.approx((alike + expected) / 2)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5, -1.9])
def test_a_gait_is_turned_to_the_own_way_and_told_in_a_mirror(angle):
    """Who walks along x and turns left by a metre may turn left or right elsewhere."""
    memory = empty_memory(100, STEPS)
    memory = after(memory, moments([0, 0], RIGHT, ENOUGH), [2, 1], np.arange(ENOUGH))
    ahead = np.array([np.cos(angle), np.sin(angle)])
    found = recall(KERNELS, memory, moments([70, -30], 1.2 * ahead))
    weight = np.asarray(found.weight[0, NAMES.index("gait")])
    end = np.asarray(found.onward[0, :, -1])[weight > 0]
    left = np.array([-ahead[1], ahead[0]])
    assert sorted(end @ left) == pytest.approx([-1] * ENOUGH + [1] * ENOUGH, abs=1e-5)
    assert end @ ahead == pytest.approx(2, abs=1e-5)


def test_a_gait_knows_to_which_side_somebody_turned_before():
    memory = empty_memory(100, STEPS)
    turning = np.array([[0, 0, 1.2, 0, 1.2, 0.3]], np.float32)
    turning = np.repeat(turning, ENOUGH, axis=0)
    memory = after(memory, turning, [2, 1], np.arange(ENOUGH))
    # Along y, and to the other side of it before.
    other_side = np.array([[9, 9, 0, 1.2, 0.3, 1.2]], np.float32)
    found = recall(KERNELS, memory, other_side)
    gait = np.asarray(found.weight[0, NAMES.index("gait")])
    x, y = gait @ np.asarray(found.onward[0, :, -1])
    assert x > 0.5
    assert y > 1


def test_of_who_stands_a_gait_tells_all_directions_that_were_gone():
    memory = empty_memory(100, STEPS)
    memory = after(memory, moments([0, 0], [0, 0], ENOUGH), [2, 1], np.arange(ENOUGH))
    found = recall(KERNELS, memory, moments([70, -30], [0, 0]))
    assert np.isfinite(found.onward).all()
    weight = np.asarray(found.weight[0, NAMES.index("gait")])
    length = np.linalg.norm(found.onward[0, :, -1], axis=-1)
    assert length[weight > 0] == pytest.approx(np.sqrt(5), abs=1e-5)


def test_somebody_counts_once_and_few_people_count_in_part():
    memory = empty_memory(100, STEPS)
    rows = moments([0, 0], [0, 0], 3 * CELL)
    rows[:, 0] = np.linspace(-2, 2, len(rows))
    memory = after(memory, rows, [0, 0], np.zeros(len(rows)))
    found = recall(KERNELS, memory, moments([0, 0], [0, 0]))
    # In a mirror once more.
    weight = np.asarray(found.weight[0, : len(KERNELS)])
    assert (weight > 0).sum(1).tolist() == [1, 1, 1, 2]
    share = weight.sum(1)
    assert share == pytest.approx(np.array([1, 1, 1, 2]) / ENOUGH)


def test_who_stands_for_an_hour_takes_one_row_and_pushes_nobody_out():
    memory = empty_memory(100, STEPS)
    memory = after(memory, moments([0, 0], UP, 3), [0, 1], [1, 2, 3])
    for _ in range(10):
        memory = after(memory, moments([0, 0], [0, 0], 50), [0, 0], np.full(50, 4))
    assert (memory.person >= 0).sum() == 4
    assert weights(memory, moments([0, 0], UP))["near"] == pytest.approx(3 / ENOUGH)


def test_the_memory_is_bounded_and_keeps_the_latest():
    memory = empty_memory(64, STEPS)
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(memory))
    rng = np.random.default_rng(1)
    for batch in range(20):
        rows = np.concatenate(
            [rng.uniform(-90, 90, (16, 2)), np.tile([*UP, *UP], (16, 1))], axis=1
        ).astype(np.float32)
        memory = after(memory, rows, [0, 1], 16 * batch + np.arange(16))
    assert sum(leaf.nbytes for leaf in jax.tree.leaves(memory)) == size
    assert sorted(np.asarray(memory.person)) == list(range(256, 320))
    assert weights(memory, rows[-1:])["near"] > 0


def test_a_hundred_thousand_moments_take_less_than_fifty_megabytes():
    memory = jax.eval_shape(lambda: empty_memory(100_000, 12))
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(memory))
    assert size < 25e6


def test_padding_is_not_remembered():
    memory = after(empty_memory(10, STEPS), moments([0, 0], UP, 4), [0, 1], [-1] * 4)
    assert not (memory.person >= 0).any()
    assert memory.next == 0
    assert not memory.turn.any()


def test_forgotten_moments_are_not_found_and_younger_ones_are():
    memory = empty_memory(100, STEPS)
    memory = after(memory, moments([0, 0], UP, 8), [0, 1], np.arange(8), time=10.0)
    memory = after(memory, moments([9, 9], UP, 8), [0, 1], 8 + np.arange(8), time=20.0)
    memory = forget(memory, np.float32(15.0))
    assert weights(memory, moments([0, 0], UP))["near"] == 0
    assert weights(memory, moments([9, 9], UP))["near"] == pytest.approx(1)


def test_velocities_are_of_three_steps_and_of_the_three_before():
    track = np.cumsum([[0, 0], *[[0, 0.4]] * 3, *[[0.8, 0]] * 3], axis=0)[None]
    assert features(track, 0.4)[0] == pytest.approx([2.4, 1.2, 2, 0, 0, 1])
    # A short track has one velocity.
    assert features(track[:, -4:], 0.4)[0] == pytest.approx([2.4, 1.2, 2, 0, 2, 0])
