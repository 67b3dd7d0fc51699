"""Log and Brier scores of forecast states and events beside classical answers.

The scores are those of `evaluation.symbol_scores`, but counts of samples are smoothed,
for every question, towards how often its answers occurred in training scenes, with the
weight (of `WEIGHTS`) that scores best on validation scenes. So a single forecast, which
alone says 0 or 1, is judged by the best probabilities that can be made of it, as k
samples are.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.evaluation.intervals import ErrorsByScene
from neurosym_jax.evaluation.scoring import Score
from neurosym_jax.forecasting.model import Model
from studies.symbolic_forecast.cases import (
    Answer,
    Cases,
    counted,
    markov_chain,
    model_answer,
)

__all__ = ["Question", "evaluate_symbols", "questions", "score_answer", "tuned_weights"]

WEIGHTS = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Weights of the prior, in samples."""


class Question(NamedTuple):
    """One thing that is forecast of every pair."""

    target: str
    """`state` or an event."""
    step: int
    """From 1; 0 for an event, which may happen at any."""

    def metric(self, score: str) -> str:
        """Name of its `score`."""
        return f"{score} {self.target} {self.step}"


Priors = Mapping[Question, np.ndarray]
"""For every question the frequencies of its answers, [C]."""
Weights = Mapping[Question, float]
"""For every question the weight of its prior."""


def questions(
    cases: Cases, answer: Answer
) -> Iterator[tuple[Question, np.ndarray, np.ndarray]]:
    """Every question that `answer` answers, with counts [P, C] and what came true [P]."""
    for step, counts in enumerate(answer.states):
        yield Question("state", step + 1), counts, cases.states[:, step]
    for name, happens, true in zip(cases.events, answer.events, cases.after):
        counts = np.stack([answer.count - happens, happens], axis=1)
        yield Question(name, 0), counts, true.astype(int)


def evaluate_symbols(
    train: Cases,
    tune: Cases,
    test: Cases,
    models: Mapping[str, Model],
    *,
    samples: int,
    seed: int,
) -> dict[str, ErrorsByScene]:
    """Scores on `test` of models and of classical answers, by name.

    The answers are a Markov chain over the states, persistence of the state and of
    events, and the frequencies in `train`.

    Args:
        train: pairs that the chain and the priors are learned from.
        tune: pairs that the priors' weights are chosen on.
        test: pairs to score, of the same settings and steps.
        models: by name.
        samples: number of forecasts of each scene, k.
        seed: random seed of the noise.
    """
    truth = counted(train, train.states[None], train.after[None])
    priors = {
        question: (counts.sum(axis=0) + 1 / counts.shape[1]) / (len(counts) + 1)
        for question, counts, _ in questions(train, truth)
    }
    scores = {}
    for name, model in models.items():
        tune_answer, test_answer = (
            model_answer(cases, model, samples=samples, seed=seed)
            for cases in (tune, test)
        )
        scores[name] = score_answer(
            test, test_answer, priors, tuned_weights(tune, tune_answer, priors)
        )
    no_weights = dict.fromkeys(priors, 0.0)
    table, events = markov_chain(train)
    chain = Answer(1, table[:, test.start], events[:, test.start])
    scores["Markov chain"] = score_answer(test, chain, priors, no_weights)
    stay_tune, stay_test = map(_persistence, (tune, test))
    weights = tuned_weights(tune, stay_tune, priors)
    scores["persistence"] = score_answer(test, stay_test, priors, weights)
    pairs, steps = test.states.shape
    states = [
        np.tile(priors[Question("state", step + 1)], (pairs, 1))
        for step in range(steps)
    ]
    events = [np.full(pairs, priors[Question(event, 0)][1]) for event in test.events]
    rates = Answer(1, np.stack(states), np.stack(events))
    scores["frequencies"] = score_answer(test, rates, priors, no_weights)
    return scores


def _persistence(cases: Cases) -> Answer:
    """The last observed state stays; events of the observation happen again."""
    stays = np.repeat(cases.start[:, None], cases.states.shape[1], axis=1)
    return counted(cases, stays[None], cases.before[None])


def tuned_weights(
    cases: Cases, answer: Answer, priors: Priors
) -> dict[Question, float]:
    """For each question the weight of the prior, of `WEIGHTS`, with the best log score."""
    chosen = {}
    for question, counts, true in questions(cases, answer):
        hit = np.take_along_axis(counts, true[:, None], axis=1)
        shares = _smoothed(
            hit, answer.count, priors[question][true, None], np.array(WEIGHTS)
        )
        chosen[question] = WEIGHTS[int(np.log(shares).mean(axis=0).argmax())]
    return chosen


def score_answer(
    cases: Cases, answer: Answer, priors: Priors, weights: Weights
) -> ErrorsByScene:
    """Scores of an answer, question by question; with weight 0 counts are probabilities."""
    scenes, scores = cases.windows.scenes, {}
    pairs = np.bincount(cases.scene, minlength=scenes).astype(float)
    for question, counts, true in questions(cases, answer):
        shares = _smoothed(counts, answer.count, priors[question], weights[question])
        hit = np.take_along_axis(shares, true[:, None], axis=1)[:, 0]
        log, brier = (
            -np.log(np.maximum(hit, 1e-9)),
            np.square(shares).sum(axis=1) - 2 * hit + 1,
        )
        for kind, pair_scores in (("log", log), ("brier", brier)):
            total = np.bincount(cases.scene, pair_scores, scenes)
            scores[question.metric(kind)] = Score(total, pairs)
    return ErrorsByScene(
        scores, cases.windows.identity, cases.windows.position.shape[1]
    )


def _smoothed(
    counts: np.ndarray, total: int, prior: np.ndarray, weight: Any
) -> np.ndarray:
    """[P, C] probabilities from counts [P, C], see `symbolic.forecast`."""
    return (counts + weight * prior) / (total + weight)
