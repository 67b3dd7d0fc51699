"""A scene's pairs over time: their symbols and weights."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from neurosym_jax.plotting.forecasts import draw_paths
from neurosym_jax.plotting.style import INK, LABEL, PALETTE, SMALL, WIDTH, dress, new_figure
from neurosym_jax.symbolic.description import ScenePairs, state_texts

__all__ = ["plot_pairs"]

PAIRS = 12
"""Pairs that fit a heat map with their states."""
PALE = LinearSegmentedColormap.from_list("pale", colormaps["Blues"](np.linspace(0, 0.6, 64)))
"""Pale enough for dark letters."""
LETTERS: dict[str, Any] = {"family": "DejaVu Sans Mono", "color": INK, "ha": "center"}
"""Of one width, so that QTC states align."""


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
        look = {"textcoords": "offset points", "color": colour, "fontsize": LABEL}
        where.annotate(f"{person}", path[-1], (4, 4), **look)
    where.set_aspect("equal", adjustable="datalim")
    where.margins(0.15)
    dress(where, "x [m]", "y [m]", "paths, a dot at the end")
    values = np.array([alpha[row] for row in rows])
    highest = values.max() if values.size and values.max() > 0 else 1.0
    # Learned weights may be negative.
    lowest = min(0.0, values.min(initial=0.0))
    image = when.imshow(values, aspect="auto", cmap=PALE, vmin=lowest, vmax=highest)
    # A letter is 0.6 of its size wide; four and a margin fit into a step.
    size = min(SMALL, 0.58 * WIDTH * 72 / steps / 3)
    for place, row in enumerate(rows):
        for step, code in enumerate(pairs.codes[row], 1):
            when.text(step, place, texts[code], fontsize=size, va="center", **LETTERS)
    arrow = "→" if both_ways else "–"
    when.set_yticks(range(len(rows)), [f"{people[i]} {arrow} {people[j]}" for i, j in rows])
    ticks = range(0, steps, 2)
    when.set_xticks(ticks, [f"{pairs.period * step:.1f}" for step in ticks])
    when.grid(visible=False)
    dress(when, "time [s]", "", f"alpha and QTC state: {title}")
    bar = figure.colorbar(image, ax=when, pad=0.01)
    bar.set_label("alpha", fontsize=LABEL)
    bar.ax.tick_params(labelsize=SMALL)
    return figure
