"""A forest plot: each model's difference to a reference with its interval, data set by data set."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.ticker import MaxNLocator

from neurosym_jax.plotting.style import (
    INK,
    LABEL,
    WIDTH,
    add_legend,
    dress,
    model_looks,
    new_figure,
    save_figure,
)

__all__ = ["plot_forest"]

METRICS = {"joint_ade": "joint ADE", "marginal_ade": "marginal ADE"}
MARKERS = "os^vPXpd"
"""Markers of the data sets; their mean is a diamond."""


def plot_forest(comparisons: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the comparisons of a sweep's report, a row of panels for each reference.

    Left of 0 the model is better. Lines are the interval over test scenes and seeds.
    """
    references = list(dict.fromkeys(item["reference"] for item in comparisons))
    names = list(dict.fromkeys(item["model"] for item in comparisons))
    sets = list(dict.fromkeys(item["scene"] for item in comparisons))
    looks = model_looks(names)
    markers = {name: "D" if name == "mean" else MARKERS[at % 8] for at, name in enumerate(sets)}
    pitch = len(sets) + 1.2
    height = 0.6 + (0.5 + 0.095 * pitch * len(names)) * len(references)
    shared = {"sharex": True, "sharey": True}
    figure, grid = new_figure(WIDTH, height, len(references), len(METRICS), **shared)
    wanted = [(reference, metric) for reference in references for metric in METRICS]
    for axes, (reference, metric) in zip(grid.ravel(), wanted):
        for item in (item for item in comparisons if item["reference"] == reference):
            mean, colour = item["scene"] == "mean", looks[item["model"]]["color"]
            place = names.index(item["model"]) * pitch + sets.index(item["scene"])
            axes.plot(item[metric]["both"], [place] * 2, color=colour, lw=1.8 if mean else 0.8)
            marker = {"marker": markers[item["scene"]], "ms": 4 if mean else 2.8}
            axes.plot(item[metric]["difference"], place, color=colour, ls="none", **marker)
        axes.axvline(0, color="#888888", lw=0.8, zorder=1)
        dress(axes, "m; below 0: better" if axes in grid[-1] else "")
        title = f"{METRICS[metric]}\nminus that of {reference}"
        axes.set_title(title, fontsize=LABEL, color=INK, loc="left")
        axes.grid(visible=False, axis="y")
        axes.spines["left"].set_visible(False)
        axes.xaxis.set_major_locator(MaxNLocator(3))
    first = grid[0, 0]
    middles = [place * pitch + (len(sets) - 1) / 2 for place in range(len(names))]
    first.set_yticks(middles, names, fontsize=LABEL, color=INK)
    first.set_ylim(len(names) * pitch - 0.8, -1.2)
    for name, marker in markers.items():
        label = "mean of the data sets" if name == "mean" else name
        first.plot([], [], color="#555555", marker=marker, ms=4, ls="none", label=label)
    add_legend(figure, first)
    save_figure(figure, path)
