"""Curves: errors by horizon and by event, calibration, and training runs."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neurosym_jax.plotting import style

__all__ = ["draw_horizon", "plot_calibration", "plot_event_errors", "plot_horizon_errors"]
__all__ += ["plot_training"]

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
        errors: [pred_len] by the model's name; or [3, pred_len] with the bounds of an interval,
            low and high, which is drawn as a band.
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
    curves = {name: np.atleast_2d(np.asarray(curve, float)) for name, curve in errors.items()}
    # Sorted, so that the legend has the order of the lines' ends.
    for name, (curve, *bounds) in sorted(curves.items(), key=lambda item: -item[1][0, -1]):
        seconds = period * np.arange(1, len(curve) + 1)
        look = {"linewidth": 1.6, "marker": "o", "markersize": 2.5, **looks[name]}
        axes.plot(seconds, curve, label=name, **look)
        if bounds:
            axes.fill_between(seconds, *bounds, color=looks[name]["color"], alpha=0.2, linewidth=0)
    axes.set(xlim=(0, None), ylim=(0, None))


def plot_event_errors(
    events: Sequence[str], errors: Mapping[str, ArrayLike], label: str = "joint ADE [m]"
) -> Figure:
    """Errors of models for the people to whom an event happens, a row an event.

    Args:
        events: E names, such as "overtaking (31 people)".
        errors: [E], or [3, E] with the bounds of an interval, by the model's name.
        label: name of the error, with its unit.
    """
    figure, ((axes,),) = style.new_figure(style.COLUMN, 0.7 + 0.3 * len(events))
    rows = np.arange(len(events))
    for number, (name, look) in enumerate(style.model_looks(errors).items()):
        mean, *bounds = np.atleast_2d(np.asarray(errors[name], float))
        place = rows + 0.16 * (number - (len(errors) - 1) / 2)
        if bounds:
            axes.hlines(place, *bounds, color=look["color"], linewidth=1.2)
        axes.plot(mean, place, "o", color=look["color"], markersize=3.5, label=name)
    axes.set_yticks(rows, events)
    axes.set(xlim=(0, None), ylim=(len(rows) - 0.5, -0.5))
    style.dress(axes, label)
    return style.add_legend(figure, axes)


def plot_calibration(nominal: ArrayLike, observed: Mapping[str, ArrayLike]) -> Figure:
    """Coverage that regions should have against the coverage that they have.

    A curve below the diagonal is overconfident, one above is too wide.

    Args:
        nominal: [L] shares of the truth that the regions should hold.
        observed: [L] shares that they hold, by the model's name.
    """
    figure, ((axes,),) = style.new_figure(style.COLUMN, style.COLUMN)
    axes.plot([0, 1], [0, 1], color=style.INK, linewidth=0.8, label="calibrated")
    for name, look in style.model_looks(observed).items():
        axes.plot(nominal, observed[name], label=name, linewidth=1.6, marker="o", ms=2.5, **look)
    axes.set(xlim=(0, 1), ylim=(0, 1), aspect="equal")
    style.dress(axes, "nominal coverage", "observed coverage")
    return style.add_legend(figure, axes)


def plot_training(
    losses: Mapping[str, Curve], validation: Mapping[str, Curve], title: str | None = None
) -> Figure:
    """Training runs: losses in the upper panel, validation errors (metres) in the lower.

    Both map a name to (steps, values). Beyond 100 points, the running mean over 1/20 is drawn over
    pale points. Values that are not finite leave a gap.
    """
    figure, ((upper,), (lower,)) = style.new_figure(style.COLUMN, 3.6, 2, sharex=True)
    colours = cycle(style.PALETTE)
    for axes, curves in ((upper, losses), (lower, validation)):
        for (name, curve), colour in zip(curves.items(), colours):
            steps, values = (np.asarray(numbers, np.float64) for numbers in curve)
            if len(steps) > 100:
                axes.plot(steps, values, color=colour, linewidth=0.5, alpha=0.3)
                half = len(steps) // 40
                values = np.convolve(values, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid")
                steps = steps[half:-half]
            look = {"linewidth": 1.4, "marker": "o", "markersize": 2.5 if len(steps) <= 40 else 0}
            axes.plot(steps, values, color=colour, label=name, **look)
    style.dress(upper, "", "loss", title)
    style.dress(lower, "step", "validation error [m]")
    return style.add_legend(figure, upper, lower)
