"""Figures of forecasts as probabilities: calibration, occupancy of the floor, anchors."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neurosym_jax.plotting import style
from neurosym_jax.plotting.forecasts import draw_paths

__all__ = ["plot_anchors", "plot_calibration", "plot_occupancy"]

REACH, CELL = 0.3, 0.1
"""Radius of a person, and size of a cell of the floor, metres."""


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
    style.add_legend(figure, axes)
    return figure


def plot_occupancy(
    observed: ArrayLike, samples: ArrayLike, probability: ArrayLike | None = None
) -> Figure:
    """Probability that somebody will be within 0.3 m of a place, as a heat map on the floor.

    Args:
        observed: [N, obs_len, 2] metres, drawn as paths.
        samples: [k, N, T, 2] metres.
        probability: [k] of the samples; default: all have the same.
    """
    past, paths = np.asarray(observed, float), np.asarray(samples, float)
    weight = np.full(len(paths), 1 / len(paths)) if probability is None else np.asarray(probability)
    low, high = paths.min(axis=(0, 1, 2)) - 2 * REACH, paths.max(axis=(0, 1, 2)) + 2 * REACH
    x, y = (np.arange(*ends, CELL) for ends in zip(low, high))
    share = np.zeros((len(y), len(x)))
    for sample, likely in zip(paths.reshape(len(paths), -1, 2), weight):
        square = (x - sample[:, :1])[:, None] ** 2 + ((y - sample[:, 1:]) ** 2)[..., None]
        share += likely * (square <= REACH**2).any(axis=0)
    figure, ((axes,),) = style.new_figure(style.COLUMN, 2.8)
    look = {"cmap": style.SEQUENTIAL, "vmin": 0, "vmax": 1, "rasterized": True, "zorder": 2}
    floor = axes.pcolormesh(x, y, np.ma.masked_less(share, 0.005), **look)
    draw_paths(axes, past, color=style.INK, linewidth=1.0, zorder=3)
    axes.plot(*past[:, -1].T, "o", color=style.INK, markersize=3, zorder=3)
    style.dress_floor(axes)
    style.colour_bar(figure, floor, axes, "probability that somebody comes by")
    return figure


def plot_anchors(observed: ArrayLike, samples: ArrayLike, probability: ArrayLike) -> Figure:
    """Samples of a scene coloured by probability, and the probabilities as bars, largest first.

    Args:
        observed: [N, obs_len, 2] metres.
        samples: [k, N, T, 2] metres.
        probability: [k] of the samples.
    """
    past, share = np.asarray(observed, float), np.asarray(probability, float)
    order = share.argsort(kind="stable")
    colours = style.SEQUENTIAL(share[order] / share.max())
    figure, ((where, bars),) = style.new_figure(style.WIDTH, 2.9, 1, 2, width_ratios=(1.7, 1))
    draw_paths(where, past, color=style.INK, linewidth=1.0)
    for sample, colour in zip(np.asarray(samples, float)[order], colours):
        draw_paths(where, sample, past, color=colour, linewidth=1.2)
    style.dress_floor(where)
    bars.bar(range(len(share), 0, -1), share[order], color=colours)
    even = {"linewidth": 0.8, "linestyle": "--", "label": "all the same"}
    bars.axhline(1 / len(share), color=style.INK, **even)
    style.dress(bars, "sample, by rank", "probability")
    style.add_legend(figure, bars)
    return figure
