"""Forecasts on the floor: a scene from above.

Each person has a colour: the observed path is a thin line, the true future a broad
band. The forecasts of one model have these colours, too; of several, each model has its
own colour and line.
"""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neurosym_jax.plotting import style

__all__ = ["draw_paths", "draw_scene", "plot_forecasts"]


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
        forecasts: [N, pred_len, 2] metres by the model's name; or [k, N, pred_len, 2],
            of which the sample of least joint ADE is drawn (without truth the mean),
            and all of the last model.
        title: of the figure.
    """
    past = np.asarray(observed, float)
    future = None if truth is None else np.asarray(truth, float)
    samples = {
        name: np.asarray(forecast, float) for name, forecast in forecasts.items()
    }
    arrays = [past, *samples.values()]
    if future is not None:
        arrays.append(future)
    points = np.concatenate([array.reshape(-1, 2) for array in arrays])
    low = points.min(axis=0)
    high = points.max(axis=0)
    # At least 3 m, so that the tremor of a standing agent does not look like a walk;
    # and neither a corridor nor a row of agents makes a sliver of a figure.
    x, y = np.maximum(1.06 * (high - low) + 0.3, 3.0)
    extent = np.maximum([x, y], [0.75 * y, 0.36 * x])
    x, y = extent
    # High figures go into one column.
    width = style.WIDTH if y < 0.7 * x else style.COLUMN
    labels = 0.85 if title else 0.55
    height = (width - 0.5) * y / x + labels
    figure, ((axes,),) = style.new_figure(width, height)
    left, bottom = (low + high - extent) / 2
    right, top = (low + high + extent) / 2
    style.dress_floor(axes, title)
    axes.set_aspect("equal", adjustable="box")
    axes.set(xlim=(left, right), ylim=(bottom, top))
    draw_scene(axes, past, future, samples)
    return style.add_legend(figure, axes)


def draw_scene(
    axes: Axes,
    past: np.ndarray,
    future: np.ndarray | None,
    samples: Mapping[str, np.ndarray],
) -> None:
    """Draw `past` [N, obs_len, 2], `future` [N, pred_len, 2] and samples, see `plot_forecasts`."""
    # Thinner lines for many people.
    share = 10 / len(past)
    weight = float(np.clip(share**0.5, 0.65, 1.0))
    _draw_people(
        axes,
        past[:, :1],
        label="start",
        marker="o",
        markersize=4 * weight,
        markerfacecolor="white",
        markeredgewidth=0.9 * weight,
        linestyle="none",
        zorder=5,
    )
    _draw_people(axes, past, label="observed", linewidth=1.0 * weight, zorder=3)
    if future is not None:
        # Pale and broad, so that a forecast on it can be seen.
        _draw_people(
            axes,
            future,
            past,
            label="ground truth",
            linewidth=4.5 * weight,
            alpha=0.35,
            solid_capstyle="round",
            zorder=2,
        )
    for name, look in style.model_looks(samples).items():
        # Where models are compared, a colour is a model's.
        draw = draw_paths if len(samples) > 1 else _draw_people
        path = samples[name]
        if path.ndim == 4 and name == list(samples)[-1]:
            for sample in path:
                draw(
                    axes,
                    sample,
                    past,
                    label=f"{name}, all {len(path)}",
                    color=look["color"],
                    linewidth=0.5,
                    alpha=0.35,
                    zorder=2.5,
                )
        drawn, label = _one_sample(name, path, future)
        width = 1.5 * weight
        draw(axes, drawn, past, **look, linewidth=width, zorder=4, label=label)


def _one_sample(
    name: str, path: np.ndarray, future: np.ndarray | None
) -> tuple[np.ndarray, str]:
    """The sample of least joint ADE, without a truth the mean, and its label."""
    if path.ndim == 3:
        return path, name
    kind = "mean" if future is None else "best"
    label = f"{name}, {kind} of {len(path)}"
    if len(path) == 1:
        label = f"{name}, one guess"
    if future is None:
        return path.mean(axis=0), label
    error = np.linalg.norm(path - future, axis=-1)
    best = error.mean(axis=(1, 2)).argmin()
    return path[best], label


def _draw_people(
    axes: Axes, lines: np.ndarray, past: np.ndarray | None = None, **look
) -> None:
    """`draw_paths` with a colour for each person; the legend's line is dark."""
    legend = axes.plot([], [], **look)[0]
    legend.set_color(style.INK)
    for place, colour in enumerate(style.PALETTE[: len(lines)]):
        people = slice(place, None, len(style.PALETTE))
        begins = None if past is None else past[people]
        draw_paths(axes, lines[people], begins, **look | {"color": colour})


def draw_paths(
    axes: Axes, lines: np.ndarray, past: np.ndarray | None = None, **look
) -> None:
    """Draw a line for each agent of `lines` [N, T, 2], from the end of `past`."""
    if past is not None:
        lines = np.concatenate([past[:, -1:], lines], axis=1)
    # One artist with gaps: with one a person, a figure takes twice as long.
    after = [(0, 0), (0, 1), (0, 0)]
    gaps = np.pad(lines, after, constant_values=np.nan)
    x, y = gaps.reshape(-1, 2).T
    axes.plot(x, y, **look)
