import numpy as np
import pytest

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.bootstrap import (
    Difference,
    ErrorsByScene,
    holm,
    mean_difference,
    paired_difference,
    student_half,
)
from neurosym_jax.evaluation.scoring import Score


def runs(better_by=0.0, spread=0.0, seeds=3, noise=0.02):
    """(ours, theirs): the same 400 scenes, ours better by so many metres an agent."""
    draw = np.random.default_rng(0)
    agents = draw.integers(2, 6, 400).astype(float)
    hard = draw.uniform(0.2, 2.0, 400) * agents
    identity = np.stack([np.zeros(400), np.arange(400)], axis=1).astype(np.uint32)

    def errors(totals):
        return ErrorsByScene({"joint_ade": Score(totals, agents)}, identity, 16)

    worse = -better_by - spread * draw.normal(size=(seeds, 1))
    ours = [errors(hard + (draw.normal(0, noise, 400) + each) * agents) for each in worse]
    return ours, [errors(hard)] * seeds


def test_a_difference_is_per_agent_and_found_where_it_is():
    difference = paired_difference(*runs(better_by=0.05))
    assert difference.mean == pytest.approx(-0.05, abs=0.005)
    for low, high in filter(None, difference.intervals("joint_ade").values()):
        assert -0.06 < low < high < -0.04
    again = paired_difference(*runs(better_by=0.05), seed=0)
    np.testing.assert_array_equal(again.over_scenes, difference.over_scenes)
    # A single seed has the interval of the scenes.
    of_one = paired_difference(*runs(seeds=1)).intervals("joint_ade")
    assert (of_one["seeds"], of_one["both"]) == (None, of_one["scenes"])


def test_seeds_that_differ_widen_the_interval_as_student_says():
    difference = paired_difference(*runs(better_by=0.05, spread=0.1, noise=0.0))
    low, high = difference.intervals("joint_ade")["both"]
    half = 4.303 * difference.seeds[:, 0].std(ddof=1) / np.sqrt(3)
    assert (high - low) / 2 == pytest.approx(half, rel=0.15)
    least, most = difference.intervals("joint_ade")["seeds"]
    assert most - least < (high - low) / 2.5
    assert of_values([0, 1]).intervals("joint_ade")["seeds"] == (0, 1)


def test_intervals_are_wide_enough_where_windows_share_steps():
    """Errors of steps are independent, and a window's is the mean of its sixteen steps."""
    draw, starts, halves = np.random.default_rng(3), 40 * 16, []
    identity = np.stack([np.zeros(starts), np.arange(starts)], axis=1).astype(np.uint32)
    for _ in range(100):
        windows = np.convolve(draw.normal(size=starts + 15), np.full(16, 1 / 16), "valid")
        score = Score(windows, np.ones(starts))
        low, high = ErrorsByScene({"joint_ade": score}, identity, 16).intervals()["joint_ade"]
        halves.append((high - low) / 2)
    # Single blocks, whose borders windows cross, reach .77 of this; single windows .24.
    assert 0.93 < np.mean(halves) / (1.96 / np.sqrt(starts)) < 1


def of_values(values, numbers=None):
    """A `Difference` of one metric with these seeds, and scenes that would all say the same."""
    seeds = np.asarray(values, float)[:, None]
    scenes = np.full((4000, 1), seeds.mean())
    return Difference(("joint_ade",), tuple(numbers or range(len(seeds))), seeds, scenes)


def test_the_mean_over_test_sets_covers_although_equal_seeds_are_alike():
    """Models that are as good as each other: runs of a seed correlate by .9, as in sweeps."""
    draw, covered, repetitions = np.random.default_rng(4), 0, 400
    for repetition in range(repetitions):
        shared, own = draw.normal(0, 0.9**0.5, 3), draw.normal(0, 0.1**0.5, (5, 3))
        mean = mean_difference([of_values(values) for values in 0.02 * (shared + own)])
        low, high = mean.intervals("joint_ade", repetition)["both"]
        covered += low <= 0 <= high
    assert 0.92 < covered / repetitions < 0.98


def test_the_mean_is_of_the_seeds_that_every_test_set_has():
    parts = [of_values([1, 2, 9], (0, 1, 2)), of_values([5, 3, 4], (3, 1, 0))]
    mean = mean_difference(parts)
    assert mean.numbers == (0, 1)
    assert mean.seeds[:, 0].tolist() == [2.5, 2.5]
    assert mean.intervals("joint_ade")["both"] == pytest.approx((2.5, 2.5))
    with pytest.raises(InputError, match="no training seed"):
        mean_difference([of_values([1], (0,)), of_values([1], (1,))])


def test_where_nothing_was_counted_the_mean_is_0():
    """No agent has a neighbour in one of two blocks, and some draws are of that block alone."""
    identity = np.array([[0, 0], [0, 16]], np.uint32)
    score = Score(np.array([3.0, 0.0]), np.array([2, 0]))
    errors = ErrorsByScene({"neighbour_move": score}, identity, 16)
    assert errors.intervals() == {"neighbour_move": (0, 1.5)}


def test_students_interval_and_holm_by_hand():
    # Two degrees of freedom: 4.303.
    assert student_half([1.0, 2.0, 3.0]) == pytest.approx(4.302653 / np.sqrt(3), rel=1e-6)
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.5]), [0.04, 0.09, 0.09, 0.5])
    assert holm([0.6, 0.9]).tolist() == [1, 1]
