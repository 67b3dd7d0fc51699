"""Curves: errors by horizon, and training runs."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neurosym_jax.plotting import style

__all__ = ["draw_horizon", "plot_horizon_errors", "plot_training"]

Curve = tuple[Sequence[float], Sequence[float]]
"""Steps and values."""


def plot_horizon_errors(
    errors: Mapping[str, ArrayLike],
    period: float = 0.4,
    title: str | None = None,
    label: str = "mean error [m]",
) -> Figure:
    """A mean error against the horizon, one line a model, the largest first in the legend.

    Args:
        errors: [pred_len] by the model's name; or [3, pred_len] with the bounds of an
            interval, low and high, which is drawn as a band.
        period: seconds from the last observation to the first step, and between steps.
        title: of the figure.
        label: name of the error, with its unit.
    """
    figure, ((axes,),) = style.new_figure(style.COLUMN, 2.2)
    draw_horizon(axes, errors, period)
    style.dress(axes, "horizon [s]", label, title)
    return style.add_legend(figure, axes)


def draw_horizon(axes: Axes, errors: Mapping[str, ArrayLike], period: float) -> None:
    """Draw a line [pred_len] and a band for each model against seconds."""
    looks = style.model_looks(errors)
    curves = {}
    for name, curve in errors.items():
        curves[name] = np.atleast_2d(np.asarray(curve, float))
    # Sorted, so that the legend has the order of the lines' ends.
    for name in sorted(curves, key=lambda name: -curves[name][0, -1]):
        curve, *bounds = curves[name]
        seconds = period * np.arange(1, len(curve) + 1)
        look = looks[name]
        dots = {"linewidth": 1.6, "marker": "o", "markersize": 2.5}
        axes.plot(seconds, curve, label=name, **dots, **look)
        if bounds:
            shade = {"color": look["color"], "alpha": 0.2, "linewidth": 0}
            axes.fill_between(seconds, *bounds, **shade)
    axes.set(xlim=(0, None), ylim=(0, None))


def _draw_run(axes: Axes, name: str, curve: Curve, colour: str) -> None:
    """Draw a curve of a run; of many points their running mean over the points, pale."""
    steps = np.asarray(curve[0], np.float64)
    values = np.asarray(curve[1], np.float64)
    if len(steps) > 100:
        axes.plot(steps, values, color=colour, linewidth=0.5, alpha=0.3)
        half = len(steps) // 40
        width = 2 * half + 1
        values = np.convolve(values, np.full(width, 1 / width), "valid")
        steps = steps[half:-half]
    size = 2.5 if len(steps) <= 40 else 0
    dots = {"linewidth": 1.4, "marker": "o", "markersize": size}
    axes.plot(steps, values, color=colour, label=name, **dots)


GOOD = """\
Dotted: the state that is kept, step {}. Good: both fall, then level off. Errors
that rise while the loss falls: too long, or too few data. Both still falling at
the end: more steps. Leaps: a smaller learning_rate."""
"""The caption of curves."""


def plot_training(
    losses: Mapping[str, Curve],
    validation: Mapping[str, Curve],
    title: str | None = None,
    best: int | None = None,
) -> Figure:
    """Training runs: losses in the upper panel, validation errors (metres) in the lower.

    Both map a name to (steps, values). `best` is the step whose state is kept; where it
    is given, a caption says what good curves look like. Beyond 100 points, the running
    mean over 1/20 is drawn over pale points. Values that are not finite leave a gap.
    """
    figure, ((upper,), (lower,)) = style.new_figure(style.COLUMN, 3.6, 2, sharex=True)
    colours = cycle(style.PALETTE)
    for axes, curves in ((upper, losses), (lower, validation)):
        for (name, curve), colour in zip(curves.items(), colours):
            _draw_run(axes, name, curve, colour)
    style.dress(upper, "", "loss", title)
    style.dress(lower, "step", "validation error [m]")
    if best is not None:
        lower.axvline(best, color="0.6", linewidth=0.8, linestyle=":")
        lower.set_xlabel(f"step\n{GOOD.format(best)}", fontsize="small")
    return style.add_legend(figure, upper, lower)
