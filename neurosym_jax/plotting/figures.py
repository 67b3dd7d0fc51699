"""Figures from plain arrays: forecasts, fans of samples, errors over the horizon, training curves.

Every function is pure, numpy arrays in and a `matplotlib.figure.Figure` out: neither `pyplot` nor
`rcParams` is touched, so they work without a display and from several threads at once. This module
knows nothing of models, scenes or metrics; the package imports it only when a figure is wanted.
"""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator, MultipleLocator
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.plotting.palette import PALETTE

__all__ = [
    "line_styles",
    "plot_fan",
    "plot_forecasts",
    "plot_horizon_errors",
    "plot_training",
    "save_figure",
]

LineStyle = str | tuple[float, tuple[float, ...]]
Curve = tuple[Sequence[float], Sequence[float]]

# The sizes (points) suit a projector.
_INK, _GREY, _AXIS, _GRID = "#222222", "#666666", "#BBBBBB", "#E4E4E4"
_TITLE, _LABEL, _TICK = 16, 14, 12

# The styles of the robot paper. The order matters: a NeuroSyM may also be called an SGAN.
_KINDS = {"neurosym": ":", "sgan": "-.", "constant": "--", "cv": "--", "linear": "--"}
_OTHERS = (0, (6, 1, 1, 1, 1, 1)), (0, (8, 3)), (0, (1, 3)), (0, (2, 1)), (0, (6, 1, 2, 1))


def line_styles(names: Iterable[str]) -> dict[str, LineStyle]:
    """The line style of each model: NeuroSyM dotted, SGAN dash-dotted, constant velocity dashed.

    Another kind, or a second model of one kind, takes the next style of a cycle of five.
    """
    styles: dict[str, LineStyle] = {}
    others = cycle(_OTHERS)
    for name in names:
        style = next((style for kind, style in _KINDS.items() if kind in name.lower()), None)
        styles[name] = next(others) if style is None or style in styles.values() else style
    return styles


def plot_forecasts(
    observed: ArrayLike,
    truth: ArrayLike | None,
    forecasts: Mapping[str, ArrayLike],
    title: str | None = None,
    origin_labels: Sequence[str] | None = None,
) -> Figure:
    """One scene with the forecasts of several models: a colour an agent, a line style a model.

    `observed` is [N, obs_len, 2], `truth` [N, pred_len, 2] or None where it is not known, and
    `forecasts` maps a model's name to [N, pred_len, 2] and may be empty: all metres in one frame.
    `origin_labels` are N short texts, such as ids, set beside the agents' first positions.
    InputError for a wrong shape or a coordinate that is not finite.
    """
    past, future, shape = _past_and_future(observed, truth)
    paths = {}
    for name, forecast in forecasts.items():
        paths[name] = _checked(f"forecast {name!r}", forecast, shape)
        shape = paths[name].shape
    if origin_labels is not None and len(origin_labels) != len(past):
        raise InputError(f"origin_labels has {len(origin_labels)} texts for {len(past)} agents")

    figure, axes, weight = _map(title, past, future, *paths.values())
    for name, style in line_styles(paths).items():
        look = {"linestyle": style, "linewidth": 2.3 * weight, "zorder": 4, "label": name}
        _draw(axes, paths[name], past, **look)
    # Behind an agent's back its own trajectory does not run through the text; above, if it stands.
    behind = past[:, 0] - past[:, -1] + [0, 0.02]
    behind *= 12 / (np.linalg.norm(behind, axis=1, keepdims=True) + 1e-9)
    place = {"textcoords": "offset points", "ha": "center", "va": "center", "zorder": 6}
    for agent, text in enumerate(origin_labels or ()):
        look = {"color": PALETTE[agent % len(PALETTE)], "fontsize": _TICK * weight}
        axes.annotate(_words(text), past[agent, 0], behind[agent], **place, **look)
    _add_legend(axes, figure)
    return figure


