"""A scene's pairs over time: their symbols and weights."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from neurosym_jax.plotting.forecasts import draw_paths
from neurosym_jax.plotting.style import (
    COLUMN,
    INK,
    LABEL,
    PALETTE,
    SEQUENTIAL,
    SMALL,
    WIDTH,
    colour_bar,
    dress,
    new_figure,
)
from neurosym_jax.symbolic.description import ScenePairs, state_texts

__all__ = ["plot_alpha", "plot_pairs"]

PAIRS = 12
"""Pairs that fit a heat map with their states."""
PALE = LinearSegmentedColormap.from_list("pale", colormaps["Blues"](np.linspace(0, 0.6, 64)))
"""Pale enough for dark letters."""
LETTERS: dict[str, Any] = {"family": "DejaVu Sans Mono", "color": INK, "ha": "center"}
"""Of one width, so that QTC states align."""
BESIDE: dict[str, Any] = {"textcoords": "offset points", "fontsize": LABEL}
"""A name beside a person."""


def plot_pairs(pairs: ScenePairs, title: str) -> Figure:
    """A scene's paths beside alpha of its pairs over time, with the QTC_C1 states written in.

    Where alpha is the same both ways, a pair has one row; the first 12 rows are shown.
    """
    people, alpha, texts = pairs.people, pairs.alpha, state_texts()
    count, steps = len(people), alpha.shape[-1]
    both_ways = not np.allclose(alpha, alpha.swapaxes(0, 1))
    rows = [(i, j) for i in range(count) for j in range(count) if i != j and (both_ways or i < j)]
    rows = rows[:PAIRS]
    height = max(2.2, 0.8 + 0.19 * len(rows))
    figure, ((where, when),) = new_figure(WIDTH, height, 1, 2, width_ratios=(1, 2.7))
    for path, person, colour in zip(pairs.position, people, PALETTE * count):
        draw_paths(where, path[None], color=colour, lw=1.2)
        draw_paths(where, path[None, -1:], color=colour, marker="o", ms=4)
        where.annotate(f"{person}", path[-1], (4, 4), **BESIDE, color=colour)
    where.set_aspect("equal", adjustable="datalim")
    where.margins(0.15)
    dress(where, "x [m]", "y [m]", "paths, a dot at the end")
    values = np.array([alpha[row] for row in rows])
    highest = values.max() if values.size and values.max() > 0 else 1.0
    # Learned weights may be negative.
    lowest = min(0.0, values.min(initial=0.0))
    image = when.imshow(values, aspect="auto", cmap=PALE, vmin=lowest, vmax=highest)
    image.set_visible(not pairs.constant)  # One colour would show nothing: the title says so.
    # A letter is 0.6 of its size wide; four and a margin fit into a step.
    size = min(SMALL, 0.58 * figure.get_figwidth() * 72 / steps / 3)
    for place, row in enumerate(rows):
        for step, code in enumerate(pairs.codes[row], 1):
            when.text(step, place, texts[code], fontsize=size, va="center", **LETTERS)
    arrow = "→" if both_ways else "–"
    when.set_yticks(range(len(rows)), [f"{people[i]} {arrow} {people[j]}" for i, j in rows])
    ticks = range(0, steps, 2)
    when.set_xticks(ticks, [f"{pairs.period * step:.1f}" for step in ticks])
    when.grid(visible=False)
    dress(when, "time [s]", "", f"alpha and QTC state: {title}")
    if not pairs.constant:
        colour_bar(figure, image, when, "alpha")
    return figure


def plot_alpha(observed: ArrayLike, alpha: ArrayLike) -> Figure:
    """Weights of pairs on a still scene: arrows from each person to those who count for them.

    Weights below a tenth of the largest one have no arrow; the arrows of both ways lie apart.

    Args:
        observed: [N, obs_len, 2] metres.
        alpha: [N, N] the weight of j for i: alpha, or an attention's.
    """
    past, share = np.asarray(observed, float), np.abs(np.asarray(alpha, float))
    share = np.where(np.eye(len(share), dtype=bool), 0, share)
    largest = share.max() or 1.0
    share /= largest
    figure, ((axes,),) = new_figure(COLUMN, 3.0)
    draw_paths(axes, past[:, -3:], color=INK, lw=1.2)
    last = past[:, -1]
    axes.plot(*last.T, "o", color=INK, ms=4, zorder=4)
    for person, place in enumerate(last):
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}
        axes.annotate(f"{person}", place, (5, 4), zorder=5, **BESIDE, color=INK, bbox=box)
    for flat in share.argsort(axis=None, kind="stable"):  # The largest on top.
        i, j = np.unravel_index(flat, share.shape)
        if share[i, j] >= 0.1:
            look = {"arrowstyle": "-|>", "connectionstyle": "arc3,rad=0.15", "shrinkA": 4}
            look |= {"color": SEQUENTIAL(share[i, j]), "lw": 0.4 + 1.8 * share[i, j], "shrinkB": 4}
            axes.annotate("", last[j], last[i], arrowprops=look)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    dress(axes, "x [m]", "y [m]")
    colour_bar(figure, ScalarMappable(Normalize(0, largest), SEQUENTIAL), axes, "weight")
    return figure
