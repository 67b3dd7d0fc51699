"""Shares: bounds that hold for any stream, and what is learned from one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neurosym_jax.models.place.mixture import energy
from neurosym_jax.models.place.shares import (
    ALONE,
    LOSS,
    RATE,
    WALKS,
    best_mixture,
    new_ledger,
    pace_of,
    risk_of,
)

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
    loss = np.einsum("nc,ctn->tn", shares, far) - alone
    return tried[loss.argmax(0), np.arange(people)]


@pytest.mark.slow
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
            points, filled, pace, commitment, apart = awaited.pop(0)
            if step < noon:
                truth = points[1, :, 0]
            else:
                truth = worst_truth(points, commitment.shares[pace], rng)
            ledger = ledger.release(commitment)
            seen = rng.uniform(size=people) < 0.9  # Some leave.
            error = error_of(points, truth, filled)[seen]
            ledger, scored = ledger.learn(commitment, error, apart[seen], pace[seen])
            excess += scored.used - scored.network
            lowest = min(lowest, excess)
            assert excess <= ledger.limit + 1e-9
            assert excess - lowest <= 2 * ledger.limit + 1e-9
            assert ledger.lost == pytest.approx(max(excess - lowest, 0))
        ledger = ledger.fade(kept)
        points = forecasts(rng, people, near)
        filled = rng.uniform(0, 1, (people, KERNELS))
        apart = apart_of(points, filled)
        pace = rng.integers(0, 2, people)
        ledger, commitment = ledger.commit(apart, filled, pace)
        awaited.append((points, filled, pace, commitment, apart))
    assert ledger.limit <= LOSS * STEPS * people * 20 * near
    assert ledger.reserved >= 0


@pytest.mark.slow
@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6))
def test_without_delay_the_regret_to_every_mixture_is_bounded(seed):
    """Shalev-Shwartz, theorem 2.11, with a ledger that limits nothing."""
    rng = np.random.default_rng(seed)
    ledger = new_ledger(np.ones(KERNELS), loss=1e9)
    first, walk = ledger.first, np.ones(2, int)
    mixtures = np.concatenate([np.eye(3), rng.dirichlet(np.ones(3), 20)])
    total, used, squares = np.zeros(len(mixtures)), 0.0, 0.0
    for _ in range(60):
        points = forecasts(rng, 2)
        filled = np.ones((2, KERNELS))
        apart = apart_of(points, filled)
        ledger, commitment = ledger.commit(apart, filled, walk)
        ledger = ledger.release(commitment)
        error = error_of(points, points[rng.integers(3), :, 0], filled)
        total += [
            energy(np.tile(shares, (2, 1)), error, apart).sum() for shares in mixtures
        ]
        slope = (error - apart @ commitment.shares[1]).sum(axis=0)
        ledger, scored = ledger.learn(commitment, error, apart, walk)
        used += scored.used
        squares += (np.ptp(slope) / 2) ** 2
    ratio = np.where(mixtures > 0, mixtures / first, 1)
    divergence = (mixtures * np.log(ratio)).sum(axis=1)
    assert np.all(used - total <= divergence / RATE + RATE * squares + 1e-3)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 300))
def test_no_other_mixture_has_a_lower_total(seed, people):
    rng = np.random.default_rng(seed)
    points, filled = forecasts(rng, people), np.ones((people, KERNELS))
    apart = apart_of(points, filled).sum(0, keepdims=True)
    error = error_of(points, points[1, :, 0], filled).sum(0, keepdims=True)
    first = np.array([0.5, 0.3, 0.2])

    def total(shares):
        divergence = (shares * np.log(shares / first)).sum(axis=1)
        return energy(shares, error, apart) + divergence / RATE

    shares = best_mixture(error, apart, first, first[None])
    assert shares.sum() == pytest.approx(1)
    others = rng.dirichlet(np.ones(3), 50)
    for near in (1.0, 0.1, 0.01):
        for tried in (1 - near) * shares + near * others:
            assert total(shares)[0] <= total(tried[None])[0] + 1e-3 * people


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10**6))
def test_no_truth_makes_a_score_exceed_its_risk(seed):
    rng = np.random.default_rng(seed)
    points = forecasts(rng, 3, rng.choice([0.1, 1, 10]))
    filled = rng.uniform(0, 1, (3, KERNELS))
    shares = rng.dirichlet(np.ones(1 + KERNELS), 3)
    apart = apart_of(points, filled)
    risk = risk_of(shares, apart, filled)
    for truth in (
        worst_truth(points, shares, rng),
        points[0, :, 0],
        1e3 * points[2, :, 0],
    ):
        error = error_of(points, truth, filled)
        mixed = energy(shares, error, apart)
        alone = error[:, 0] - apart[:, 0, 0] / 2
        assert np.all(mixed - alone <= risk + 1e-6)


def test_nobody_who_is_like_nobody_takes_a_risk():
    rng = np.random.default_rng(0)
    filled = np.zeros((3, KERNELS))
    apart = apart_of(forecasts(rng, 3), filled)
    shares = np.tile([0.2, 0.4, 0.4], (3, 1))
    assert risk_of(shares, apart, filled) == pytest.approx(0)


def learned(best, pace, people=3, steps=150):
    """The ledger after `steps` in which the component `best` was right for everybody."""
    rng = np.random.default_rng(1)
    ledger = new_ledger(np.ones(KERNELS))
    for _ in range(steps):
        points = forecasts(rng, people, 0.3)
        filled = np.ones((people, KERNELS))
        apart = apart_of(points, filled)
        ledger, commitment = ledger.commit(apart, filled, pace)
        ledger = ledger.release(commitment)
        error = error_of(points, points[best, :, 0], filled)
        ledger, _ = ledger.learn(commitment, error, apart, pace)
    return ledger


@pytest.mark.parametrize("best", [0, 1, 2])
def test_shares_go_to_the_component_that_is_right(best):
    wanted = learned(best, np.array([0, 1, 1])).wanted
    assert wanted.argmax(axis=1).tolist() == [best, best]
    assert wanted[:, best].min() > 0.8


def test_a_mixture_of_several_components_is_found():
    """Each component is right for one of three people: no pair of them does as well."""
    rng = np.random.default_rng(1)
    ledger = new_ledger(np.ones(KERNELS))
    pace, filled = np.ones(3, int), np.ones((3, KERNELS))
    for _ in range(150):
        points = forecasts(rng, 3, 0.3)
        apart = apart_of(points, filled)
        error = error_of(points, points[range(3), range(3), 0], filled)
        ledger, commitment = ledger.commit(apart, filled, pace)
        ledger = ledger.release(commitment)
        ledger, _ = ledger.learn(commitment, error, apart, pace)
    assert ledger.wanted[1] == pytest.approx(1 / 3, abs=0.1)


def test_who_stands_teaches_little_of_who_walks():
    standing = learned(1, np.zeros(3, int), steps=10)
    assert standing.people.tolist() == [30, 0]
    stands, walks = standing.wanted
    assert standing.first[1] < walks[1] < stands[1]


def test_paces_are_told_by_speed():
    velocity = np.array([[0.0, 0.0], [0.0, 0.9 * WALKS], [-1.1 * WALKS, 0.0]])
    assert pace_of(velocity).tolist() == [0, 0, 1]


def test_scores_of_long_ago_count_for_less():
    ledger = learned(1, np.ones(3, int), steps=20)
    assert ledger.fade(1.0) is ledger
    half = ledger.fade(0.5)
    assert half.error == pytest.approx(ledger.error / 2)
    assert half.distances == pytest.approx(ledger.distances / 2)
    assert half.people.tolist() == [0, 30]
    forgotten = ledger.fade(0.0).wanted
    assert forgotten == pytest.approx(np.tile(ledger.first, (2, 1)))


def test_first_shares_are_in_proportion():
    ledger = new_ledger([1.0, 0.1])
    rest = 1 - ALONE
    assert ledger.wanted == pytest.approx(
        np.tile([ALONE, rest / 1.1, rest * 0.1 / 1.1], (2, 1))
    )
