"""Scores of symbols and events as text and as JSON."""

import textwrap
from collections.abc import Mapping
from typing import Any

from neurosym_jax.evaluation.paired import paired_difference
from neurosym_jax.evaluation.symbols import Question, SymbolScores

__all__ = ["format_symbol_scores", "symbol_score_rows"]

REFERENCE = "Markov chain"
"""What the first forecaster is compared with."""


def format_symbol_scores(scores: Mapping[str, SymbolScores], steps: int, period: float) -> str:
    """Log scores, less is better: a line for each state, symbol and event, at up to three steps.

    Args:
        scores: by the forecaster's name; the first is compared with the Markov chain.
        steps: that were forecast.
        period: seconds between them.
    """
    first = next(iter(scores))
    compared = paired_difference([scores[first].errors], [scores[REFERENCE].errors])
    means = {name: _means(each) for name, each in scores.items()}
    shown = sorted({1, (steps + 1) // 2, steps})
    targets = dict.fromkeys(_targets(scores[first]))
    asked = [Question(target, step) for target in targets for step in shown]
    asked += [Question(target, 0) for target in targets]
    heads = [textwrap.wrap(name, 12) for name in scores]
    heads.append(textwrap.wrap(f"{first} less {REFERENCE}, 95 % of other scenes", 26))
    deepest = max(map(len, heads))
    *names, less = ([""] * (deepest - len(head)) + head for head in heads)
    lines = [
        f"{'':22}{''.join(f'{cell:>13}' for cell in cells)}  {words}".rstrip()
        for *cells, words in zip(*names, less)
    ]
    for question in asked:
        metric = question.metric("log")
        if metric not in means[first]:
            continue
        when = f" at {period * question.step:.1f} s" if question.step else ""
        cells = "".join(f"{of.get(metric, float('nan')):13.3f}" for of in means.values())
        at = compared.metrics.index(metric)
        low, high = compared.intervals(metric)["scenes"] or (0.0, 0.0)
        difference = f"{compared.mean[at]:+.3f} [{low:+.3f}, {high:+.3f}]"
        lines.append(f"{question.target + when:22}{cells.replace('nan', '  -')}  {difference}")
    return "\n".join(lines)


def symbol_score_rows(scores: Mapping[str, SymbolScores]) -> list[dict[str, Any]]:
    """A row for each forecaster: every score's mean, and its reliability diagrams."""
    return [
        {
            "model": name,
            "scores": _means(each),
            "reliability": {
                target: dict(zip(("said", "happened", "count"), sums.tolist()))
                for target, sums in each.reliability.items()
            },
        }
        for name, each in scores.items()
    ]


def _means(scores: SymbolScores) -> dict[str, float]:
    return dict(zip(scores.errors.metrics, scores.errors.mean.tolist()))


def _targets(scores: SymbolScores) -> list[str]:
    return [metric.split(" ")[1] for metric in scores.errors.metrics]
