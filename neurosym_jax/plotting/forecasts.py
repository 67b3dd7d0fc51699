"""A scene from above with forecasts of models, and models' errors against the horizon.

Observed paths are dark, the true future is a broad green band, a model has its own colour and line.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neurosym_jax.plotting import style

__all__ = ["draw_horizon", "draw_paths", "draw_scene"]
__all__ += ["plot_event_errors", "plot_forecasts", "plot_horizon_errors"]


def plot_forecasts(
    observed: ArrayLike,
    truth: ArrayLike | None,
    forecasts: Mapping[str, ArrayLike],
    title: str | None = None,
) -> Figure:
    """One scene with the forecasts of several models.

    Args:
        observed: [N, obs_len, 2] metres.
        truth: [N, pred_len, 2] metres, or None if unknown.
        forecasts: [N, pred_len, 2] metres by the model's name; or [k, N, pred_len, 2], of which the
            sample of least joint ADE is drawn (without truth the mean), and all of the last model.
        title: of the figure.
    """
    past = np.asarray(observed, float)
    future = None if truth is None else np.asarray(truth, float)
    samples = {name: np.asarray(of, float) for name, of in forecasts.items()}
    arrays = [array for array in (past, future, *samples.values()) if array is not None]
    points = np.concatenate([array.reshape(-1, 2) for array in arrays])
    low, high = points.min(axis=0), points.max(axis=0)
    # At least 3 m, so that the tremor of a standing agent does not look like a walk; and neither a
    # corridor nor a row of agents makes a sliver of a figure.
    extent = np.maximum(1.06 * (high - low) + 0.3, 3.0)
    extent = np.maximum(extent, [0.75 * extent[1], 0.36 * extent[0]])
    # High figures go into one column.
    width = style.WIDTH if extent[1] < 0.7 * extent[0] else style.COLUMN
    height = (width - 0.5) * extent[1] / extent[0] + (0.85 if title else 0.55)
    figure, ((axes,),) = style.new_figure(width, height)
    (left, bottom), (right, top) = (low + high - extent) / 2, (low + high + extent) / 2
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.ticklabel_format(useOffset=False, style="plain")
    style.dress(axes, "x [m]", "y [m]", title)
    draw_scene(axes, past, future, samples)
    style.add_legend(figure, axes)
    return figure


def draw_scene(
    axes: Axes, past: np.ndarray, future: np.ndarray | None, samples: Mapping[str, np.ndarray]
) -> None:
    """Draw `past` [N, obs_len, 2], `future` [N, pred_len, 2] and samples, see `plot_forecasts`."""
    # Thinner lines for many people.
    weight = float(np.clip((10 / len(past)) ** 0.5, 0.65, 1.0))
    circle = {"marker": "o", "markersize": 4 * weight, "markerfacecolor": "white"}
    circle |= {"markeredgewidth": 0.9 * weight, "linestyle": "none", "zorder": 5}
    draw_paths(axes, past[:, :1], **circle, color=style.INK, label="start")
    draw_paths(axes, past, color=style.INK, linewidth=1.0 * weight, zorder=3, label="observed")
    if future is not None:
        # Pale and broad, so that a forecast on it can be seen.
        band = {"linewidth": 4.5 * weight, "alpha": 0.35, "solid_capstyle": "round", "zorder": 2}
        draw_paths(axes, future, past, **band, color=style.TRUTH, label="ground truth")
    for name, look in style.model_looks(samples).items():
        path, label = samples[name], name
        if path.ndim == 4:
            if name == list(samples)[-1]:
                faint = {"linewidth": 0.5, "alpha": 0.35, "zorder": 2.5, "color": look["color"]}
                for sample in path:
                    draw_paths(axes, sample, past, **faint)
            kind = "mean" if future is None else "best"
            label = f"{name}, {kind} of {len(path)}" if len(path) > 1 else f"{name}, one guess"
            if future is None:
                path = path.mean(axis=0)
            else:  # The sample of least joint ADE.
                error = np.linalg.norm(path - future, axis=-1)
                path = path[error.mean(axis=(1, 2)).argmin()]
        draw_paths(axes, path, past, **look, linewidth=1.5 * weight, zorder=4, label=label)


def draw_paths(axes: Axes, lines: np.ndarray, past: np.ndarray | None = None, **look) -> None:
    """Draw a line for each agent of `lines` [N, T, 2], from the end of `past`."""
    if past is not None:
        lines = np.concatenate([past[:, -1:], lines], axis=1)
    for line in lines:
        axes.plot(*line.T, **look)


def plot_horizon_errors(
    errors: Mapping[str, ArrayLike],
    period: float = 0.4,
    title: str | None = None,
    label: str = "mean displacement error [m]",
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
    style.add_legend(figure, axes)
    return figure


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
    style.add_legend(figure, axes)
    return figure
