"""Figures of an evaluation: of each test set a scene with its forecasts, and errors by horizon."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from neurosym_jax.errors import InputError
from neurosym_jax.evaluation.compare import Result
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.evaluation.tables import labels
from neurosym_jax.plotting import style
from neurosym_jax.plotting.curves import draw_horizon
from neurosym_jax.plotting.forecasts import draw_scene
from neurosym_jax.runtime.files import refuse_unwritable
from neurosym_jax.scene import to_world

__all__ = ["check_figures", "draw_figures"]

MAX_MODELS = 8
"""Lines and names that a figure has room for."""
TOGETHER = 3
"""Test sets that one figure has room for."""


def draw_figures(
    where: Path, results: Sequence[Result], *, together: bool = False
) -> list[Path]:
    """Write a figure of each test set, or one of up to three `together`; returns the files.

    Figures of the same name are replaced. If there are more than `MAX_MODELS` models,
    the first of each name is drawn.

    Args:
        where: a folder, for PNGs; or a name that ends in .png, .pdf or .svg, with which
            the figures' names begin.
        results: of all models on all test sets.
        together: whether to draw all in `overview`.
    """
    sets = list(dict.fromkeys(result.test_set for result in results))
    drawn = []
    for test_set in sets:
        members = [result for result in results if result.test_set == test_set]
        drawn.append(_drawn(members))
    named = where.suffix in style.ENDINGS
    if together and len(sets) <= TOGETHER:
        path = where if named else where / "overview.png"
        return [style.save_figure(_figure(drawn), path)]
    paths = []
    for test_set, models in zip(sets, drawn):
        name = f"{test_set.dataset}_{test_set.obs_len}_{test_set.pred_len}"
        prefixed = where.with_name(f"{where.stem}_{name}{where.suffix}")
        path = prefixed if named else where / f"{name}.png"
        paths.append(style.save_figure(_figure([models]), path))
    return paths


def check_figures(where: Path) -> None:
    """Refuse, before the work, a place where `draw_figures` could not write.

    Raises:
        InputError: for what cannot be written, or a name with another ending than a
            figure's.
    """
    prefix = where.suffix in style.ENDINGS
    if where.suffix and not (prefix or where.is_dir()):
        raise InputError(
            f"{where}: a figure's name must end in {', '.join(style.ENDINGS)}"
        )
    refuse_unwritable((where.parent if prefix else where) / "overview.png")


def _drawn(members: Sequence[Result]) -> dict[str, Result]:
    """The results to draw of a test set, by distinct names, in the order given."""
    if len(members) > MAX_MODELS:
        return {item.name: item for item in reversed(members)}
    models = [(item.name, item.row["checkpoint"]) for item in members]
    return dict(zip(labels(models), members))


def _figure(columns: Sequence[dict[str, Result]]) -> Figure:
    """A column for each test set: the scene above, each error against the horizon below."""
    first, *_ = columns[0].values()
    metrics = list(first.horizons)
    heights = (1.6, *[1.0] * len(metrics))
    shape = (len(heights), len(columns))
    figure, axes = style.new_figure(
        style.WIDTH, 2.1 * sum(heights), *shape, height_ratios=heights
    )
    for place, models in enumerate(columns):
        first = next(iter(models.values()))
        scene = first.example
        test = first.test_set
        first_column = place == 0
        valid = np.asarray(scene.valid)
        past = to_world(scene.observed, scene)[valid]
        future = to_world(scene.known_future, scene)[valid]
        above, *below = axes[:, place]
        forecasts = {}
        for name, result in models.items():
            forecasts[name] = result.forecast[:, valid]
        draw_scene(above, past, future, forecasts)
        title = f"{test.dataset}, {test.obs_len} + {test.pred_len} steps"
        style.dress_floor(above, title, "y [m]" if first_column else "")
        for panel, shared, metric in zip(below, axes[1:, 0], metrics):
            curves = {name: item.horizons[metric] for name, item in models.items()}
            draw_horizon(panel, curves, first.period)
            style.dress(
                panel, "horizon [s]", METRICS[metric].label if first_column else ""
            )
            if not first_column:
                panel.sharey(shared)
    return style.add_legend(figure, *axes[0])
