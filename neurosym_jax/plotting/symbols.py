"""Figures of symbols and weights, from plain arrays: a scene's pairs, the states of a data set."""

from typing import TYPE_CHECKING

import numpy as np

from neurosym_jax.plotting.palette import PALETTE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot_pairs", "plot_states"]

BY_ZEROS = ("#0072B2", "#56B4E9", "#009E73", "#E69F00", "#D55E00")
PAIRS = 12
"""Pairs that fit a heat map with their states written in."""
SHOWN = 24
"""States in the histogram; the rest are summed up."""
PERIOD = 0.4


def plot_pairs(
    position: np.ndarray,
    people: np.ndarray,
    codes: np.ndarray,
    alpha: np.ndarray,
    texts: list[str],
    title: str,
) -> "Figure":
    """A scene's paths beside alpha of its pairs over time, the states written into it.

    `position` [N, T, 2] metres, `people` [N] ids, `codes` [N, N, T-1], `alpha` [N, N, T], `texts`
    of the 81 states. Where alpha is the same both ways, a pair has one row; the first 12 are shown.
    """
    from matplotlib.figure import Figure

    count = len(people)
    both_ways = not np.allclose(alpha, alpha.swapaxes(0, 1))
    pairs = [(i, j) for i in range(count) for j in range(count) if i != j and (both_ways or i < j)]
    pairs = pairs[:PAIRS]
    figure = Figure(
        figsize=(15, max(4.6, 1.6 + 0.45 * len(pairs))), layout="constrained", facecolor="white"
    )
    where, when = figure.subplots(1, 2, width_ratios=(1, 2.3))
    for path, person, colour in zip(position, people, PALETTE * count):
        where.plot(*path.T, "-o", color=colour, ms=3, lw=1.6)
        where.annotate(
            f"{person}", path[0], (6, 6), textcoords="offset points", color=colour, fontsize=12
        )
        where.plot(*path[-1], "o", color=colour, ms=8)
    where.set_aspect("equal", adjustable="datalim")
    where.margins(0.15)
    where.set(xlabel="x [m]", ylabel="y [m]", title="paths; the dot is the end")
    where.grid(color="#E4E4E4")

    rows = np.array([alpha[i, j] for i, j in pairs])
    highest = rows.max() if rows.size and rows.max() > 0 else 1.0
    # Learned weights may be negative.
    lowest = min(0.0, rows.min(initial=0.0))
    image = when.imshow(rows, aspect="auto", cmap="Blues", vmin=lowest, vmax=highest)
    for row, (i, j) in enumerate(pairs):
        for step in range(1, rows.shape[1]):
            text = texts[codes[i, j, step - 1]].replace("-", "−")
            dark = rows[row, step] > lowest + 0.6 * (highest - lowest)
            look = {"ha": "center", "va": "center", "fontsize": 9, "family": "DejaVu Sans Mono"}
            when.text(step, row, text, color="white" if dark else "#222222", **look)
    arrow = "→" if both_ways else "–"
    when.set_yticks(range(len(pairs)), [f"{people[i]} {arrow} {people[j]}" for i, j in pairs])
    ticks = range(0, rows.shape[1], 2)
    when.set_xticks(ticks, [f"{PERIOD * step:.1f}" for step in ticks])
    when.set(xlabel="time [s]", title=f"alpha, and the state q1 q2 q3 q4: {title}")
    figure.colorbar(image, ax=when, label="alpha", pad=0.01)
    return figure


def plot_states(
    counts: np.ndarray,
    texts: list[str],
    table: np.ndarray | None,
    learned: np.ndarray | None,
    title: str,
) -> "Figure":
    """How often the states occur, and what they weigh by the table and once learned.

    `counts` [81] pair-steps, `texts` of the 81 states, `table` and `learned` [81] or None. The 24
    most frequent states are shown, coloured by their number of zeros.
    """
    from matplotlib.figure import Figure

    order = np.argsort(-counts, kind="stable")[: min(SHOWN, np.count_nonzero(counts))]
    share = 100 * counts / max(counts.sum(), 1)
    rest = share.sum() - share[order].sum()
    figure = Figure(figsize=(12, 8), layout="constrained", facecolor="white")
    panels = figure.subplots(1, 1 if table is None else 2, sharey=True, squeeze=False)[0]
    zeros = np.array([text.count("0") for text in texts])
    place = np.arange(len(order))
    for count, colour in enumerate(BY_ZEROS):
        chosen = zeros[order] == count
        if chosen.any():
            label = f"{count} zero{'s' * (count != 1)}"
            panels[0].barh(place[chosen], share[order][chosen], color=colour, label=label)
    names = [texts[code].replace("-", "−") for code in order]
    panels[0].set_yticks(place, names, family="DejaVu Sans Mono")
    panels[0].invert_yaxis()
    panels[0].set(
        xlabel="per cent of observed pair-steps",
        title=f"{title}; the other {81 - len(order)} states: {rest:.1f} %",
    )
    panels[0].legend(frameon=False, loc="lower right")
    if table is not None:
        if learned is not None:
            panels[1].hlines(place, table[order], learned[order], color="#BBBBBB", lw=2)
            panels[1].plot(learned[order], place, "o", color="#D55E00", ms=7, label="learned")
        panels[1].plot(table[order], place, "|", color="#222222", ms=14, mew=3, label="table")
        panels[1].set(xlabel="weight alpha", title="what the state weighs")
        panels[1].legend(frameon=False, loc="upper right")
        low, high = panels[1].get_xlim()
        panels[1].set_xlim(min(0.0, low), 1.05 * high)
    for axes in panels:
        axes.grid(axis="x", color="#E4E4E4")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    return figure
