"""Errors against the horizon, a line a model."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.plotting.palette import line_styles, model_colours
from neurosym_jax.plotting.style import COLUMN, add_legend, checked, dress, new_figure

__all__ = ["draw_horizon", "plot_horizon_errors"]


def plot_horizon_errors(
    errors: Mapping[str, ArrayLike],
    period: float = 0.4,
    title: str | None = None,
    label: str = "mean displacement error [m]",
) -> Figure:
    """A mean error against the horizon, one line a model, the largest first in the legend.

    Args:
        errors: [pred_len], by the model's name.
        period: seconds from the last observation to the first step, and between steps.
        title: of the figure.
        label: name of the error, with its unit.

    Raises:
        InputError: for no model, a wrong shape, or a value that is not finite.
    """
    if not errors or not period > 0:
        raise InputError("errors need at least one model and a period of more than 0 seconds")
    curves = {name: checked(f"errors {name!r}", curve, (None,)) for name, curve in errors.items()}
    figure, ((axes,),) = new_figure(COLUMN, 2.2)
    draw_horizon(axes, curves, period)
    dress(axes, "horizon [s]", label, title)
    add_legend(figure, axes)
    return figure


def draw_horizon(axes: Axes, curves: Mapping[str, np.ndarray], period: float) -> None:
    """Draw a line [pred_len] for each model against seconds."""
    colours, styles = model_colours(curves), line_styles(curves)
    # Sorted, so that the legend has the order of the lines' ends.
    for name, curve in sorted(curves.items(), key=lambda item: -item[1][-1]):
        seconds = period * np.arange(1, len(curve) + 1)
        look = {"color": colours[name], "linestyle": styles[name], "linewidth": 1.6}
        axes.plot(seconds, curve, label=name, marker="o", markersize=2.5, **look)
    axes.set(xlim=(0, None), ylim=(0, None))
