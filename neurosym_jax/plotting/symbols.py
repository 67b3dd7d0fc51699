"""Symbols and weights: a scene's pairs over time, the states of a data set."""

import numpy as np
from matplotlib.figure import Figure

from neurosym_jax.plotting.matrix import LETTERS, draw_matrix
from neurosym_jax.plotting.palette import AMBER, BLUE, GREEN, INK, PALETTE, RED, SKY
from neurosym_jax.plotting.style import LABEL, SMALL, WIDTH, add_legend, dress, new_figure
from neurosym_jax.symbolic.description import ScenePairs, state_texts

__all__ = ["plot_pairs", "plot_states"]

BY_ZEROS = (BLUE, SKY, GREEN, AMBER, RED)
PAIRS = 12
"""Pairs that fit a heat map with their states written in."""
STATES = 24
"""States in the histogram; the rest are summed up."""


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
        where.plot(*path.T, "-o", color=colour, ms=1.5, lw=1.0)
        look = {"textcoords": "offset points", "color": colour, "fontsize": LABEL}
        where.annotate(f"{person}", path[0], (3, 3), **look)
        where.plot(*path[-1], "o", color=colour, ms=5)
    where.set_aspect("equal", adjustable="datalim")
    where.margins(0.15)
    dress(where, "x [m]", "y [m]", "paths, a dot at the end")

    values = np.array([alpha[row] for row in rows])
    highest = values.max() if values.size and values.max() > 0 else 1.0
    # Learned weights may be negative.
    lowest = min(0.0, values.min(initial=0.0))
    dress(when, "time [s]", "", f"alpha and QTC state: {title}")
    # A letter is 0.6 of its size wide; four and a margin fit into a step.
    size = min(SMALL, 0.58 * WIDTH * 72 / steps / 3)
    cells = [["", *(texts[code] for code in pairs.codes[row])] for row in rows]
    image = draw_matrix(when, values, cells, size, lowest, highest)
    arrow = "→" if both_ways else "–"
    when.set_yticks(range(len(rows)), [f"{people[i]} {arrow} {people[j]}" for i, j in rows])
    ticks = range(0, steps, 2)
    when.set_xticks(ticks, [f"{pairs.period * step:.1f}" for step in ticks])
    when.set_xticks(np.arange(0.5, steps), minor=True)
    when.set_yticks(np.arange(0.5, len(rows)), minor=True)
    when.set_axisbelow(False)
    when.grid(which="minor", color="white", linewidth=0.8)
    bar = figure.colorbar(image, ax=when, pad=0.01)
    bar.set_label("alpha", fontsize=LABEL)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=SMALL)
    return figure


def plot_states(
    counts: np.ndarray, table: np.ndarray | None, learned: np.ndarray | None, title: str
) -> Figure:
    """Frequency of the QTC_C1 states, beside their weights before and after training.

    The 24 most frequent states are shown, coloured by their number of zeros.

    Args:
        counts: [81] pair-steps by state code.
        table: [81] weights before training, or None.
        learned: [81] weights after it, or None.
        title: of the figure.
    """
    texts = state_texts()
    order = np.argsort(-counts, kind="stable")[: min(STATES, np.count_nonzero(counts))]
    share = 100 * counts / max(counts.sum(), 1)
    rest = share.sum() - share[order].sum()
    columns = 1 if table is None else 2
    figure, (panels,) = new_figure(WIDTH, 0.9 + 0.145 * len(order), 1, columns, sharey=True)
    zeros = np.array([text.count("0") for text in texts])
    place = np.arange(len(order))
    others = f"; the other {81 - len(order)} states: {rest:.1f}\xa0%"
    dress(panels[0], "per cent of observed pair-steps", "QTC state q1 q2 q3 q4", title + others)
    for count, colour in enumerate(BY_ZEROS):
        chosen = zeros[order] == count
        if chosen.any():
            label = f"{('none', 'one', 'two', 'three', 'all')[count]} of 4 symbols 0"
            panels[0].barh(place[chosen], share[order][chosen], color=colour, label=label)
    panels[0].set_yticks(place, [texts[code] for code in order], fontsize=SMALL, **LETTERS)
    panels[0].set_ylim(len(order) - 0.4, -0.6)
    if table is not None:
        dress(panels[1], "weight alpha", "", "weight of the state")
        colours = np.array(BY_ZEROS)[zeros[order]]
        if learned is None:
            panels[1].scatter(table[order], place, c=colours, s=16)
        else:
            panels[1].hlines(place, table[order], learned[order], color=colours, lw=1.2)
            panels[1].plot(
                table[order], place, "|", color=INK, ms=8, mew=1.5, label="before training"
            )
            panels[1].scatter(learned[order], place, c=colours, s=16)
        low, high = panels[1].get_xlim()
        panels[1].set_xlim(min(0.0, low), 1.05 * high)
    for axes in panels:
        axes.grid(visible=False, axis="y")
    add_legend(figure, *panels)
    return figure
