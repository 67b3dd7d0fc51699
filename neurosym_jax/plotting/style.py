"""What all figures look alike in: sizes, letters, axes, legends, and the files they become."""

import textwrap
import threading
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.plotting.palette import INK
from neurosym_jax.runtime.files import new_file

__all__ = [
    "COLUMN",
    "GREY",
    "LABEL",
    "SMALL",
    "WIDTH",
    "add_legend",
    "checked",
    "dress",
    "new_figure",
    "plain",
    "save_figure",
]

WIDTH, COLUMN = 7.0, 3.4
"""Inches, of both columns of a paper and of one."""
TITLE, LABEL, SMALL = 9, 8, 7
"""Points."""
GREY, AXIS, GRID = "#555555", "#BBBBBB", "#E8E8E8"
DOTS = 220
"""Per inch, of a PNG."""

FORMATS = {
    ".png": {"dpi": DOTS},
    ".pdf": {"metadata": {"CreationDate": None}},
    ".svg": {"metadata": {"Date": None}},
}
_settings = threading.Lock()


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **grid: Any
) -> tuple[Figure, np.ndarray]:
    """An empty figure of so many inches, and its [rows, columns] axes."""
    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05, compress=True)
    figure = Figure(figsize=(width, height), layout=layout, facecolor="white")
    return figure, figure.subplots(rows, columns, squeeze=False, **grid)


def dress(axes: Axes, x_label: str = "", y_label: str = "", title: str | None = None) -> None:
    """Labels, title, a pale grid, and no frame."""
    axes.set_xlabel(x_label, fontsize=LABEL, color=INK)
    axes.set_ylabel(y_label, fontsize=LABEL, color=INK)
    if title:
        figure, grid = axes.get_figure(), axes.get_gridspec()
        assert isinstance(figure, Figure)
        assert grid is not None
        inches = figure.get_figwidth() / grid.ncols - 0.5
        # A letter is about half as wide as high.
        text = plain(title, int(inches * 72 / (0.52 * TITLE)))
        axes.set_title(text, fontsize=TITLE, color=INK, loc="left", pad=6)
    axes.grid(color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=SMALL, colors=GREY, length=0, pad=4)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(AXIS)


def add_legend(figure: Figure, *panels: Axes) -> None:
    """A legend of the distinct labels of `panels`, below them, in as many columns as fit.

    The figure grows by what the legend needs.
    """
    found = [pair for axes in panels for pair in zip(*axes.get_legend_handles_labels())]
    handles = {label: handle for handle, label in reversed(found)}
    labels = list(dict.fromkeys(label for _, label in found))
    if not labels:
        return
    widest = int(figure.get_figwidth() * 72 / LABEL / 0.5 - 10)
    texts = [plain(label, min(40, widest)) for label in labels]
    longest = max(len(line) for text in texts for line in text.split("\n"))
    # In widths of a letter's height: half of one for a letter, and the line before it.
    columns = int(figure.get_figwidth() * 72 / LABEL / (0.5 * longest + 4.2))
    columns = max(1, min(columns, len(labels)))
    lines = max(text.count("\n") + 1 for text in texts) * -(-len(texts) // columns)
    figure.set_figheight(figure.get_figheight() + (1.4 * lines + 0.6) * LABEL / 72)
    figure.legend(
        [handles[label] for label in labels],
        texts,
        loc="outside lower left",
        ncols=columns,
        frameon=False,
        fontsize=LABEL,
        labelcolor=INK,
        handlelength=2.6,
        columnspacing=1.2,
        labelspacing=0.35,
    )


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write `figure` as PNG, PDF or SVG, by the ending of `path`; its folders are made.

    Raises:
        InputError: for another ending, or a file that cannot be written.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in FORMATS:
        raise InputError(f"{path}: a figure's name must end in .png, .pdf or .svg")
    # Publishers refuse the Type 3 letters that are matplotlib's default.
    with new_file(path) as beside, _settings, mpl.rc_context({"pdf.fonttype": 42}):
        figure.savefig(beside, format=ending[1:], facecolor="white", **FORMATS[ending])
    return path


def checked(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> np.ndarray:
    """`values` [...] in float64.

    Raises:
        InputError: unless they are finite, not empty and of `shape` (None fits any length).
    """
    array = np.asarray(values, np.float64)
    fits = array.ndim == len(shape) and all(n in (m, None) for m, n in zip(array.shape, shape))
    if not fits or array.size == 0:
        wanted = ", ".join("any" if size is None else str(size) for size in shape)
        raise InputError(f"{name} must be [{wanted}] and not empty, not {list(array.shape)}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds a value that is not finite")
    return array


def plain(text: str, width: int = 60) -> str:
    """Text in lines of at most `width` characters, in which a dollar sign is not mathematics."""
    return textwrap.fill(str(text), width).replace("$", r"\$")
