"""Symbols: a scene's pairs over time, the states of a data set, and forecasts of both."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from neurosym_jax.plotting.forecasts import draw_paths
from neurosym_jax.plotting.style import (
    INK,
    LABEL,
    PALETTE,
    SMALL,
    WIDTH,
    add_legend,
    dress,
    new_figure,
)
from neurosym_jax.symbolic.description import PairForecasts, ScenePairs, state_texts
from neurosym_jax.symbolic.events import EVENTS

__all__ = ["plot_pairs", "plot_states", "plot_symbol_forecast"]

PAIRS, FORECASTS = 12, 10
"""Pairs that fit a heat map with their states, and with their states and events."""
STATES = 24
"""States in the histogram."""
PALE = LinearSegmentedColormap.from_list("pale", colormaps["Blues"](np.linspace(0, 0.6, 64)))
"""Pale enough for dark letters."""
LETTERS: dict[str, Any] = {"family": "DejaVu Sans Mono", "color": INK}
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
    _draw_people(where, pairs.position, people)
    dress(where, "x [m]", "y [m]", "paths, a dot at the end")
    values = np.array([alpha[row] for row in rows])
    highest = values.max() if values.size and values.max() > 0 else 1.0
    # Learned weights may be negative.
    lowest = min(0.0, values.min(initial=0.0))
    # A letter is 0.6 of its size wide; four and a margin fit into a step.
    size = min(SMALL, 0.58 * WIDTH * 72 / steps / 3)
    cells = [["", *(texts[code] for code in pairs.codes[row])] for row in rows]
    image = _draw_matrix(when, values, cells, size, lowest, highest)
    arrow = "→" if both_ways else "–"
    when.set_yticks(range(len(rows)), [f"{people[i]} {arrow} {people[j]}" for i, j in rows])
    ticks = range(0, steps, 2)
    when.set_xticks(ticks, [f"{pairs.period * step:.1f}" for step in ticks])
    dress(when, "time [s]", "", f"alpha and QTC state: {title}")
    figure.colorbar(image, ax=when, pad=0.01, label="alpha")
    return figure


def plot_states(
    counts: np.ndarray, table: np.ndarray | None, learned: np.ndarray | None, title: str
) -> Figure:
    """Frequency of the 24 most frequent QTC_C1 states, beside their weights.

    Args:
        counts: [81] pair-steps by state code.
        table: [81] weights before training, or None.
        learned: [81] weights after it, or None.
        title: of the figure.
    """
    order = np.argsort(-counts, kind="stable")[: min(STATES, np.count_nonzero(counts))]
    share = 100 * counts / max(counts.sum(), 1)
    place, texts = np.arange(len(order)), state_texts()
    columns = 1 if table is None else 2
    figure, (panels,) = new_figure(WIDTH, 0.9 + 0.145 * len(order), 1, columns, sharey=True)
    rest = f"the other {81 - len(order)} states: {share.sum() - share[order].sum():.1f}\xa0%"
    words = ("per cent of observed pair-steps", "QTC state q1 q2 q3 q4")
    dress(panels[0], *words, f"{title}; {rest}")
    panels[0].barh(place, share[order], color=PALETTE[0])
    panels[0].set_yticks(place, [texts[code] for code in order], fontsize=SMALL, **LETTERS)
    panels[0].set_ylim(len(order) - 0.4, -0.6)
    if table is not None:
        dress(panels[1], "weight alpha", "", "weight of the state")
        for weights, label, colour in (
            (table, "before training", INK),
            (learned, "learned", PALETTE[3]),
        ):
            if weights is not None:
                panels[1].scatter(weights[order], place, color=colour, s=16, label=label)
        low, high = panels[1].get_xlim()
        panels[1].set_xlim(min(0.0, low), 1.05 * high)
        if learned is not None:
            add_legend(figure, panels[1])
    for axes in panels:
        axes.grid(visible=False, axis="y")
    return figure


def plot_symbol_forecast(
    observed: np.ndarray, samples: np.ndarray, found: PairForecasts, title: str
) -> Figure:
    """A scene's sampled paths beside the states and events of its ten most eventful pairs.

    Args:
        observed: [N, obs_len, 2] metres.
        samples: [k, N, T, 2] metres.
        found: states and events of these samples.
        title: of the figure.
    """
    people, chosen = found.people, found.pairs[:FORECASTS]
    height = max(2.4, 1.0 + 0.2 * len(chosen))
    figure, ((where, when, what),) = new_figure(WIDTH, height, 1, 3, width_ratios=(1.1, 1.9, 1.5))
    _draw_people(where, observed, people, samples)
    dress(where, "x [m]", "y [m]", title)
    rows = [found.likely_states(*pair) for pair in chosen]
    share = np.array([[share for _, share in row] for row in rows])
    _draw_matrix(when, share, [[text for text, _ in row] for row in rows], SMALL - 1.5)
    seconds = [f"{found.settings.period * (step + 1):.1f}" for step in range(share.shape[1])]
    when.set_xticks(range(len(seconds)), seconds)
    when.set_yticks(range(len(chosen)), [f"{people[i]} → {people[j]}" for i, j in chosen])
    dress(when, "seconds ahead", "", "most probable state")
    first, second = np.array(chosen).T
    probability = np.asarray(found.events.probability)[:, first, second].T
    medians = np.asarray(found.events.seconds)[:, first, second, 1].T
    cells = [
        [f"{100 * p:.0f}%\n{t:.1f} s" if p >= 0.2 and np.isfinite(t) else "" for p, t in zip(*both)]
        for both in zip(probability, medians)
    ]
    _draw_matrix(what, probability, cells, SMALL - 2.5)
    names = [event.replace("_", " ") for event in EVENTS]
    what.set_xticks(range(len(names)), names, rotation=90)
    what.set_yticks([])
    dress(what, "", "", "events, median time")
    return figure


def _draw_people(
    axes: Axes, paths: np.ndarray, people: np.ndarray, samples: Iterable[np.ndarray] = ()
) -> None:
    """Draw `paths` [N, T, 2] and k `samples` [N, T', 2] that follow, a colour a person."""
    for i, (person, colour) in enumerate(zip(people, PALETTE * len(people))):
        own = paths[i : i + 1]
        for sample in samples:
            draw_paths(axes, sample[i : i + 1], own, color=colour, lw=0.5, alpha=0.3)
        draw_paths(axes, own, color=colour, lw=1.2)
        draw_paths(axes, own[:, -1:], color=colour, marker="o", ms=4)
        look = {"textcoords": "offset points", "color": colour, "fontsize": LABEL}
        axes.annotate(f"{person}", own[0, -1], (4, 4), **look)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.15)


def _draw_matrix(
    axes: Axes,
    values: np.ndarray,
    cells: Sequence[Sequence[str]],
    size: float,
    low: float = 0.0,
    high: float = 1.0,
) -> AxesImage:
    """Draw `values` [R, C], from `low` pale to `high` blue, with texts of `size` points."""
    image = axes.imshow(values, aspect="auto", cmap=PALE, vmin=low, vmax=high)
    look = {"ha": "center", "va": "center", "linespacing": 0.9, **LETTERS}
    for row, texts in enumerate(cells):
        for column, text in enumerate(texts):
            axes.text(column, row, text, fontsize=size, **look)
    axes.grid(visible=False)
    return image
