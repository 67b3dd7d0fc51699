import dataclasses

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

METRICS = ("joint_ade", "joint_fde", "marginal_ade", "marginal_fde")


def runs(better_by=0.0, spread=0.0, seeds=3, scenes=400, seed=0, noise=0.02):
    """(ours, theirs): the same test set, ours better by so many metres an agent."""
    draw = np.random.default_rng(seed)
    agents = draw.integers(2, 6, scenes).astype(float)
    hard = draw.uniform(0.2, 2.0, (scenes, 1)) * agents[:, None]
    identity = np.stack([np.zeros(scenes), np.arange(scenes)], axis=1).astype(np.uint32)
    ours, theirs = [], []
    for shift in draw.normal(0, spread, seeds) if spread else np.zeros(seeds):
        own = draw.normal(0, noise, (scenes, 4)) * agents[:, None]
        theirs.append(errors(hard * np.ones(4), agents, identity))
        better = (better_by + shift) * agents[:, None]
        ours.append(errors(hard - better + own, agents, identity))
    return ours, theirs


def errors(totals, agents, identity):
    scores = {name: Score(total, agents) for name, total in zip(METRICS, totals.T)}
    return ErrorsByScene(scores, identity, 16)


def test_a_difference_is_per_agent_and_found_where_it_is():
    difference = paired_difference(*runs(better_by=0.05))
    np.testing.assert_allclose(difference.mean, -0.05, atol=0.005)
    for metric in METRICS:
        for low, high in filter(None, difference.intervals(metric).values()):
            assert -0.06 < low < high < -0.04


def test_seeds_that_differ_widen_the_interval_as_student_says():
    difference = paired_difference(*runs(better_by=0.05, spread=0.1, noise=0.0))
    low, high = difference.intervals("joint_ade")["both"]
    of_seeds = difference.seeds[:, 0]
    half = 4.303 * of_seeds.std(ddof=1) / np.sqrt(3)
    assert (high - low) / 2 == pytest.approx(half, rel=0.15)
    least, most = difference.intervals("joint_ade")["seeds"]
    assert most - least < (high - low) / 2.5


def test_windows_that_share_steps_are_drawn_together():
    """An error that lasts for sixteen windows is one observation and not sixteen."""
    ours, theirs = runs(noise=0.0, seeds=1)
    lasting = np.repeat(np.random.default_rng(1).normal(0, 0.05, 25), 16)
    scores = ours[0].scores
    scores = {name: Score(of.total + lasting * of.count, of.count) for name, of in scores.items()}
    ours = [dataclasses.replace(ours[0], scores=scores)]
    low, high = paired_difference(ours, theirs).intervals("joint_ade")["scenes"]
    assert (high - low) / 2 == pytest.approx(1.96 * 0.05 / np.sqrt(25), rel=0.35)
    of_one = paired_difference(ours, theirs).intervals("joint_ade")
    assert (of_one["seeds"], of_one["both"]) == (None, of_one["scenes"])


@pytest.mark.parametrize("better_by", [0.0, 0.03])
def test_intervals_hold_what_they_promise(better_by):
    """Of 60 repetitions with three seeds the 95 % intervals cover the truth nearly always."""
    covered = 0
    for repetition in range(60):
        given = runs(better_by, spread=0.02, seed=repetition, scenes=160)
        low, high = paired_difference(*given, seed=repetition).intervals("joint_ade")["both"]
        covered += low <= -better_by <= high
    assert covered >= 53


def runs_of_seeds(draw, seeds=3, sets=5):
    """[sets, seeds] differences of a model that is as good as the other: those of a seed correlate
    by .9 over test sets, as they do in sweeps."""
    shared = draw.normal(0, np.sqrt(0.9), seeds)
    return 0.02 * (shared + draw.normal(0, np.sqrt(0.1), (sets, seeds)))


def of_values(values, numbers=None):
    """A `Difference` of one metric with these seeds, and scenes that would all say the same."""
    seeds = np.asarray(values, float)[:, None]
    scenes = np.full((4000, 1), seeds.mean())
    return Difference(("joint_ade",), tuple(numbers or range(len(seeds))), seeds, scenes)


def test_the_mean_over_test_sets_covers_although_equal_seeds_are_alike():
    draw = np.random.default_rng(4)
    covered, repetitions = 0, 400
    for repetition in range(repetitions):
        parts = [of_values(values) for values in runs_of_seeds(draw)]
        mean = mean_difference(parts)
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


def test_students_interval_and_holm_by_hand():
    # Two degrees of freedom: 4.303.
    assert student_half([1.0, 2.0, 3.0]) == pytest.approx(4.302653 / np.sqrt(3), rel=1e-6)
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.5]), [0.04, 0.09, 0.09, 0.5])
    assert holm([0.6, 0.9]).tolist() == [1, 1]
