"""A scene from above: observed paths, the true future, and forecasts of models.

Observed paths are dark, the true future is a broad green band, a model has its own colour and line.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import ArrayLike

from neurosym_jax.plotting.palette import INK, TRUTH, line_styles, model_colours
from neurosym_jax.plotting.style import COLUMN, WIDTH, add_legend, checked, dress, new_figure

__all__ = ["best_sample", "draw_paths", "draw_scene", "plot_fan", "plot_forecasts"]


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
        forecasts: [N, pred_len, 2] metres by the model's name; may be empty.
        title: of the figure.

    Raises:
        InputError: for a wrong shape, or a coordinate that is not finite.
    """
    past, future, shape = _past_and_future(observed, truth)
    paths = {}
    for name, forecast in forecasts.items():
        paths[name] = checked(f"forecast {name!r}", forecast, shape)
        shape = paths[name].shape
    figure, axes, weight = _map(title, past, future, *paths.values())
    colours, styles = model_colours(paths), line_styles(paths)
    for name, path in paths.items():
        look = {"color": colours[name], "linestyle": styles[name], "zorder": 4, "label": name}
        draw_paths(axes, path, past, linewidth=1.5 * weight, **look)
    add_legend(figure, axes)
    return figure


def plot_fan(
    observed: ArrayLike,
    truth: ArrayLike | None,
    samples: ArrayLike,
    title: str | None = None,
) -> Figure:
    """One scene with k sampled futures; the sample of least joint ADE is emphasised.

    Without truth the mean is emphasised.

    Args:
        observed: [N, obs_len, 2] metres.
        truth: [N, pred_len, 2] metres, or None if unknown.
        samples: [k, N, pred_len, 2] metres.
        title: of the figure; a model's name in it decides the colour.

    Raises:
        InputError: for a wrong shape, or a coordinate that is not finite.
    """
    past, future, shape = _past_and_future(observed, truth)
    fan = checked("samples", samples, (None, *shape))
    best, name = fan.mean(axis=0), f"mean of {len(fan)}"
    if future is not None:
        best = best_sample(fan, future)
        error = np.linalg.norm(best - future, axis=-1).mean()
        # No-break spaces keep the number with its unit where the legend wraps the text.
        name = f"best of {len(fan)}, joint\xa0ADE\xa0{error:.2f}\xa0m"
    figure, axes, weight = _map(title, past, future, fan)
    (colour,) = model_colours([title or ""]).values()
    look = {"color": colour, "linewidth": 0.5 * weight, "alpha": 0.4, "zorder": 2.5}
    for sample in fan:
        draw_paths(axes, sample, past, label="samples", **look)
    draw_paths(axes, best, past, color=colour, linewidth=1.6 * weight, zorder=4, label=name)
    add_legend(figure, axes)
    return figure


def best_sample(samples: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """[N, pred_len, 2] the one of `samples [k, N, pred_len, 2]` with least joint ADE."""
    return samples[np.linalg.norm(samples - truth, axis=-1).mean(axis=(1, 2)).argmin()]


def _past_and_future(
    observed: ArrayLike, truth: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray | None, tuple]:
    """Both checked, and the shape that their forecasts must have."""
    past = checked("observed", observed, (None, None, 2))
    future = None if truth is None else checked("truth", truth, (len(past), None, 2))
    return past, future, (len(past), None, 2) if future is None else future.shape


def draw_paths(axes: Axes, lines: np.ndarray, past: np.ndarray | None = None, **look) -> None:
    """Draw a line for each agent of `lines` [N, T, 2], from the end of `past`."""
    if past is not None:
        lines = np.concatenate([past[:, -1:], lines], axis=1)
    for line in lines:
        axes.plot(*line.T, **look)


def _map(title: str | None, past: np.ndarray, future: np.ndarray | None, *others: np.ndarray):
    """A scene in a frame large enough for the others: figure, axes, weight of its lines."""
    arrays = [array.reshape(-1, 2) for array in (past, future, *others) if array is not None]
    low, high = np.concatenate(arrays).min(axis=0), np.concatenate(arrays).max(axis=0)
    # At least 3 m, so that the tremor of a standing agent does not look like a walk; and neither a
    # corridor nor a row of agents makes a sliver of a figure.
    extent = np.maximum(1.06 * (high - low) + 0.3, 3.0)
    extent = np.maximum(extent, [0.75 * extent[1], 0.36 * extent[0]])
    # High figures go into one column.
    width = WIDTH if extent[1] < 0.7 * extent[0] else COLUMN
    figure, ((axes,),) = new_figure(width, (width - 0.5) * extent[1] / extent[0] + 0.85)
    (left, bottom), (right, top) = (low + high - extent) / 2, (low + high + extent) / 2
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    ticks = MaxNLocator(10, steps=[1, 2, 5, 10]).tick_values(0, extent.max())
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(ticks[1] - ticks[0]))
    axes.ticklabel_format(useOffset=False, style="plain")
    dress(axes, "x [m]", "y [m]", title)
    return figure, axes, draw_scene(axes, past, future)


def draw_scene(axes: Axes, past: np.ndarray, future: np.ndarray | None) -> float:
    """Draw the observed paths `[N, obs_len, 2]` and the true future `[N, pred_len, 2]`.

    Returns:
        The weight of lines: 1 for few people and less for many.
    """
    weight = float(np.clip((10 / len(past)) ** 0.5, 0.65, 1.0))
    circle = {"marker": "o", "markersize": 4 * weight, "markerfacecolor": "white"}
    circle |= {"markeredgewidth": 0.9 * weight, "linestyle": "none", "zorder": 5}
    draw_paths(axes, past[:, :1], **circle, color=INK, label="start")
    draw_paths(axes, past, color=INK, linewidth=1.0 * weight, zorder=3, label="observed")
    if future is not None:
        # Pale and broad, so that a forecast on it can be seen.
        band = {"linewidth": 4.5 * weight, "alpha": 0.35, "solid_capstyle": "round", "zorder": 2}
        draw_paths(axes, future, past, **band, color=TRUTH, label="ground truth")
    return weight
