"""A few test sets at a glance: for each a scene with its forecasts, and errors by horizon below."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from neurosym_jax.plotting.forecasts import best_sample, draw_paths, draw_scene
from neurosym_jax.plotting.horizon import draw_horizon
from neurosym_jax.plotting.palette import line_styles, model_colours
from neurosym_jax.plotting.style import WIDTH, add_legend, dress, new_figure

__all__ = ["Glance", "plot_overview"]


class Glance(NamedTuple):
    """One scene of a test set, and mean errors on all of it."""

    title: str
    observed: np.ndarray
    """[N, obs_len, 2] metres."""
    truth: np.ndarray
    """[N, pred_len, 2] metres."""
    samples: Mapping[str, np.ndarray]
    """[k, N, pred_len, 2] metres by the model's name; all samples of the last one are drawn."""
    errors: Mapping[str, Mapping[str, np.ndarray]]
    """[pred_len] means by the metric's and the model's name."""


def plot_overview(glances: Sequence[Glance], period: float, metric: str = "horizon") -> Figure:
    """One to three test sets side by side: forecasts above, a metric against the horizon below.

    A model's line is its sample of least joint ADE; `period` is in seconds.
    """
    figure, axes = new_figure(WIDTH, 5.4, 2, len(glances), height_ratios=(1.6, 1))
    for column, glance in enumerate(glances):
        above, below = axes[:, column]
        weight = draw_scene(above, glance.observed, glance.truth)
        colours, styles = model_colours(glance.samples), line_styles(glance.samples)
        for name, samples in glance.samples.items():
            look = {"color": colours[name], "zorder": 4, "linewidth": 1.5 * weight}
            label = f"{name}, {'one guess' if len(samples) == 1 else f'best of {len(samples)}'}"
            best = best_sample(samples, glance.truth)
            draw_paths(above, best, glance.observed, linestyle=styles[name], label=label, **look)
        name, samples = list(glance.samples.items())[-1]
        faint = {"color": colours[name], "linewidth": 0.5, "alpha": 0.35, "zorder": 2.5}
        for sample in samples if len(samples) > 1 else ():
            draw_paths(above, sample, glance.observed, **faint, label=f"all samples of {name}")
        above.set_aspect("equal", adjustable="datalim")
        dress(above, "x [m]", "y [m]" if column == 0 else "", glance.title)
        draw_horizon(below, glance.errors[metric], period)
        dress(below, "horizon [s]", "mean error [m]" if column == 0 else "")
        below.sharey(axes[1, 0])
    top = max(curve.max() for glance in glances for curve in glance.errors[metric].values())
    axes[1, 0].set_ylim(0, 1.05 * top)
    add_legend(figure, *axes[0])
    return figure
