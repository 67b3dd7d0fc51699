"""A figure of all tracks of recordings: where people walked, a panel a recording."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from neurosym_jax.data.tracks import Tracks
from neurosym_jax.plotting.palette import PALETTE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["plot_tracks"]

_PANELS = 24  # beyond this many, panels are too small to see anything in


def plot_tracks(recordings: Sequence[Tracks]) -> "Figure":
    """The first 24 recordings (at least one is needed), in metres; a colour a person."""
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    shown = recordings[:_PANELS]
    columns = min(4, int(np.ceil(np.sqrt(len(shown)))))
    rows = -(-len(shown) // columns)
    size = 7.0 if columns == 1 else 4.5
    figure = Figure(figsize=(size * columns, size * rows), layout="constrained", facecolor="white")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, tracks in zip(panels, shown):
        starts = np.flatnonzero(np.diff(tracks.id)) + 1
        paths = np.split(tracks.position, starts)
        colours = [PALETTE[person % len(PALETTE)] for person in range(len(paths))]
        axes.add_collection(LineCollection(paths, colors=colours, linewidths=0.8, alpha=0.7))
        first = np.array([path[0] for path in paths])
        axes.scatter(*first.T, s=8, c=colours, zorder=3)
        axes.autoscale()
        axes.set_aspect("equal", adjustable="datalim")
        axes.ticklabel_format(useOffset=False, style="plain")
        axes.set_title(tracks.recording[:40].replace("$", r"\$"), fontsize=11, loc="left")
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.grid(color="#E4E4E4", linewidth=0.8)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    return figure
