"""A picture of what a place taught: where people go from each square metre, and how many."""

import numpy as np
import pytest

from neurosym_jax.evaluation.intervals import half_interval
from neurosym_jax.models.place.change import BLOCK, ENOUGH, TWO_SIDED, Change
from neurosym_jax.models.place.flows import flows_of
from neurosym_jax.models.place.memory import KERNELS, empty_memory, remember
from neurosym_jax.plotting import plot_flows


def remembered(start, way, person):
    """A memory of people at `start [n, 2]` who went `way [n, 2]` in 12 steps."""
    count = len(start)
    moment = np.zeros((count, 6), np.float32)
    moment[:, :2] = start
    onward = np.linspace(0, 1, 13)[1:, None] * np.asarray(way)[:, None]
    onward = onward.astype(np.float32)
    error = np.full_like(onward, np.inf)
    people = np.asarray(person, np.int32)
    memory = empty_memory(200, 12)
    times = np.zeros(count, np.float32)
    return remember(KERNELS, memory, moment, onward, error, people, times)


def test_people_who_part_at_a_corner_are_told_by_direction():
    start = [[0.5, 0.5]] * 12
    way = [[4.0, 0.0]] * 6 + [[0.0, -3.0]] * 3 + [[0.1, 0.1]] * 2 + [[-4.0, 0.0]]
    flows = flows_of(remembered(start, way, range(12)), np.array([100.0, 0.0]))
    # The one who went back is less than 15 % of all.
    assert flows.people.tolist() == [6, 3, 2]
    assert flows.share == pytest.approx([6 / 12, 3 / 12, 2 / 12])
    assert flows.start == pytest.approx(np.array([[100.5, 0.5]] * 3))
    assert flows.way == pytest.approx(np.array([way[0], way[6], way[9]]), abs=1e-6)


def test_a_person_counts_once_and_two_tell_nothing():
    start = [[0.5, 0.5]] * 20 + [[9.5, 0.5]] * 2
    way = [[0.0, 2.0]] * 22
    flows = flows_of(remembered(start, way, [*range(4)] * 5 + [7, 8]), None)
    assert flows.people.tolist() == [4]
    assert len(flows_of(empty_memory(10, 12), None).start) == 0


def test_arrows_and_dots_are_drawn_where_people_are():
    start = [[0.5, 0.5]] * 4 + [[3.5, 1.5]] * 4
    way = [[4.0, 0.0]] * 4 + [[0.0, 0.0]] * 4
    flows = flows_of(remembered(start, way, range(8)), None)
    (axes,) = plot_flows(flows).axes
    assert len(axes.texts) == 1
    assert axes.texts[0].arrow_patch.get_alpha() == pytest.approx(0.5)
    assert axes.texts[0].xy == pytest.approx([1.3, 0.5])
    (dot,) = axes.lines
    assert dot.get_xydata()[0] == pytest.approx([3.5, 1.5])
    low, high = axes.get_xlim()
    assert low < 0.5
    assert high > 3.5


def test_intervals_hold_the_true_change():
    """Of 200 streams of 20 minutes whose blocks are as unlike as those of a recording."""
    held = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        change = Change()
        for block in range(21):
            network = rng.gamma(2.0, 10.0)
            ratio = rng.normal(0.9, 0.1)
            for step in range(5):
                time = BLOCK * block + 12.0 * step
                change = change.add(time, network / 5, ratio * network / 5)
        assert change.blocks == 20
        mean, half = change.interval()
        held += abs(mean + 0.1) < half
    assert 175 <= held <= 199


def test_an_interval_of_few_blocks_is_students():
    exact = half_interval(ENOUGH - 1)
    assert exact <= TWO_SIDED < 1.01 * exact


def test_few_blocks_tell_no_interval():
    change = Change()
    for block in range(10):
        change = change.add(BLOCK * block, 1.0, 0.9)
        assert change.interval() is None
    change = change.add(BLOCK * 10, 1.0, 0.9)
    assert change.interval() == pytest.approx((-0.1, 0.0))
