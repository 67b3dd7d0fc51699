"""The figures of an evaluation: forecasts over the truth, the fan of samples, errors by horizon."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.evaluation.cases import TestSet
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.scene import Scene, to_world

__all__ = ["Shown", "draw_figures"]

MOST = 8
"""Lines and names that a figure has room for."""


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """What one row of the table contributes to its test set's figures."""

    test_set: TestSet
    model: str
    scene: Scene
    """The example, padded, with its truth."""
    forecast: np.ndarray
    """[k, N, pred_len, 2] world metres."""
    horizons: dict[str, np.ndarray]
    """[pred_len] means over the whole test set, by metrics that have a value for each step."""
    period: float
    """Seconds between steps."""
    score: float
    """By which models of one name are told apart, the less the better."""


def draw_figures(folder: Path, shown: Sequence[Shown]) -> list[Path]:
    """Figures of each test set: forecasts, samples, errors by horizon.

    Figures of the same name are replaced. Of more than `MOST` models, those of one name are drawn
    by the one with the least `score`.
    """
    from neurosym_jax.plotting import (
        plot_fan,
        plot_forecasts,
        plot_horizon_errors,
        save_figure,
    )

    paths = []
    for test in dict.fromkeys(item.test_set for item in shown):
        drawn = _drawn([item for item in shown if item.test_set == test])
        names, members = list(drawn), list(drawn.values())
        scene = members[0].scene
        present = np.asarray(scene.valid)
        observed, truth = (
            to_world(part, scene)[present] for part in (scene.observed, scene.future)
        )
        best = {name: _best(item.forecast[:, present], truth) for name, item in zip(names, members)}
        fan = members[-1].forecast[:, present]
        samples = max(len(item.forecast) for item in members)
        joint = f"jointly best of {samples}"
        title = f"{test.scene}, {test.obs_len} + {test.pred_len} steps"
        where = folder / f"{test.scene}_{test.obs_len}_{test.pred_len}"
        figures = {
            "forecasts": plot_forecasts(observed, truth, best, f"{title}: {joint}"),
            "fan": plot_fan(observed, truth, fan, f"{title}: {names[-1]}"),
        }
        for metric in members[0].horizons:
            curves = {name: item.horizons[metric] for name, item in drawn.items()}
            figures[metric] = plot_horizon_errors(
                curves, members[0].period, f"{title}: {joint}", METRICS[metric].label
            )
        for kind, figure in figures.items():
            paths.append(save_figure(figure, where.with_name(f"{where.name}_{kind}.png")))
    return paths


def _best(forecast: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The sample [N, pred_len, 2] of `forecast [k, N, pred_len, 2]` with least joint ADE."""
    error = np.linalg.norm(forecast - truth, axis=-1).mean(axis=(1, 2))
    return forecast[error.argmin()]


def _drawn(members: Sequence[Shown]) -> dict[str, Shown]:
    """What is drawn of a test set, each by a name of its own, in the order given."""
    alike: dict[str, list[Shown]] = {}
    for item in members:
        alike.setdefault(item.model, []).append(item)
    if len(members) > MOST:
        return {
            model if len(items) == 1 else f"{model}, best of {len(items)} models": min(
                items, key=lambda item: item.score
            )
            for model, items in alike.items()
        }
    return {
        item.model
        if len(alike[item.model]) == 1
        else f"{item.model} ({alike[item.model].index(item) + 1})": item
        for item in members
    }
