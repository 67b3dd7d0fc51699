"""What is observed, from above: all tracks of recordings, and the symbols and weights of pairs."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.image import imread
from numpy.typing import ArrayLike

from neurosym_jax.data.columns import read_homography
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.data.windows import Windows
from neurosym_jax.errors import InputError
from neurosym_jax.plotting import style
from neurosym_jax.plotting.forecasts import draw_paths, draw_scene
from neurosym_jax.symbolic.qtc import state_texts
from neurosym_jax.symbolic.weighting import is_constant

__all__ = ["plot_pairs", "plot_tracks", "read_underlay"]

PANELS = 24
"""Recordings that a figure has room for."""
DOTS = 700
"""Pixels of a drawn underlay along each side."""
PAIRS = 12
"""Pairs that fit a heat map with their states."""
_BLUES = colormaps["Blues"](np.linspace(0, 0.6, 64))
PALE = LinearSegmentedColormap.from_list("pale", _BLUES)
"""Pale enough for dark letters."""
LETTERS: dict[str, Any] = {
    "family": "DejaVu Sans Mono",
    "color": style.INK,
    "ha": "center",
}
"""Font of QTC states: letters of one width align them."""
BESIDE: dict[str, Any] = {"textcoords": "offset points", "fontsize": style.LABEL}
"""A name beside a person."""


def plot_tracks(
    recordings: Sequence[Tracks],
    underlay: tuple[ArrayLike, ArrayLike] | None = None,
    moment: tuple[np.ndarray, np.ndarray, Mapping[str, np.ndarray]] | None = None,
) -> Figure:
    """The first recordings (at least one is needed), in metres; a colour a person; 24 panels.

    Args:
        recordings: what to draw.
        underlay: what lies under each: an image of the floor, [H, W] or [H, W, 3 or 4],
            and the homography [3, 3] from its pixels (column, row, 1) to metres; see
            `read_underlay`.
        moment: what one more panel shows: past, future and forecasts of a scene, as
            `plot_forecasts` takes them.
    """
    others = 0 if moment is None else 1
    drawn = recordings[: PANELS - others]
    panels = len(drawn) + others
    columns = min(4, math.ceil(panels**0.5))
    rows = math.ceil(panels / columns)
    width = style.COLUMN if columns == 1 else style.WIDTH
    figure, grid = style.new_figure(width, rows * width / columns, rows, columns)
    for axes, tracks in zip(grid.ravel(), drawn):
        _draw_paths_of_people(axes, tracks)
        style.dress_floor(axes, tracks.recording[:60])
        if underlay is not None:
            pixels, homography = map(np.asarray, underlay)
            _draw_underlay(axes, pixels, homography)
    for axes in grid.ravel()[panels:]:
        axes.set_visible(False)
    if moment is None:
        return figure
    axes = grid.ravel()[panels - 1]
    draw_scene(axes, *moment)
    people = len(moment[0])
    style.dress_floor(axes, f"the busiest moment, {people} people")
    return style.add_legend(figure, axes)


def _draw_paths_of_people(axes: Axes, tracks: Tracks) -> None:
    """Draw each path in a colour, with a dot at its beginning."""
    begins = np.flatnonzero(np.diff(tracks.id)) + 1
    paths = np.split(tracks.position, begins)
    # A list: matplotlib takes a tuple of two for a colour and its opacity.
    colours = list(style.PALETTE * len(paths))[: len(paths)]
    lines = LineCollection(paths, colors=colours, linewidths=0.5, alpha=0.7)
    axes.add_collection(lines)
    starts = np.array([path[0] for path in paths])
    axes.scatter(*starts.T, s=3, c=colours, zorder=3)
    axes.autoscale()


def read_underlay(image: Path, homography: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read an image and its homography, see `plot_tracks` and `data.geometry.read_homography`.

    Raises:
        InputError: naming the file that cannot be read.
    """
    try:
        pixels = imread(image)
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(f"{image}: cannot be read as an image ({error})") from None
    return pixels, read_homography(homography)


