"""A forest plot: each model's difference to a reference with its interval, data set by data set."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.ticker import MaxNLocator

from neurosym_jax.plotting.palette import INK, model_colours
from neurosym_jax.plotting.style import GREY, LABEL, WIDTH, dress, new_figure, save_figure

__all__ = ["plot_forest"]

METRICS = {"joint_ade": "joint ADE", "marginal_ade": "marginal ADE"}
MARKERS = "os^vPXpd"
"""Of the data sets; that of their mean is a diamond."""


def plot_forest(comparisons: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw `comparisons` (see `comparison.Comparison.to_json`): a row of panels a reference.

    Left of 0 the model is better. Lines are the interval over test scenes and seeds.

    Raises:
        InputError: for a path that `save_figure` refuses.
    """
    references = list(dict.fromkeys(item["reference"] for item in comparisons))
    sets = list(dict.fromkeys(item["scene"] for item in comparisons))
    colours = model_colours([*references, *(item["model"] for item in comparisons)])
    models = {
        reference: list(
            dict.fromkeys(item["model"] for item in comparisons if item["reference"] == reference)
        )
        for reference in references
    }
    pitch = len(sets) + 1.2
    heights = [0.35 + 0.1 * pitch * len(models[reference]) for reference in references]
    figure, panels = new_figure(
        WIDTH, sum(heights) + 0.7, len(references), len(METRICS), sharex=True, height_ratios=heights
    )
    for reference, row in zip(references, panels):
        names = models[reference]
        for (metric, title), axes in zip(METRICS.items(), row):
            for item in (item for item in comparisons if item["reference"] == reference):
                at, mean = sets.index(item["scene"]), item["scene"] == "mean"
                place = names.index(item["model"]) * pitch + at
                value, interval = item[metric]["difference"], item[metric]["both"]
                colour, marker = colours[item["model"]], "D" if mean else MARKERS[at % len(MARKERS)]
                axes.plot(interval, [place] * 2, color=colour, lw=1.8 if mean else 0.8)
                axes.plot(value, place, marker, color=colour, ms=4 if mean else 2.8)
            axes.axvline(0, color="#888888", lw=0.8, zorder=1)
            last = reference == references[-1]
            words = "metres, with 95 % interval; less than 0 is better" if last else ""
            dress(axes, words, "", f"{title} minus that of {reference}")
            middles = [place * pitch + (len(sets) - 1) / 2 for place in range(len(names))]
            axes.set_yticks(middles, names if axes is row[0] else [], fontsize=LABEL, color=INK)
            axes.set_ylim(len(names) * pitch - 0.8, -1.2)
            axes.grid(visible=False, axis="y")
            axes.spines["left"].set_visible(False)
            axes.xaxis.set_major_locator(MaxNLocator(5))
    axes = panels[0, 0]
    for at, name in enumerate(sets):
        marker = "D" if name == "mean" else MARKERS[at % len(MARKERS)]
        label = "mean of the data sets" if name == "mean" else name
        axes.plot([], [], marker, color=GREY, ms=4, label=label)
    handles, labels = axes.get_legend_handles_labels()
    place = {"loc": "outside lower center", "ncols": len(labels)}
    figure.legend(handles, labels, **place, frameon=False, fontsize=LABEL)
    save_figure(figure, path)