def plot_fan(
    observed: ArrayLike, truth: ArrayLike | None, samples: ArrayLike, title: str | None = None
) -> Figure:
    """One scene with k sampled futures, of which the nearest to the truth is emphasised.

    That is the sample of least joint ADE, one for the whole scene; without truth it is the mean.
    `observed` is [N, obs_len, 2], `truth` [N, pred_len, 2] or None, and `samples`
    [k, N, pred_len, 2], all metres in one frame. InputError as for `plot_forecasts`.
    """
    past, future, shape = _past_and_future(observed, truth)
    fan = _checked("samples", samples, (None, *shape))
    best, name = fan.mean(axis=0), f"mean of {len(fan)}"
    if future is not None:
        errors = np.linalg.norm(fan - future, axis=-1).mean(axis=(1, 2))
        # No-break spaces keep the number with its unit where the legend wraps the text.
        name = f"best of {len(fan)}, joint\xa0ADE\xa0{errors.min():.2f}\xa0m"
        best = fan[errors.argmin()]

    figure, axes, weight = _map(title, past, future, fan)
    look = {"linewidth": 0.9 * weight, "alpha": 0.4, "zorder": 1.8, "label": "samples"}
    for sample in fan:
        _draw(axes, sample, past, **look)
    _draw(axes, best, past, linewidth=2.4 * weight, zorder=4, label=name)
    _add_legend(axes, figure)
    return figure


def plot_horizon_errors(
    errors: Mapping[str, ArrayLike], period: float = 0.4, title: str | None = None
) -> Figure:
    """Mean displacement error against the horizon, one line a model, the worst first in the legend.

    `errors` maps a model's name to [pred_len] metres; its first step lies one `period` (seconds)
    after the last observation. InputError for no model, a wrong shape or a value not finite.
    """
    if not errors or not period > 0:
        raise InputError("errors need at least one model and a period of more than 0 seconds")
    curves = {name: _checked(f"errors {name!r}", curve, (None,)) for name, curve in errors.items()}
    figure, (axes,) = _figure(10, 5.6)
    lines = zip(curves.items(), line_styles(curves).values(), cycle(PALETTE))
    # In this order the legend runs from top to bottom as the ends of the lines do.
    for (name, curve), style, colour in sorted(lines, key=lambda line: -line[0][1][-1]):
        look = {"linestyle": style, "linewidth": 2.6, "marker": "o", "markersize": 4}
        seconds = period * np.arange(1, len(curve) + 1)
        axes.plot(seconds, curve, color=colour, label=name, **look)
    axes.set(xlim=(0, None), ylim=(0, None))
    _dress(axes, "horizon [s]", "mean displacement error [m]", title)
    _add_legend(axes)
    return figure