def _draw_underlay(axes: Axes, pixels: np.ndarray, homography: np.ndarray) -> None:
    """Draw what the image shows of the floor within the limits of `axes`."""
    axes.apply_aspect()
    axes.autoscale(False)
    left, right = axes.get_xlim()
    bottom, top = axes.get_ylim()
    x = np.linspace(left, right, DOTS)
    y = np.linspace(bottom, top, DOTS)
    x, y = np.meshgrid(x, y)
    points = [x, y, np.ones_like(x)]
    inverse = np.linalg.inv(homography)
    column, row, depth = np.einsum("ij,jhw->ihw", inverse, points)
    height, width = pixels.shape[:2]
    # Points behind the camera have the other sign.
    depth_of_centre = homography[2] @ [width / 2, height / 2, 1]
    seen = depth * depth_of_centre > 0
    depth[~seen] = 1
    column = np.round(column / depth).astype(int)
    row = np.round(row / depth).astype(int)
    seen &= (column >= 0) & (column < width)
    seen &= (row >= 0) & (row < height)
    row = np.where(seen, row, 0)
    column = np.where(seen, column, 0)
    axes.imshow(
        pixels[row, column],
        alpha=np.where(seen, 0.6, 0.0),
        extent=(left, right, bottom, top),
        origin="lower",
        zorder=0,
        cmap="gray",
        aspect="auto",
    )
    axes.set_aspect("equal", adjustable="datalim")


def plot_pairs(
    scene: Windows, codes: np.ndarray, alpha: np.ndarray, title: str
) -> Figure:
    """A scene's paths beside alpha of its pairs over time, with the QTC_C1 states written in.

    `scene` has one window of N people, whose states have `codes [N, N, T - 1]` and
    weigh `alpha [N, N, T]`. Where alpha is the same both ways, a pair has one row; the
    first 12 rows are shown, and the title says of how many.
    """
    texts = state_texts()
    # Between two dollars matplotlib sees a formula.
    people = [str(person).replace("$", r"\$") for person in scene.agent]
    count = len(people)
    steps = alpha.shape[-1]
    both_ways = not np.allclose(alpha, alpha.swapaxes(0, 1))
    pairs = list(itertools.combinations(range(count), 2))
    if both_ways:
        pairs = list(itertools.permutations(range(count), 2))
    rows = pairs[:PAIRS]
    height = max(2.2, 0.8 + 0.19 * len(rows))
    figure, ((where, when),) = style.new_figure(
        style.WIDTH, height, 1, 2, width_ratios=(1, 2)
    )
    for path, person, colour in zip(scene.position, people, style.PALETTE * count):
        draw_paths(where, path[None], color=colour, lw=1.2)
        draw_paths(where, path[None, -1:], color=colour, marker="o", ms=4)
        where.annotate(person, path[-1], (4, 4), **BESIDE, color=colour)
    where.margins(0.15)
    style.dress_floor(where, "paths, a dot at the end")
    values = np.array([alpha[row] for row in rows])
    highest = values.max(initial=0.0) or 1.0
    # Learned weights may be negative.
    lowest = min(0.0, values.min(initial=0.0))
    image = when.imshow(values, aspect="auto", cmap=PALE, vmin=lowest, vmax=highest)
    # A letter is 0.6 of its size wide; four and a margin fit into a step.
    size = min(style.SMALL, 0.52 * figure.get_figwidth() * 72 / steps / 3)
    for place, row in enumerate(rows):
        for step, code in enumerate(codes[row], 1):
            when.text(step, place, texts[code], fontsize=size, va="center", **LETTERS)
    arrow = "→" if both_ways else "–"
    names = [f"{people[i]} {arrow} {people[j]}" for i, j in rows]
    when.set_yticks(range(len(rows)), names)
    ticks = range(0, steps, 2)
    when.set_xticks(ticks, [f"{scene.period * step:.1f}" for step in ticks])
    when.grid(visible=False)
    title = f"QTC and alpha: {title}"
    if len(pairs) > PAIRS:
        title += f", {PAIRS} of {len(pairs)} pairs"
    style.dress(when, "time [s]", "", title)
    if is_constant(alpha):
        image.set_visible(False)  # One colour would show nothing: the title says so.
        return figure
    return style.colour_bar(figure, image, when, "alpha")
