"""Scores of symbols and events against numbers by hand, and forecasters that must win or lose."""

import numpy as np
import pytest

from neurosym_jax.data.tracks import make_tracks
from neurosym_jax.evaluation.plan import baseline
from neurosym_jax.symbolic.forecast import SymbolSettings
from studies.symbolic_forecast.cases import make_cases, markov_chain, model_answer
from studies.symbolic_forecast.scores import (
    Question,
    evaluate_symbols,
    questions,
    score_answer,
    tuned_weights,
)

EVENTS = ("approaches", "meets")


@pytest.fixture(scope="module")
def walkers():
    """People who walk straight on, each for 12 s; now and then two of them meet."""
    draw = np.random.default_rng(0)
    rows = []
    for person in range(30):
        start, speed = draw.uniform(-5, 5, 2), draw.normal(0, 1, 2)
        for step in range(30):
            rows.append(
                (0.4 * (step + 3 * person), person, *(start + 0.4 * step * speed))
            )
    stamp, ids, x, y = np.array(rows).T
    return make_tracks("walkers", stamp, ids.astype(int), np.stack([x, y], axis=1))


@pytest.fixture(scope="module")
def cases(walkers):
    return make_cases([walkers], 8, 4, SymbolSettings(), EVENTS, most=2000)


def test_cases_are_pairs_of_one_window_within_reach(cases):
    assert 300 < len(cases.rows) <= 2400
    last = cases.windows.position[:, 7]
    k, l = cases.rows.T  # noqa: E741
    assert (np.linalg.norm(last[k] - last[l], axis=1) <= 8).all()
    assert (k != l).all()
    bounds = cases.windows.bounds
    for people in (k, l):
        assert (people >= bounds[cases.scene]).all()
        assert (people < bounds[cases.scene + 1]).all()


def test_straight_walkers_are_known_to_constant_velocity(cases):
    answer = model_answer(
        cases, baseline("constant_velocity", 8, 4), samples=20, seed=0
    )
    assert answer.count == 1
    assert (cases.states == answer.states.argmax(axis=2).T).mean() > 0.999
    np.testing.assert_array_equal(answer.events, cases.after)
    prior = {
        q: np.full(c.shape[1], 1 / c.shape[1]) for q, c, _ in questions(cases, answer)
    }
    scores = score_answer(cases, answer, prior, dict.fromkeys(prior, 1.0))
    means = dict(zip(scores.scores, scores.mean))
    # One sample, and the weight of another that is spread over 81 states.
    p = (1 + 1 / 81) / 2
    assert means["log state 2"] == pytest.approx(-np.log(p), abs=0.01)
    assert means["brier state 2"] == pytest.approx(
        (1 - p) ** 2 + 80 * (1 / 162) ** 2, abs=0.01
    )
    assert means["log meets 0"] == pytest.approx(-np.log(0.75), abs=1e-6)
    # Sure as it may be, and right: the least weight is best.
    assert set(tuned_weights(cases, answer, prior).values()) == {0.1}


def test_a_chain_is_of_probabilities(cases):
    table, events = markov_chain(cases)
    np.testing.assert_allclose(table.sum(axis=2), 1)
    np.testing.assert_allclose(table[1], table[0] @ table[0])
    seen = np.bincount(cases.start, minlength=81)
    state = seen.argmax()
    in_state = cases.start == state
    stayed = (cases.states[in_state, 0] == state).mean()
    assert table[0][state, state] == pytest.approx(stayed, abs=2 / in_state.sum())
    happened = cases.after[:, in_state].mean(axis=1)
    np.testing.assert_allclose(events[:, state], happened, atol=1 / in_state.sum())


def test_all_models_are_scored_on_the_same_questions(cases):
    models = {"straight on": baseline("constant_velocity", 8, 4)}
    evaluations = evaluate_symbols(cases, cases, cases, models, samples=1, seed=0)
    metric = Question("state", 4).metric("log")
    losses = {
        name: dict(zip(evaluation.scores, evaluation.mean))[metric]
        for name, evaluation in evaluations.items()
    }
    assert min(losses, key=losses.get) == "straight on"
    assert losses["Markov chain"] < losses["frequencies"]
    counts = {
        name: evaluation.scores[metric].count.sum()
        for name, evaluation in evaluations.items()
    }
    assert set(counts.values()) == {len(cases.rows)}