def plot_training(
    losses: Mapping[str, Curve], validation: Mapping[str, Curve], title: str | None = None
) -> Figure:
    """Training runs: losses in the upper panel, validation errors (metres) in the lower.

    Both map a name to (steps, values), and a panel without curves is left out. Of more than 100
    points the running mean over 1/20 is drawn, the points themselves pale. Values that are not
    finite leave a gap. InputError for nothing to plot or unequal lengths.
    """
    panels = {"loss": losses, "validation error [m]": validation}
    panels = {label: curves for label, curves in panels.items() if curves}
    if not panels:
        raise InputError("there is neither a loss nor a validation curve to plot")
    figure, rows = _figure(10, 1.0 + 3.2 * len(panels), len(panels))
    for axes, (label, curves) in zip(rows, panels.items()):
        for (name, curve), colour in zip(curves.items(), cycle(PALETTE)):
            steps, values = (np.asarray(numbers, np.float64) for numbers in curve)
            if steps.ndim != 1 or steps.shape != values.shape:
                raise InputError(f"{name!r}: steps and values are not two lists of one length")
            if len(steps) > 100:
                axes.plot(steps, values, color=colour, linewidth=0.8, alpha=0.3)
                half = len(steps) // 40
                values = np.convolve(values, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid")
                steps = steps[half:-half]
            look = {"linewidth": 2.2, "marker": "o", "markersize": 4 if len(steps) <= 40 else 0}
            axes.plot(steps, values, color=colour, label=name, **look)
        _dress(axes, "step" if axes is rows[-1] else "", label, title if axes is rows[0] else None)
        _add_legend(axes)
    return figure


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write a PNG of 150 dots per inch to `path`, creating its folders; InputError if no .png."""
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise InputError(f"{path}: figures are written as PNG, so the name must end in .png")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150, format="png", facecolor="white")
    return path


def _checked(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> np.ndarray:
    """`values` in float64, refused unless finite, not empty and of `shape` (None fits any)."""
    array = np.asarray(values, np.float64)
    fits = array.ndim == len(shape) and all(n in (m, None) for m, n in zip(array.shape, shape))
    if not fits or array.size == 0:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name} must be [{wanted}] and not empty, not {list(array.shape)}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds a value that is not finite")
    return array


def _past_and_future(observed: ArrayLike, truth: ArrayLike | None):
    """Both checked, and the shape that any forecast of them must have."""
    past = _checked("observed", observed, (None, None, 2))
    future = None if truth is None else _checked("truth", truth, (len(past), None, 2))
    return past, future, (len(past), None, 2) if future is None else future.shape


def _draw(axes: Axes, lines: np.ndarray, past: np.ndarray | None = None, **look) -> None:
    """A line for each agent of `lines` [N, T, 2] in the agent's colour, from the end of `past`."""
    if past is not None:
        lines = np.concatenate([past[:, -1:], lines], axis=1)
    for line, colour in zip(lines, cycle(PALETTE)):
        axes.plot(*line.T, color=colour, **look)


def _map(title: str | None, past: np.ndarray, future: np.ndarray | None, *others: np.ndarray):
    """A map of what happened, large enough for the others: figure, axes, weight of the lines."""
    arrays = [array.reshape(-1, 2) for array in (past, future, *others) if array is not None]
    low, high = np.concatenate(arrays).min(axis=0), np.concatenate(arrays).max(axis=0)
    # At least 3 m are shown, so that the tremor of a standing agent does not look like a walk, and
    # neither a corridor nor a row of agents makes a sliver of a figure.
    extent = np.maximum(1.1 * (high - low) + 0.3, 3.0)
    extent = np.maximum(extent, [extent[1], 0.45 * extent[0]])
    figure, (axes,) = _figure(11, 7.6 * extent[1] / extent[0] + 1.2)
    (left, bottom), (right, top) = (low + high - extent) / 2, (low + high + extent) / 2
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    ticks = MaxNLocator(10, steps=[1, 2, 5, 10]).tick_values(0, extent.max())
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(ticks[1] - ticks[0]))
    axes.ticklabel_format(useOffset=False, style="plain")
    _dress(axes, "x [m]", "y [m]", title)

    weight = float(np.clip((10 / len(past)) ** 0.5, 0.65, 1.0))
    circle = {"marker": "o", "markersize": 6 * weight + 0.5, "markerfacecolor": "white"}
    circle |= {"markeredgewidth": 1.4 * weight, "linestyle": "none", "zorder": 5}
    _draw(axes, past[:, :1], **circle, label="start")
    _draw(axes, past, linewidth=1.3 * weight, zorder=3, label="observed")
    if future is not None:
        # Pale and broad, so that a forecast of the same colour on it can still be seen.
        band = {"linewidth": 6 * weight, "alpha": 0.35, "solid_capstyle": "round", "zorder": 2}
        _draw(axes, future, past, **band, label="ground truth")
    return figure, axes, weight


def _words(text: str, width: int = 26) -> str:
    """Text in lines of at most `width` characters, in which a dollar sign is not mathematics."""
    return textwrap.fill(str(text), width).replace("$", r"\$")


def _figure(width: float, height: float, rows: int = 1) -> tuple[Figure, np.ndarray]:
    layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.12, compress=True)
    figure = Figure(figsize=(width, height), layout=layout, facecolor="white")
    return figure, figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]


def _dress(axes: Axes, x_label: str, y_label: str, title: str | None) -> None:
    axes.set_xlabel(x_label, fontsize=_LABEL, color=_INK)
    axes.set_ylabel(y_label, fontsize=_LABEL, color=_INK)
    axes.set_title(_words(title or "", 48), fontsize=_TITLE, color=_INK, loc="left", pad=12)
    axes.grid(color=_GRID, linewidth=0.8)
    axes.tick_params(labelsize=_TICK, colors=_GREY, length=0, pad=7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(_AXIS)


def _add_legend(axes: Axes, figure: Figure | None = None) -> None:
    """A legend of the distinct labels to the right of the axes; a map's is grey, on its figure."""
    handles = {label: handle for handle, label in zip(*axes.get_legend_handles_labels())}
    entries = list(handles.values()), [_words(label) for label in handles]
    look = {"frameon": False, "fontsize": _LABEL, "labelcolor": _INK, "handlelength": 3.0}
    if figure is None:
        axes.legend(*entries, loc="upper left", bbox_to_anchor=(1.01, 1.02), **look)
        return
    # An equal aspect moves the axes after the layout, and a legend that hung on them with it.
    legend = figure.legend(*entries, loc="outside right upper", labelspacing=0.7, **look)
    for line in legend.get_lines():
        line.set_color(_GREY)
