"""Intervals and paired tests: how often they hold, on windows that share steps, and by hand."""

import numpy as np
import pytest
from scipy.stats import t

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.intervals import (
    Difference,
    ErrorsByScene,
    Estimate,
    against_best,
    holm,
    mean_difference,
    paired_difference,
    student_half,
    student_p,
)
from neurosym_jax.evaluation.scores import Score

WINDOW = 16


def scored(errors, people=None, metric="joint_ade"):
    """Errors of windows that start at consecutive frames."""
    people = np.ones(len(errors)) if people is None else people
    identity = np.stack([np.zeros(len(errors)), np.arange(len(errors))], axis=1).astype(
        np.uint32
    )
    return ErrorsByScene({metric: Score(errors * people, people)}, identity, WINDOW)


def window_means(draw, windows):
    """[windows] means of the sixteen skewed, independent step errors of each; true mean 1."""
    steps = draw.gamma(1.0, 1.0, windows + WINDOW - 1)
    return np.convolve(steps, np.full(WINDOW, 1 / WINDOW), "valid")


def crowd(draw, windows):
    """[windows] people, between which and their neighbours numbers change as unevenly as in univ
    (blocks' coefficient of variation .4), and the spread of errors with them."""
    span = 3 * WINDOW
    waves = np.convolve(
        draw.normal(size=windows + span - 1), np.full(span, span**-0.5), "valid"
    )
    return np.rint(12 * np.exp(0.45 * waves)).clip(1)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("blocks", [3, 5, 12])
def test_intervals_hold_and_equal_models_are_not_called_different(blocks, uneven):
    held, different, trials = 0, 0, 500
    for trial in range(trials):
        draw, windows = np.random.default_rng(trial), blocks * WINDOW
        people = crowd(draw, windows) if uneven else np.full(windows, 3.0)
        shared, spread = window_means(draw, windows), (people / people.mean()) ** 0.5
        runs = [
            scored(
                1 + spread * (shared - 1 + 0.3 * (window_means(draw, windows) - 1)),
                people,
            )
            for _ in range(2)
        ]
        low, high = runs[0].intervals()["joint_ade"]
        held += low <= 1 <= high
        low, high = paired_difference(runs[:1], runs[1:]).intervals("joint_ade")["both"]
        different += not low <= 0 <= high
    # Three standard errors of 500 trials around 95 %, of which at least 93 are
    # promised.
    assert 0.93 <= held / trials <= 0.98
    assert 0.02 <= different / trials <= 0.06


def test_two_blocks_say_nothing():
    errors = scored(np.linspace(0.2, 0.5, 2 * WINDOW))
    assert errors.intervals()["joint_ade"] == (-np.inf, np.inf)
    difference = paired_difference([errors], [scored(np.full(2 * WINDOW, 9.0))])
    assert difference.over_both.p_value(0) == 1
    # A third block that counts nobody does not help.
    people = np.repeat([1.0, 1.0, 0.0], WINDOW)
    errors = scored(np.arange(3.0 * WINDOW), people)
    assert errors.intervals()["joint_ade"] == (-np.inf, np.inf)
    # Windows of two recordings are in blocks of their own.
    identity = np.array([[0, 0], [1, 0], [2, 0]])
    errors = ErrorsByScene({"ade": Score(np.arange(3.0), np.ones(3))}, identity, WINDOW)
    assert np.isfinite(errors.intervals()["ade"]).all()


def test_the_interval_by_hand():
    """Leave each of four unequal blocks out, and count the blocks by their weights."""
    totals, counts = np.array([6.0, 2.0, 9.0, 3.0]), np.array([3.0, 2.0, 4.0, 1.0])
    identity = np.array([[7, 0], [7, 16], [7, 33], [9, 0]])
    low, high = ErrorsByScene(
        {"ade": Score(totals, counts)}, identity, WINDOW
    ).intervals()["ade"]
    without = [(20 - total) / (10 - count) for total, count in zip(totals, counts)]
    effective = 10**2 / (9 + 4 + 16 + 1)
    variance = 3 / 4 * np.square(2.0 - np.array(without)).sum()
    variance *= (3 * effective - 1) / (2 * effective - 1)
    half = t.ppf(0.975, 8 / 9 * (effective - 1)) * variance**0.5
    assert (low, high) == pytest.approx((2 - half, 2 + half))


