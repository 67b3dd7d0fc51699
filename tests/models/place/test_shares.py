"""Shares: bounds that hold for any stream, and what is learned from one."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neurosym_jax.models.place.shares import LOSS, RATE, experts, new_ledger, risk_of

KERNELS, STEPS = 2, 4


def forecasts(rng, people, near=1.0):
    """Points of the network and of two kernels, [C, n, P, d], as distances apart."""
    points = rng.normal(0, near, (1 + KERNELS, people, 5, 6))
    points += rng.normal(0, near, (1 + KERNELS, people, 1, 6))
    return points


def apart_of(points, filled):
    """[n, C, C] mean distances; a kernel has the network's points for the rest."""
    gaps = np.linalg.norm(
        points[:, None, :, :, None] - points[None, :, :, None], axis=-1
    )
    return blended(gaps.mean((-1, -2)).transpose(2, 0, 1), filled)


def blended(pure, filled):
    """What components are, by how much of each is recalled, [n, K]."""
    people, count = len(pure), 1 + KERNELS
    change = np.zeros((people, count, count))
    change[:, 0, 0] = 1
    for kernel in range(KERNELS):
        change[:, kernel + 1, 0] = 1 - filled[:, kernel]
        change[:, kernel + 1, kernel + 1] = filled[:, kernel]
    if pure.ndim == 2:
        return np.einsum("nij,nj->ni", change, pure)
    return np.einsum("nij,njk,nlk->nil", change, pure, change)


def error_of(points, truth, filled):
    """[n, C] mean distances from the truth `[n, d]`."""
    gap = np.linalg.norm(points - truth[None, :, None], axis=-1)
    return blended(gap.mean(-1).T, filled)


def worst_truth(points, shares, rng):
    """The truth, of many that are far and near, at which the mixture loses most."""
    people = points.shape[1]
    tried = [points[0].mean(1), points[0, :, 0]]
    for component in range(1, 1 + KERNELS):
        away = points[0].mean(1) - points[component].mean(1)
        tried += [points[0].mean(1) + scale * away for scale in (0.5, 2, 50)]
    tried += [rng.normal(0, 30, (people, 6))]
    tried = np.array(tried)
    alone = np.linalg.norm(points[0][None] - tried[:, :, None], axis=-1).mean(-1)
    far = np.linalg.norm(points[:, None] - tried[None, :, :, None], axis=-1).mean(-1)
    loss = np.einsum("c,ctn->tn", shares, far) - alone
    return tried[loss.argmax(0), np.arange(people)]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 6), st.sampled_from([0.1, 1.0, 10.0]))
def test_no_stream_costs_more_than_the_limit(seed, people, near):
    """An enemy who sees each forecast, and first lets the memory win, then lose."""
    rng = np.random.default_rng(seed)
    ledger = new_ledger(np.ones(KERNELS))
    awaited, excess, lowest, noon = [], 0.0, 0.0, rng.integers(0, 60)
    kept = rng.choice([1.0, 0.99, 0.5])  # What is forgotten changes no bound.
    for step in range(80):
        if len(awaited) == STEPS:
            points, filled, commitment, apart = awaited.pop(0)
            if step < noon:
                truth = points[1, :, 0]
            else:
                truth = worst_truth(points, commitment.shares, rng)
            ledger = ledger.release(commitment)
            seen = rng.uniform(size=people) < 0.9  # Some leave.
            error = error_of(points, truth, filled)[seen]
            ledger, scored = ledger.learn(commitment, error, apart[seen])
            excess += scored.used - scored.network
            lowest = min(lowest, excess)
            assert excess <= ledger.limit + 1e-9
            assert excess - lowest <= 2 * ledger.limit + 1e-9
            assert ledger.lost == pytest.approx(max(excess - lowest, 0))
        ledger = ledger.fade(kept)
        points = forecasts(rng, people, near)
        filled = rng.uniform(0, 1, (people, KERNELS))
        apart = apart_of(points, filled)
        ledger, commitment = ledger.commit(apart, filled)
        awaited.append((points, filled, commitment, apart))
    assert ledger.limit <= LOSS * STEPS * people * 20 * near
    assert ledger.reserved >= 0


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6))
def test_without_delay_the_regret_to_every_expert_is_bounded(seed):
    """Cesa-Bianchi and Lugosi, theorem 2.2, with a ledger that limits nothing."""
    rng = np.random.default_rng(seed)
    ledger = new_ledger(np.ones(KERNELS), loss=1e9)
    before = np.exp(ledger.log_weight)
    total, used, squares = np.zeros(len(before)), 0.0, 0.0
    for _ in range(60):
        points = forecasts(rng, 2)
        filled = np.ones((2, KERNELS))
        apart = apart_of(points, filled)
        ledger, commitment = ledger.commit(apart, filled)
        ledger = ledger.release(commitment)
        error = error_of(points, points[rng.integers(3), :, 0], filled)
        score = score_of(ledger, error, apart)
        ledger, scored = ledger.learn(commitment, error, apart)
        used += scored.used
        total += score
        squares += np.ptp(score) ** 2
    bound = np.log(1 / before) / RATE + RATE / 8 * squares
    assert np.all(used - total <= bound + 1e-9)


