"""The figures of an evaluation: forecasts over the truth, the fan of samples, errors by horizon."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.results import Result
from neurosym_jax.evaluation.summary import told_apart
from neurosym_jax.plotting.forecasts import best_sample, plot_fan, plot_forecasts
from neurosym_jax.plotting.horizon import plot_horizon_errors
from neurosym_jax.plotting.overview import Glance, plot_overview
from neurosym_jax.plotting.style import ENDINGS, save_figure
from neurosym_jax.scene import to_world

__all__ = ["check_figures", "draw_figures", "draw_overview"]

MAX_MODELS = 8
"""Lines and names that a figure has room for."""
OVERVIEW = 3
"""Test sets that one figure has room for."""


def draw_figures(where: Path, results: Sequence[Result]) -> list[Path]:
    """Write figures of each test set: forecasts, samples, errors by horizon.

    Figures of the same name are replaced. Of more than `MAX_MODELS` models, the first of each name
    is drawn.

    Args:
        where: a folder, for PNGs; or a name that ends in .png, .pdf or .svg, with which the
            figures' names begin.
        results: of all models on all test sets.
    """
    paths = []
    for glance, members in _glances(results):
        test, (shown, fan) = members[0].test_set, list(glance.samples.items())[-1]
        best = {name: best_sample(of, glance.truth) for name, of in glance.samples.items()}
        joint = f"jointly best of {max(map(len, glance.samples.values()))}"
        title, scene = f"{test.dataset}, {test.obs_len} + {test.pred_len} steps", glance[1:3]
        figures = {
            "forecasts": plot_forecasts(*scene, best, f"{title}: {joint}"),
            "fan": plot_fan(*scene, fan, f"{title}: {shown}"),
        }
        for metric, curves in glance.errors.items():
            label = METRICS[metric].label
            figures[metric] = plot_horizon_errors(
                curves, members[0].period, f"{title}: {joint}", label
            )
        for kind, figure in figures.items():
            name = f"{test.dataset}_{test.obs_len}_{test.pred_len}_{kind}"
            paths.append(save_figure(figure, _path(where, name)))
    return paths


def draw_overview(where: Path, results: Sequence[Result]) -> list[Path]:
    """Write one figure of up to `OVERVIEW` test sets; for more, those of `draw_figures`."""
    glances = [glance for glance, _ in _glances(results)]
    if len(glances) > OVERVIEW or "horizon" not in results[0].horizons:
        return draw_figures(where, results)
    path = where if where.suffix in ENDINGS else _path(where, "overview")
    return [save_figure(plot_overview(glances, results[0].period), path)]


def check_figures(where: Path) -> None:
    """Refuse, before the work, a place where `draw_figures` could not write.

    Raises:
        InputError: for a file that is no folder, or a name with another ending than a figure's.
    """
    if where.suffix in ENDINGS:
        return
    if where.suffix and not where.is_dir():
        raise InputError(f"{where}: a figure's name must end in {', '.join(ENDINGS)}")
    if where.exists() and not where.is_dir():
        raise InputError(f"{where}: is not a folder, so no figures can be written into it")


def _path(where: Path, name: str) -> Path:
    if where.suffix not in ENDINGS:
        return where / f"{name}.png"
    return where.with_name(f"{where.stem}_{name}{where.suffix}")


def _glances(results: Sequence[Result]) -> list[tuple[Glance, list[Result]]]:
    """What is drawn of each test set, and its results."""
    found = []
    for test in dict.fromkeys(item.test_set for item in results):
        drawn = _drawn([item for item in results if item.test_set == test])
        members = list(drawn.values())
        scene = members[0].example
        valid = np.asarray(scene.valid)
        observed = to_world(scene.observed, scene)[valid]
        truth = to_world(scene.known_future, scene)[valid]
        samples = {name: item.forecast[:, valid] for name, item in drawn.items()}
        errors = {
            metric: {name: item.horizons[metric] for name, item in drawn.items()}
            for metric in members[0].horizons
        }
        found.append((Glance(test.dataset, observed, truth, samples, errors), members))
    return found


def _drawn(members: Sequence[Result]) -> dict[str, Result]:
    """The results to draw of a test set, by distinct names, in the order given."""
    counts = Counter(item.name for item in members)
    if len(members) > MAX_MODELS:
        drawn = {}
        for item in members:
            count = counts[item.name]
            first = f"{item.name}, first of {count} models" if count > 1 else item.name
            drawn.setdefault(first, item)
        return drawn
    short = told_apart(path for item in members if (path := item.row.get("checkpoint")))
    drawn = {}
    for item in members:
        same = [other for other in members if other.name == item.name]
        paths = {other.row.get("checkpoint") for other in same}
        # By checkpoint, or by a number where checkpoints do not differ.
        own = f"({same.index(item) + 1})"
        if None not in paths and len(paths) == len(same):
            own = short[item.row["checkpoint"]]
        drawn[f"{item.name} {own}" if len(same) > 1 else item.name] = item
    return drawn
