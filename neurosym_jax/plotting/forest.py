"""A forest plot: each model's difference to a reference with its interval, set by set."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neurosym_jax.plotting.palette import PALETTE

__all__ = ["plot_forest"]

SHOWN = {"joint_ade": "joint ADE", "marginal_ade": "marginal ADE"}


def plot_forest(comparisons: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw `comparisons` (see `comparison.Comparison.to_json`): a row of panels a reference.

    Left of 0 the model is better. Lines are the interval over test scenes and seeds.
    """
    from matplotlib.figure import Figure

    from neurosym_jax.plotting.figures import save_figure

    references = list(dict.fromkeys(one["reference"] for one in comparisons))
    sets = list(dict.fromkeys(one["scene"] for one in comparisons))
    most = max(len({c["model"] for c in comparisons if c["reference"] == r}) for r in references)
    height = len(references) * (0.9 + 0.17 * most * (len(sets) + 1.2))
    figure = Figure(figsize=(11, height), layout="constrained")
    panels = figure.subplots(len(references), len(SHOWN), squeeze=False, sharey="row")
    for reference, row in zip(references, panels):
        mine = [one for one in comparisons if one["reference"] == reference]
        models = list(dict.fromkeys(one["model"] for one in mine))
        for (metric, title), axes in zip(SHOWN.items(), row):
            for at, scene in enumerate(sets):
                colour = "#222222" if scene == "mean" else PALETTE[at % len(PALETTE)]
                wide = scene == "mean"
                for one in (one for one in mine if one["scene"] == scene):
                    value, (low, high) = one[metric]["difference"], one[metric]["both"]
                    place = models.index(one["model"]) * (len(sets) + 1.2) + at
                    first = models.index(one["model"]) == 0
                    axes.plot([low, high], [place] * 2, color=colour, lw=3 if wide else 1.5)
                    label = ("mean of the sets" if wide else scene) if first else None
                    marker, size = ("D", 7) if wide else ("o", 5)
                    axes.plot(value, place, marker, color=colour, ms=size, label=label)
            axes.axvline(0, color="#888888", lw=1)
            axes.set_title(f"{title}, less {reference}")
            axes.set_xlabel("metres; left of 0 is better")
            axes.set_yticks(
                [place * (len(sets) + 1.2) + (len(sets) - 1) / 2 for place in range(len(models))],
                models,
            )
            axes.grid(axis="x", color="#E4E4E4")
            for side in ("top", "right", "left"):
                axes.spines[side].set_visible(False)
            axes.tick_params(axis="y", length=0)
        row[0].invert_yaxis()
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    save_figure(figure, path)
