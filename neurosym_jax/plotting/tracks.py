"""All tracks of recordings, a panel a recording."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputError
from neurosym_jax.plotting.style import COLUMN, PALETTE, WIDTH, dress_floor, new_figure

__all__ = ["plot_tracks", "read_underlay"]

PANELS = 24
"""Recordings that a figure has room for."""
DOTS = 700
"""Of a drawn underlay, along each side."""


def plot_tracks(
    recordings: Sequence[Tracks], underlay: tuple[ArrayLike, ArrayLike] | None = None
) -> Figure:
    """The first 24 recordings (at least one is needed), in metres; a colour a person.

    Args:
        recordings: what to draw.
        underlay: what lies under each: an image of the floor, [H, W] or [H, W, 3 or 4], and the
            homography [3, 3] from its pixels (column, row, 1) to metres; see `read_underlay`.
    """
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
        dress_floor(axes, tracks.recording[:60])
        if underlay is not None:
            _draw_underlay(axes, *map(np.asarray, underlay))
    for axes in grid.ravel()[len(shown) :]:
        axes.set_visible(False)
    return figure


def read_underlay(image: Path, homography: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read an image and the nine numbers of its homography, a text file; see `plot_tracks`.

    Raises:
        InputError: naming the file that cannot be read.
    """
    try:
        pixels = imread(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{image}: cannot be read as an image ({error})") from None
    try:
        matrix = np.loadtxt(homography).reshape(3, 3)
        np.linalg.inv(matrix)
    except (OSError, ValueError) as error:  # LinAlgError is a ValueError.
        raise InputError(
            f"{homography}: 3 x 3 numbers that have an inverse are wanted ({error})"
        ) from None
    return pixels, matrix


def _draw_underlay(axes: Axes, pixels: np.ndarray, homography: np.ndarray) -> None:
    """Draw what the image shows of the floor within the limits of `axes`."""
    axes.apply_aspect()
    axes.autoscale(False)
    limits = (*axes.get_xlim(), *axes.get_ylim())
    x, y = np.meshgrid(np.linspace(*limits[:2], DOTS), np.linspace(*limits[2:], DOTS))
    inverse = np.linalg.inv(homography)
    column, row, depth = np.einsum("ij,jhw->ihw", inverse, [x, y, np.ones_like(x)])
    height, width = pixels.shape[:2]
    # Points behind the camera have the other sign.
    seen = depth * (homography[2] @ [width / 2, height / 2, 1]) > 0
    depth[~seen] = 1
    column, row = (np.round(each / depth).astype(int) for each in (column, row))
    seen &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
    drawn = pixels[np.where(seen, row, 0), np.where(seen, column, 0)]
    look = {"extent": limits, "origin": "lower", "zorder": 0, "cmap": "gray", "aspect": "auto"}
    axes.imshow(drawn, alpha=np.where(seen, 0.6, 0.0), **look)
    axes.set_aspect("equal", adjustable="datalim")
