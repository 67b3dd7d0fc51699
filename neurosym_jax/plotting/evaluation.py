"""The figures of an evaluation: forecasts over the truth, the fan of samples, errors by horizon."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.results import Result
from neurosym_jax.evaluation.summary import told_apart
from neurosym_jax.scene import to_world

__all__ = ["check_figures", "draw_figures", "draw_overview", "figure_path"]

ENDINGS = (".png", ".pdf", ".svg")
"""Of a figure's file."""
MAX_MODELS = 8
"""Lines and names that a figure has room for."""
OVERVIEW = 3
"""Test sets that one figure has room for."""


def draw_figures(where: Path, results: Sequence[Result]) -> list[Path]:
    """Figures of each test set: forecasts, samples, errors by horizon.

    Figures of the same name are replaced. Of more than `MAX_MODELS` models, those of one name are
    drawn by the first one.

    Args:
        where: a folder, of PNGs; or a name that ends in .png, .pdf or .svg, before whose ending
            that of the test set and of the figure is put.
        results: of all models on all test sets.
    """
    from neurosym_jax.plotting import (
        plot_fan,
        plot_forecasts,
        plot_horizon_errors,
        save_figure,
    )
    from neurosym_jax.plotting.forecasts import best_sample

    paths = []
    for test in dict.fromkeys(item.test_set for item in results):
        drawn = _drawn([item for item in results if item.test_set == test])
        first = next(iter(drawn.values()))
        observed, truth = _known(first)
        samples = {name: _samples(item) for name, item in drawn.items()}
        best = {name: best_sample(of, truth) for name, of in samples.items()}
        joint = f"jointly best of {max(map(len, samples.values()))}"
        title = f"{test.dataset}, {test.obs_len} + {test.pred_len} steps"
        shown = list(samples)[-1]
        figures = {
            "forecasts": plot_forecasts(observed, truth, best, f"{title}: {joint}"),
            "fan": plot_fan(observed, truth, samples[shown], f"{title}: {shown}"),
        }
        for metric in first.horizons:
            curves = {name: item.horizons[metric] for name, item in drawn.items()}
            figures[metric] = plot_horizon_errors(
                curves, first.period, f"{title}: {joint}", METRICS[metric].label
            )
        for kind, figure in figures.items():
            name = f"{test.dataset}_{test.obs_len}_{test.pred_len}_{kind}"
            paths.append(save_figure(figure, figure_path(where, name)))
    return paths


def check_figures(where: Path) -> None:
    """Refuse, before the work, a place at which `draw_figures` could not write.

    Raises:
        InputError: for a file that is no folder, or a name that ends otherwise than a figure's.
    """
    if where.suffix in ENDINGS:
        return
    if where.suffix and not where.is_dir():
        raise InputError(f"{where}: a figure's name must end in {', '.join(ENDINGS)}")
    if where.exists() and not where.is_dir():
        raise InputError(f"{where}: is not a folder, so no figures can be written into it")


def draw_overview(where: Path, results: Sequence[Result]) -> list[Path]:
    """One figure of up to `OVERVIEW` test sets; of more, those of `draw_figures`."""
    from neurosym_jax.plotting import save_figure
    from neurosym_jax.plotting.overview import Glance, plot_overview

    tests = list(dict.fromkeys(item.test_set for item in results))
    if len(tests) > OVERVIEW or "horizon" not in results[0].horizons:
        return draw_figures(where, results)
    glances = []
    for test in tests:
        drawn = _drawn([item for item in results if item.test_set == test])
        samples = {name: _samples(item) for name, item in drawn.items()}
        errors = {name: item.horizons["horizon"] for name, item in drawn.items()}
        observed, truth = _known(next(iter(drawn.values())))
        glances.append(Glance(test.dataset, observed, truth, samples, errors))
    path = where if where.suffix in ENDINGS else figure_path(where, "overview")
    return [save_figure(plot_overview(glances, results[0].period), path)]


def figure_path(where: Path, name: str) -> Path:
    """The file of a figure of this name, see `draw_figures`."""
    if where.suffix not in ENDINGS:
        return where / f"{name}.png"
    return where.with_name(f"{where.stem}_{name}{where.suffix}")


def _known(item: Result) -> tuple[np.ndarray, np.ndarray]:
    """What was observed [N, obs_len, 2] and what happened [N, pred_len, 2], world metres."""
    scene = item.example
    present = np.asarray(scene.valid)
    observed, truth = (to_world(part, scene) for part in (scene.observed, scene.known_future))
    return observed[present], truth[present]


def _samples(item: Result) -> np.ndarray:
    """[k, N, pred_len, 2] world metres, of the people who are there."""
    return item.forecast[:, np.asarray(item.example.valid)]


def _drawn(members: Sequence[Result]) -> dict[str, Result]:
    """What is drawn of a test set, each by a name of its own, in the order given."""
    alike: dict[str, list[Result]] = {}
    for item in members:
        alike.setdefault(item.name, []).append(item)
    if len(members) > MAX_MODELS:
        return {
            model if len(items) == 1 else f"{model}, first of {len(items)} models": items[0]
            for model, items in alike.items()
        }
    paths = [item.row.get("checkpoint") for item in members]
    short = told_apart(path for path in paths if path)
    several = {name for name, items in alike.items() if len(items) > 1}
    return {
        f"{item.name} {_which(item, alike, short)}" if item.name in several else item.name: item
        for item in members
    }


def _which(item: Result, alike: dict[str, list[Result]], short: dict[str, str]) -> str:
    """Its checkpoint, or a number where models of one name are not of different checkpoints."""
    same = alike[item.name]
    paths = {other.row.get("checkpoint") for other in same}
    if None in paths or len(paths) < len(same):
        return f"({same.index(item) + 1})"
    return short[item.row["checkpoint"]]
