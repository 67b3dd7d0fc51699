"""Figures, legends and files in the common look, `neurosym.mplstyle`."""

import contextlib
import textwrap
import threading
from collections.abc import Iterator
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
    "ENDINGS",
    "LABEL",
    "SMALL",
    "WIDTH",
    "add_legend",
    "checked",
    "dress",
    "new_figure",
    "save_figure",
]

WIDTH, COLUMN = 7.0, 3.4
"""Width of a figure over both columns of a paper, and over one, inches."""
TITLE, LABEL, SMALL = 9, 8, 7
"""Font sizes, points."""
ENDINGS = (".png", ".pdf", ".svg")
"""Endings of a figure's file."""

_UNDATED = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}
_lock = threading.Lock()


@contextlib.contextmanager
def _styled() -> Iterator[None]:
    """Apply the style; `rcParams` are the process's, so one thread at a time."""
    with _lock, mpl.rc_context(fname=str(Path(__file__).with_name("neurosym.mplstyle"))):
        yield


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **grid: Any
) -> tuple[Figure, np.ndarray]:
    """An empty figure, `width` by `height` inches, and its [rows, columns] axes."""
    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05, compress=True)
    with _styled():
        figure = Figure(figsize=(width, height), layout=layout)
        return figure, figure.subplots(rows, columns, squeeze=False, **grid)


def dress(axes: Axes, x_label: str = "", y_label: str = "", title: str | None = None) -> None:
    """Set labels and a title, wrapped to the width of the axes."""
    axes.set(xlabel=x_label, ylabel=y_label)
    if title:
        figure, grid = axes.get_figure(), axes.get_gridspec()
        assert isinstance(figure, Figure)
        assert grid is not None
        inches = figure.get_figwidth() / grid.ncols - 0.5
        # A letter is about half as wide as high.
        text = _plain(title, int(inches * 72 / (0.52 * TITLE)))
        axes.set_title(text, fontsize=TITLE, color=INK, loc="left", pad=6)


def add_legend(figure: Figure, *panels: Axes) -> None:
    """Add a legend of the distinct labels of `panels` below them; the figure grows for it."""
    found = [pair for axes in panels for pair in zip(*axes.get_legend_handles_labels())]
    handles = {label: handle for handle, label in reversed(found)}
    labels = list(dict.fromkeys(label for _, label in found))
    if not labels:
        return
    # In widths of a letter's height: half of one for a letter, and the line before it.
    width = figure.get_figwidth() * 72 / LABEL
    texts = [_plain(label, min(40, int(2 * width - 10))) for label in labels]
    longest = max(len(line) for text in texts for line in text.split("\n"))
    columns = max(1, min(int(width / (0.5 * longest + 4.2)), len(labels)))
    lines = max(text.count("\n") + 1 for text in texts) * -(-len(texts) // columns)
    figure.set_figheight(figure.get_figheight() + (1.4 * lines + 0.6) * LABEL / 72)
    shown = [handles[label] for label in labels]
    with _styled():
        figure.legend(shown, texts, loc="outside lower left", ncols=columns)


def save_figure(figure: Figure, path: str | Path) -> Path:
    """Write `figure` as PNG, PDF or SVG, by the ending of `path`, and make its folders.

    Raises:
        InputError: for another ending, or a file that cannot be written.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"{path}: a figure's name must end in .png, .pdf or .svg")
    with new_file(path) as beside, _styled():
        figure.savefig(beside, format=ending[1:], metadata=_UNDATED.get(ending))
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


def _plain(text: str, width: int) -> str:
    """Text in lines of at most `width` characters, in which a dollar sign is not mathematics."""
    return textwrap.fill(str(text), width).replace("$", r"\$")
