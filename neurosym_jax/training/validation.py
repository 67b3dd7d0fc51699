"""Validation: errors on windows that nothing is learned from, the best row, and advice."""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from neurosym_jax.data.windows import Batch
from neurosym_jax.evaluation.scoring import score_forecaster
from neurosym_jax.training.run import Run

__all__ = ["Advice", "Row", "best_row", "is_over", "validate"]

Row = dict[str, Any]
"""A line of `metrics.jsonl`: the step, metrics of training and, where it was validated, `val_...`.
"""

ERRORS = ("joint_ade", "joint_fde", "energy_score", "coverage_50")
EFFECT = ("neighbour_share", "neighbour_near", "neighbour_move")
"""The metrics of a validation by which a pooling is judged."""
LEAST = 0.5
"""Least share of people with somebody within 2 m whom a living pooling changes."""
FEW = 100
"""Fewer people than these make a validation error that says little."""
STALLED = 5
"""Validations in a row without a better one, after which that is told."""


def validate(run: Run, params: Any, batches: Sequence[Batch]) -> Row:
    """Errors on the validation windows, best of k and of the distribution.

    `val_score` chooses the best state, see `Recipe.select_by`.
    """
    forecaster = run.forecaster
    metrics = (*ERRORS, *(EFFECT if forecaster.sees_neighbours else ()))
    samples, seed = run.samples, run.recipe.seed
    result = score_forecaster(
        forecaster, params, batches, samples=samples, seed=seed, metrics=metrics
    )
    means = {name.removeprefix("joint_"): result.mean(name) for name in result.scores}
    usual = "energy" if forecaster.calibrated else "ade_fde"
    by = {"ade": ("ade",), "ade_fde": ("ade", "fde"), "energy": ("energy_score",)}
    score = sum(means[name] for name in by[run.recipe.select_by or usual])
    needed = ("ade", "fde")
    finite = {name: x for name, x in means.items() if name in needed or np.isfinite(x)}
    return {
        "val_score": score,
        **{f"val_{name}": value for name, value in finite.items()},
    }


def best_row(rows: Sequence[Row]) -> Row:
    """The row of the best validation, of equals the newest; an empty one before the first."""
    validated = [row for row in rows if "val_score" in row]
    return min(reversed(validated), key=lambda row: row["val_score"], default={})


def is_over(run: Run, rows: Sequence[Row], done: int) -> bool:
    """Whether all steps are done, or patience is at its end."""
    patience = run.recipe.patience
    return done >= run.recipe.steps or (0 < patience <= _waited(rows))


def _waited(rows: Sequence[Row]) -> int:
    """Validations since the best one."""
    validated = [row for row in rows if "val_score" in row]
    return len(validated) - 1 - validated.index(best_row(rows)) if validated else 0


class Advice:
    """What a training tells in words, once each, on the standard error."""

    def __init__(self, run: Run):
        """Look at the windows that are validated on."""
        self._run, self._given = run, set[str]()
        if (people := run.validation.agents) < FEW:
            self._give(
                f"validation has {people} people in windows: below {FEW} its errors say little, "
                "and the best state is chosen half by chance; validate on more"
            )

    def __call__(self, rows: Sequence[Row]) -> None:
        """Look at the rows so far, of which the last was validated."""
        row, recipe = rows[-1], self._run.recipe
        if row.get("val_neighbour_near", 1.0) < LEAST:
            remedy = "a third of the learning_rate and 500 warmup_steps"
            if not getattr(recipe, "gentle_pooling", True):
                remedy = f"gentle_pooling=true, or {remedy}"
            self._give(
                f"dead pooling at step {row['step']}: {row['val_neighbour_share']:.0%} of people "
                f"are changed by their neighbours; try {remedy}",
                "dead pooling",
            )
        if _waited(rows) == STALLED and not recipe.patience:
            self._give(
                f"no validation is better than that of step {best_row(rows)['step']} since; its "
                "state is kept, so end this run, or begin from it with a smaller learning_rate"
            )

    def _give(self, text: str, about: str = "") -> None:
        if (about or text) not in self._given:
            self._given.add(about or text)
            print(f"advice: {text}", file=sys.stderr)