def score_of(ledger, error, apart):
    """[E] total energy scores of the experts."""
    rows = ledger.experts
    within = np.einsum("ncd,ec,ed->e", apart, rows, rows)
    return (error @ rows.T).sum(0) - within / 2


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10**6))
def test_no_truth_makes_a_score_exceed_its_risk(seed):
    rng = np.random.default_rng(seed)
    points = forecasts(rng, 3, rng.choice([0.1, 1, 10]))
    filled = rng.uniform(0, 1, (3, KERNELS))
    shares = rng.dirichlet(np.ones(1 + KERNELS))
    apart = apart_of(points, filled)
    risk = risk_of(shares, apart, filled)
    for truth in (
        worst_truth(points, shares, rng),
        points[0, :, 0],
        1e3 * points[2, :, 0],
    ):
        error = error_of(points, truth, filled)
        within = np.einsum("ncd,c,d->n", apart, shares, shares)
        mixed = error @ shares - within / 2
        alone = error[:, 0] - apart[:, 0, 0] / 2
        assert np.all(mixed - alone <= risk + 1e-6)


def test_nobody_who_is_like_nobody_takes_a_risk():
    rng = np.random.default_rng(0)
    filled = np.zeros((3, KERNELS))
    apart = apart_of(forecasts(rng, 3), filled)
    assert risk_of(np.array([0.2, 0.4, 0.4]), apart, filled) == pytest.approx(0)


@pytest.mark.parametrize("best", [0, 1, 2])
def test_weights_go_to_the_component_that_is_right(best):
    rng = np.random.default_rng(1)
    ledger = new_ledger(np.ones(KERNELS))
    for _ in range(150):
        points = forecasts(rng, 3, 0.3)
        filled = np.ones((3, KERNELS))
        apart = apart_of(points, filled)
        ledger, commitment = ledger.commit(apart, filled)
        ledger = ledger.release(commitment)
        truth = points[best, :, 0]
        error = error_of(points, truth, filled)
        ledger, _ = ledger.learn(commitment, error, apart)
    assert ledger.wanted.argmax() == best
    assert ledger.wanted[best] > 0.8


def test_scores_of_long_ago_count_for_less():
    ledger = new_ledger(np.ones(KERNELS))
    first = ledger.log_weight
    learned = dataclasses.replace(ledger, log_weight=first - np.arange(len(first)))
    assert learned.fade(1.0) is learned
    assert learned.fade(0.5).log_weight == pytest.approx(
        first - np.arange(len(first)) / 2
    )
    assert learned.fade(0.0).wanted == pytest.approx(ledger.wanted)


def test_experts_are_mixtures_and_the_first_is_the_network():
    rows = experts(3)
    assert rows[0].tolist() == [1, 0, 0, 0]
    assert rows.sum(1) == pytest.approx(1)
    assert rows.min() == 0
    assert len(np.unique(rows, axis=0)) == len(rows)
