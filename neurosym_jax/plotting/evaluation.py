"""The figures of an evaluation: forecasts over the truth, the fan of samples, errors by horizon."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.run import Result
from neurosym_jax.scene import to_world

__all__ = ["draw_figures"]

MAX_MODELS = 8
"""Lines and names that a figure has room for."""


def draw_figures(folder: Path, results: Sequence[Result]) -> list[Path]:
    """Figures of each test set: forecasts, samples, errors by horizon.

    Figures of the same name are replaced. Of more than `MAX_MODELS` models, those of one name are
    drawn by the one with the least `score`.
    """
    from neurosym_jax.plotting import (
        plot_fan,
        plot_forecasts,
        plot_horizon_errors,
        save_figure,
    )

    paths = []
    for test in dict.fromkeys(item.test_set for item in results):
        drawn = _drawn([item for item in results if item.test_set == test])
        names, members = list(drawn), list(drawn.values())
        scene = members[0].example
        present = np.asarray(scene.valid)
        observed, truth = (
            to_world(part, scene)[present] for part in (scene.observed, scene.known_future)
        )
        best = {name: _best(item.forecast[:, present], truth) for name, item in zip(names, members)}
        fan = members[-1].forecast[:, present]
        samples = max(len(item.forecast) for item in members)
        joint = f"jointly best of {samples}"
        title = f"{test.dataset}, {test.obs_len} + {test.pred_len} steps"
        where = folder / f"{test.dataset}_{test.obs_len}_{test.pred_len}"
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


def _drawn(members: Sequence[Result]) -> dict[str, Result]:
    """What is drawn of a test set, each by a name of its own, in the order given."""
    alike: dict[str, list[Result]] = {}
    for item in members:
        alike.setdefault(item.name, []).append(item)
    if len(members) > MAX_MODELS:
        return {
            model if len(items) == 1 else f"{model}, best of {len(items)} models": min(
                items, key=lambda item: item.score
            )
            for model, items in alike.items()
        }
    return {
        item.name
        if len(alike[item.name]) == 1
        else f"{item.row['model']} ({alike[item.row['model']].index(item) + 1})": item
        for item in members
    }