def test_a_difference_of_several_metrics_is_each_ones_own():
    """Three metrics and two runs; the scenes' estimate is the mean over runs."""
    identity = np.stack([np.full(6, 1), WINDOW * np.arange(6)], axis=1)
    values = np.random.default_rng(0).uniform(1, 2, (2, 2, 3, 6))

    def errors(run):
        scores = {name: Score(total, np.ones(6)) for name, total in zip("abc", run)}
        return ErrorsByScene(scores, identity, WINDOW)

    ours, theirs = (list(map(errors, runs)) for runs in values)
    difference = paired_difference(ours, theirs)
    expected = (values[0] - values[1]).mean(axis=-1)
    np.testing.assert_allclose(difference.seeds, expected)
    np.testing.assert_allclose(difference.over_scenes.value, expected.mean(axis=0))


def runs(better_by=0.0, spread=0.0, seeds=3, noise=0.02):
    """(ours, theirs): the same 400 scenes, ours better by so many metres an agent."""
    draw = np.random.default_rng(0)
    agents = draw.integers(2, 6, 400).astype(float)
    hard = draw.uniform(0.2, 2.0, 400)
    worse = -better_by - spread * draw.normal(size=(seeds, 1))
    better = [
        scored(hard + draw.normal(0, noise, 400) + shift, agents) for shift in worse
    ]
    return better, [scored(hard, agents)] * seeds


def test_a_difference_is_per_agent_and_found_where_it_is():
    difference = paired_difference(*runs(better_by=0.05))
    assert difference.mean == pytest.approx(-0.05, abs=0.005)
    for low, high in difference.intervals("joint_ade").values():
        assert -0.06 < low < high < -0.04
    assert difference.over_both.p_value(0) < 1e-6
    # A single seed has the interval of the scenes.
    single = paired_difference(*runs(seeds=1)).intervals("joint_ade")
    assert (single["seeds"], single["both"]) == (None, single["scenes"])


def test_seeds_that_differ_widen_the_interval_as_student_says():
    difference = paired_difference(*runs(better_by=0.05, spread=0.1, noise=0.0))
    low, high = difference.intervals("joint_ade")["both"]
    half = 4.303 * difference.seeds[:, 0].std(ddof=1) / np.sqrt(3)
    assert (high - low) / 2 == pytest.approx(half, rel=0.01)
    assert difference.intervals("joint_ade")["seeds"] == pytest.approx(
        (low, high), rel=0.01
    )


def of_values(values, numbers=None):
    """A `Difference` of one metric with these seeds, and scenes that would all say the same."""
    seeds = np.asarray(values, float)[:, None]
    sure = Estimate(seeds.mean(axis=0), np.zeros(1), np.ones(1))
    return Difference(("joint_ade",), tuple(numbers or range(len(seeds))), seeds, sure)


def test_the_mean_over_test_sets_covers_although_equal_seeds_are_alike():
    """Models that are as good as each other: runs of a seed correlate by .9, as in sweeps."""
    draw, covered, repetitions = np.random.default_rng(4), 0, 400
    for _ in range(repetitions):
        shared, own = draw.normal(0, 0.9**0.5, 3), draw.normal(0, 0.1**0.5, (5, 3))
        mean = mean_difference([of_values(values) for values in 0.02 * (shared + own)])
        low, high = mean.intervals("joint_ade")["both"]
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


def test_variances_of_test_sets_add():
    """Two sets, each 3 +- 1 with 4 degrees of freedom: the mean has a variance of 1 / 2, and 8."""
    sure = Estimate(np.array([3.0]), np.ones(1), np.full(1, 4.0))
    part = Difference(("joint_ade",), (0,), np.full((1, 1), 3.0), sure)
    low, high = mean_difference([part, part]).intervals("joint_ade")["scenes"]
    half = t.ppf(0.975, 8) * 0.5**0.5
    assert (low, high) == pytest.approx((3 - half, 3 + half))


def test_students_interval_and_holm_by_hand():
    # Two degrees of freedom: 4.303.
    assert student_half([1.0, 2.0, 3.0]) == pytest.approx(
        4.302653 / np.sqrt(3), rel=1e-6
    )
    assert student_p([1.0, 2.0, 3.0]) == pytest.approx(2 * t.sf(2 * 3**0.5, 2))
    assert student_p([0.0, 0.0]) == 1
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.5]), [0.04, 0.09, 0.09, 0.5])
    assert holm([0.6, 0.9]).tolist() == [1, 1]


def test_others_are_compared_with_the_best():
    def p_value(best, other):
        return {(2, 0): 0.01, (2, 3): 0.04, (0, 2): 0.5, (0, 3): 0.6}[best, other]

    assert against_best([0.3, None, 0.2, 0.25], False, p_value) == [
        0.02,
        None,
        None,
        0.04,
    ]
    assert against_best([0.3, None, 0.2, 0.25], True, p_value) == [None, None, 1, 1]
    assert against_best([0.3, 0.2], None, p_value) == [None, None]
    assert against_best([0.3], False, p_value) == [None]
