"""How good forecasts of symbols, states and events are: log score, Brier score, reliability.

Both scores are proper: nobody gains by saying something else than they believe. Of the class c that
came true they are -ln p_c (nats; Good, "Rational decisions", 1952) and the sum over the classes of
(p - [it is c])^2 (0 to 2; Brier, "Verification of forecasts expressed in terms of probability",
1950); of both, less is better. Counts of samples become probabilities as in `symbolic.forecast`:
for every question smoothed towards how often its answers occurred in training scenes, with that
weight, of a few, which scores best on validation scenes. So a single forecast, which alone says 0
or 1, is judged by the best probabilities that can be made of it, as k samples are.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.evaluation.bootstrap import ErrorsByScene
from neurosym_jax.forecasting.model import Model
from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.forecast import symbol_table
from studies.symbolic_forecast.cases import (
    Answer,
    Cases,
    markov_chain,
    model_answer,
    persistence,
)

__all__ = [
    "BINS",
    "Question",
    "SymbolScores",
    "evaluate_symbols",
    "questions",
    "score_answer",
    "tuned_weights",
]

WEIGHTS = (0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
"""Of the prior, in samples, among which the one of a question is chosen."""
BINS = 10
"""Of a reliability diagram, equal parts of [0, 1]."""


class Question(NamedTuple):
    """One thing that is forecast of every pair."""

    target: str
    """`state`, a symbol or an event."""
    step: int
    """From 1; 0 for an event, which may happen at any."""

    def metric(self, score: str) -> str:
        """What `score` of it is called."""
        return f"{score} {self.target} {self.step}"


@dataclasses.dataclass(frozen=True, eq=False)
class SymbolScores:
    """What a forecaster scores on the pairs of a test set."""

    errors: ErrorsByScene
    """Of `log` and `brier` of every question, see `Question.metric`."""
    reliability: dict[str, np.ndarray]
    """[3, BINS] by target: sum of the probabilities said, of what happened, and how many."""


Priors = Mapping[Question, np.ndarray]
"""Of every question, [C] how often its answers occurred."""
Weights = Mapping[Question, float]
"""Of every question, the weight of its prior."""


def questions(cases: Cases, answer: Answer) -> Iterator[tuple[Question, np.ndarray, np.ndarray]]:
    """Every question that `answer` answers, with counts [P, C] and what came true [P]."""
    table = symbol_table(cases.settings.calculus)
    symbols = CALCULI[cases.settings.calculus].symbols
    for step in range(cases.states.shape[1]):
        counts, true = answer.of_states(cases, step), cases.states[:, step]
        yield Question("state", step + 1), counts, true
        for place, symbol in enumerate(symbols):
            of_symbol = table[:, place]
            yield Question(symbol, step + 1), counts @ of_symbol, of_symbol.argmax(axis=1)[true]
    for number, event in enumerate(cases.events):
        counts = answer.of_event(cases, number)
        if counts is not None:
            yield Question(event, 0), counts, cases.after[number].astype(int)


def evaluate_symbols(
    train: Cases, tune: Cases, test: Cases, models: Mapping[str, Model], *, samples: int, seed: int
) -> dict[str, SymbolScores]:
    """Scores on `test` of models and of what needs none, by name.

    Beside the models: a Markov chain over the states, with and without the transitions that its
    diagram lacks; persistence of the state; and how often everything happens, whoever it is.

    Args:
        train: what the chain and the priors are learned from.
        tune: what the priors' weights are chosen on.
        test: pairs to score, of the same settings and steps.
        models: by the name that they are to have.
        samples: forecasts of each scene, k.
        seed: determines, with the scene and the sample, the noise.
    """
    truth = Answer(train.states[None], train.after[None])
    priors = {
        question: (counts.sum(axis=0) + 1 / counts.shape[1]) / (len(counts) + 1)
        for question, counts, _ in questions(train, truth)
    }
    chain, inside = markov_chain(train), markov_chain(train, within=True)
    scores = {}
    for name, model in models.items():
        of_tune, of_test = (
            model_answer(cases, model, samples=samples, seed=seed) for cases in (tune, test)
        )
        scores[name] = score_answer(test, of_test, priors, tuned_weights(tune, of_tune, priors))
    known = dict.fromkeys(priors, 0.0)
    scores["Markov chain"] = score_answer(test, chain, priors, known)
    scores["Markov chain, diagram only"] = score_answer(test, inside, priors, known)
    stays = tuned_weights(tune, persistence(tune), priors)
    scores["persistence"] = score_answer(test, persistence(test), priors, stays)
    size = len(CALCULI[test.settings.calculus].states)
    steps = test.states.shape[1]
    rates = Answer(
        table=np.stack(
            [np.tile(priors[Question("state", step + 1)], (size, 1)) for step in range(steps)]
        ),
        event_table=np.stack(
            [np.full(size, priors[Question(event, 0)][1]) for event in test.events]
        ),
    )
    scores["frequencies"] = score_answer(test, rates, priors, known)
    return scores


def tuned_weights(cases: Cases, answer: Answer, priors: Priors) -> dict[Question, float]:
    """For each question the weight of the prior, of `WEIGHTS`, with the best log score."""
    chosen = {}
    for question, counts, true in questions(cases, answer):
        hit = np.take_along_axis(counts, true[:, None], axis=1)
        shares = _smoothed(hit, answer.count, priors[question][true, None], np.array(WEIGHTS))
        chosen[question] = WEIGHTS[int(np.log(shares).mean(axis=0).argmax())]
    return chosen


def score_answer(cases: Cases, answer: Answer, priors: Priors, weights: Weights) -> SymbolScores:
    """What an answer scores, question by question.

    Args:
        cases: of P pairs.
        answer: of the same.
        priors: [C] of each question.
        weights: of the priors; 0 leaves probabilities as they are.
    """
    scenes, names, totals = cases.windows.scenes, [], []
    reliability: dict[str, np.ndarray] = {}
    for question, counts, true in questions(cases, answer):
        shares = _smoothed(counts, answer.count, priors[question], weights[question])
        for score, losses in zip(("log", "brier"), _losses(shares, true)):
            names.append(question.metric(score))
            totals.append(np.bincount(cases.scene, losses, scenes))
        if question.target != "state":
            # Of an event its presence; of a symbol each of its values is a yes or no.
            classes = range(1 if question.step == 0 else 0, shares.shape[1])
            sums = reliability.setdefault(question.target, np.zeros((3, BINS)))
            for each in classes:
                sums += _binned(shares[:, each], true == each)
    pairs = np.bincount(cases.scene, minlength=scenes).astype(float)
    steps = cases.windows.position.shape[1]
    errors = ErrorsByScene(
        tuple(names),
        np.stack(totals, axis=1),
        np.repeat(pairs[:, None], len(names), axis=1),
        cases.windows.identity,
        steps,
    )
    return SymbolScores(errors, reliability)


def _smoothed(counts: np.ndarray, total: int, prior: np.ndarray, weight: Any) -> np.ndarray:
    """[P, C] probabilities from counts [P, C], see `symbolic.forecast`."""
    return (counts + weight * prior) / (total + weight)


def _losses(shares: np.ndarray, true: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """[P] log and Brier scores of probabilities [P, C], of which `true` [P] came true."""
    hit = np.take_along_axis(shares, true[:, None], axis=1)[:, 0]
    return -np.log(np.maximum(hit, 1e-9)), np.square(shares).sum(axis=1) - 2 * hit + 1


def _binned(said: np.ndarray, happened: np.ndarray) -> np.ndarray:
    """[3, BINS] see `SymbolScores.reliability`."""
    place = np.minimum((said * BINS).astype(int), BINS - 1)
    return np.stack(
        [np.bincount(place, each, BINS) for each in (said, happened, np.ones(len(said)))]
    )
