"""What is observed, from above: all tracks of recordings, and the symbols and weights of pairs."""

import itertools
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
PALE = LinearSegmentedColormap.from_list(
    "pale", colormaps["Blues"](np.linspace(0, 0.6, 64))
)
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
    drawn = recordings[: PANELS - (moment is not None)]
    panels = len(drawn) + (moment is not None)
    columns = min(4, int(np.ceil(np.sqrt(panels))))
    rows = -(-panels // columns)
    width = style.COLUMN if columns == 1 else style.WIDTH
    figure, grid = style.new_figure(width, rows * width / columns, rows, columns)
    for axes, tracks in zip(grid.ravel(), drawn):
        paths = np.split(tracks.position, np.flatnonzero(np.diff(tracks.id)) + 1)
        colours = [
            style.PALETTE[person % len(style.PALETTE)] for person in range(len(paths))
        ]
        axes.add_collection(
            LineCollection(paths, colors=colours, linewidths=0.5, alpha=0.7)
        )
        axes.scatter(*np.array([path[0] for path in paths]).T, s=3, c=colours, zorder=3)
        axes.autoscale()
        style.dress_floor(axes, tracks.recording[:60])
        if underlay is not None:
            _draw_underlay(axes, *map(np.asarray, underlay))
    for axes in grid.ravel()[panels:]:
        axes.set_visible(False)
    if moment is None:
        return figure
    axes = grid.ravel()[panels - 1]
    draw_scene(axes, *moment)
    style.dress_floor(axes, f"the busiest moment, {len(moment[0])} people")
    return style.add_legend(figure, axes)


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
    limits = (*axes.get_xlim(), *axes.get_ylim())
    x, y = np.meshgrid(np.linspace(*limits[:2], DOTS), np.linspace(*limits[2:], DOTS))
    inverse = np.linalg.inv(homography)
    column, row, depth = np.einsum("ij,jhw->ihw", inverse, [x, y, np.ones_like(x)])
    height, width = pixels.shape[:2]
    # Points behind the camera have the other sign.
    seen = depth * (homography[2] @ [width / 2, height / 2, 1]) > 0
    depth[~seen] = 1
    column, row = (np.round(axis / depth).astype(int) for axis in (column, row))
    seen &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
    drawn = pixels[np.where(seen, row, 0), np.where(seen, column, 0)]
    look = {
        "extent": limits,
        "origin": "lower",
        "zorder": 0,
        "cmap": "gray",
        "aspect": "auto",
    }
    axes.imshow(drawn, alpha=np.where(seen, 0.6, 0.0), **look)
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
    pairing = itertools.permutations if both_ways else itertools.combinations
    pairs = list(pairing(range(count), 2))
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
    highest = values.max() if values.size and values.max() > 0 else 1.0
    # Learned weights may be negative.
    lowest = min(0.0, values.min(initial=0.0))
    image = when.imshow(values, aspect="auto", cmap=PALE, vmin=lowest, vmax=highest)
    # A letter is 0.6 of its size wide; four and a margin fit into a step.
    size = min(style.SMALL, 0.52 * figure.get_figwidth() * 72 / steps / 3)
    for place, row in enumerate(rows):
        for step, code in enumerate(codes[row], 1):
            when.text(step, place, texts[code], fontsize=size, va="center", **LETTERS)
    arrow = "→" if both_ways else "–"
    when.set_yticks(
        range(len(rows)), [f"{people[i]} {arrow} {people[j]}" for i, j in rows]
    )
    when.set_xticks(
        range(0, steps, 2), [f"{scene.period * n:.1f}" for n in range(0, steps, 2)]
    )
    when.grid(visible=False)
    suffix = f", {PAIRS} of {len(pairs)} pairs" if len(pairs) > PAIRS else ""
    style.dress(when, "time [s]", "", f"QTC and alpha: {title}{suffix}")
    if is_constant(alpha):
        image.set_visible(False)  # One colour would show nothing: the title says so.
        return figure
    return style.colour_bar(figure, image, when, "alpha")
