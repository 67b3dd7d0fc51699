"""All tracks of recordings, a panel a recording."""

from collections.abc import Sequence

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from neurosym_jax.data.tracks import Tracks
from neurosym_jax.plotting.style import COLUMN, PALETTE, WIDTH, dress, new_figure

__all__ = ["plot_tracks"]

PANELS = 24
"""Recordings that a figure has room for."""


def plot_tracks(recordings: Sequence[Tracks]) -> Figure:
    """The first 24 recordings (at least one is needed), in metres; a colour a person."""
    shown = recordings[:PANELS]
    columns = min(4, int(np.ceil(np.sqrt(len(shown)))))
    rows = -(-len(shown) // columns)
    width = COLUMN if columns == 1 else WIDTH
    figure, grid = new_figure(width, rows * width / columns, rows, columns)
    for axes, tracks in zip(grid.ravel(), shown):
        paths = np.split(tracks.position, np.flatnonzero(np.diff(tracks.id)) + 1)
        colours = [PALETTE[person % len(PALETTE)] for person in range(len(paths))]
        axes.add_collection(LineCollection(paths, colors=colours, linewidths=0.5, alpha=0.7))
        axes.scatter(*np.array([path[0] for path in paths]).T, s=3, c=colours, zorder=3)
        axes.autoscale()
        axes.set_aspect("equal", adjustable="datalim")
        axes.ticklabel_format(useOffset=False, style="plain")
        dress(axes, "x [m]", "y [m]", tracks.recording[:60])
    for axes in grid.ravel()[len(shown) :]:
        axes.set_visible(False)
    return figure
