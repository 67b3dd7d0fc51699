"""A matrix of shares or weights with texts in its cells."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.image import AxesImage

from neurosym_jax.plotting.palette import INK

__all__ = ["LETTERS", "draw_matrix"]

PALE = LinearSegmentedColormap.from_list("pale", colormaps["Blues"](np.linspace(0, 0.6, 64)))
"""Pale enough for dark letters."""
LETTERS: dict[str, Any] = {"family": "DejaVu Sans Mono", "color": INK}
"""Of one width, so that QTC states align."""


def draw_matrix(
    axes: Axes,
    values: np.ndarray,
    cells: Sequence[Sequence[str]],
    size: float,
    low: float = 0.0,
    high: float = 1.0,
) -> AxesImage:
    """Draw `values` [R, C], from `low` pale to `high` blue, with texts of `size` points."""
    image = axes.imshow(values, aspect="auto", cmap=PALE, vmin=low, vmax=high)
    look = {"ha": "center", "va": "center", "linespacing": 0.9, **LETTERS}
    for row, texts in enumerate(cells):
        for column, text in enumerate(texts):
            axes.text(column, row, text, fontsize=size, **look)
    axes.grid(visible=False)
    return image
