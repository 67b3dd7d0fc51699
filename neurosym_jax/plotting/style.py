"""The common look: figures in the style `neurosym.mplstyle`, legends, files, and models' colours.

A model has its own colour and line in every figure. Sizes are a paper's;
`use_style("talk")` draws on a smaller canvas with more dots an inch, so letters and
lines are larger beside the rest.
"""

import math
import textwrap
from collections.abc import Iterable
from contextlib import AbstractContextManager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
import PIL.Image
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from neurosym_jax.errors import InputError
from neurosym_jax.runtime.files import new_file

__all__ = ["COLUMN", "ENDINGS", "INK", "LABEL", "PALETTE", "SMALL", "WIDTH"]
__all__ += ["Style", "add_legend", "colour_bar", "dress", "dress_floor", "model_looks"]
__all__ += ["new_figure", "save_figure", "use_style"]

WIDTH, COLUMN = 7.0, 3.4
"""Width of a figure over both columns of a paper, and over one, inches."""
TITLE, LABEL, SMALL = 9, 8, 7
"""Font sizes, points."""
ENDINGS = (".png", ".pdf", ".svg")
"""Endings of a figure's file."""

Style = Literal["paper", "talk"]
TALK = 0.62
"""Size of a talk's canvas, of a paper's."""
_size = ContextVar("size", default=1.0)

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
"""Those of Okabe and Ito, safe for colour-blind readers, without the yellow that fades on white."""
BLUE, RED, GREEN, PURPLE, AMBER, SKY, GREY = PALETTE
INK = "#222222"
"""Colour of text, and of a line in a legend that stands for those of all people."""

DOTTED, DASHED, DASH_DOT = ":", "--", "-."  # The styles of the robot paper.
# The first part found in a model's title decides; a NeuroSyM's title holds its
# weighting.
_LOOKS = {
    "sampled": ("#999999", (0, (6, 1, 1, 1, 1, 1))),
    "constant": (GREY, DASHED),
    "linear": (GREY, DASHED),
    "anchor table": (SKY, (0, (2, 1))),
    "recommended": (PURPLE, (0, (8, 3))),
    "anchors": (PURPLE, (0, (8, 3))),
    "cnd": (BLUE, DOTTED),
    "ones": (AMBER, DOTTED),
    "learned": (PURPLE, DOTTED),
    "quantised": ("#7A6400", DOTTED),
    "shuffled": ("#882255", DOTTED),
    "neurosym": (BLUE, DOTTED),
    "sgan": (RED, DASH_DOT),
}
_OTHERS = (
    (AMBER, (0, (1, 3))),
    ("#332288", (0, (4, 1, 1, 1, 1, 1))),
    ("#882255", (0, (3, 3))),
    ("#44AA99", (0, (6, 1, 2, 1))),
    (SKY, (0, (2, 1))),
    (PURPLE, (0, (8, 3))),
)
RECORDING = "Recording"
"""Key of a text in a PNG."""
_UNDATED = {".pdf": {"CreationDate": None}, ".svg": {"Date": None}}


def use_style(style: Style) -> None:
    """Draw the figures that follow, in this thread, for a paper (the default) or a talk."""
    _size.set(TALK if style == "talk" else 1.0)


def model_looks(names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """`color` and `linestyle` of each model, for `Axes.plot`.

    NeuroSyM is blue and dotted, SGAN red and dash-dotted, constant velocity grey and
    dashed, and so on. An unknown kind, or a second model of one kind, takes the next of
    a cycle.
    """
    looks: dict[str, Any] = {}
    for name in dict.fromkeys(names):
        own = [look for kind, look in _LOOKS.items() if kind in name.lower()]
        candidates = [*own[:1], *_OTHERS]
        free = [look for look in candidates if look not in looks.values()]
        looks[name] = free[0] if free else _OTHERS[len(looks) % len(_OTHERS)]
    styles = {}
    for name, (colour, line) in looks.items():
        styles[name] = {"color": colour, "linestyle": line}
    return styles


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **grid: Any
) -> tuple[Figure, np.ndarray]:
    """An empty figure, `width` by `height` inches of a paper, and its [rows, columns] axes."""
    layout = ConstrainedLayoutEngine(w_pad=0.05, h_pad=0.05, compress=True)
    size = _size.get()
    with _styled():
        figure = Figure(figsize=(size * width, size * height), layout=layout)
        figure.set_dpi(figure.get_dpi() / size)
        return figure, figure.subplots(rows, columns, squeeze=False, **grid)


def dress(
    axes: Axes, x_label: str = "", y_label: str = "", title: str | None = None
) -> None:
    """Set labels and a title, wrapped to the width of the axes."""
    axes.set(xlabel=x_label, ylabel=_wrapped(y_label, 24))
    if title:
        figure: Any = axes.get_figure()
        grid: Any = axes.get_gridspec()
        inches = figure.get_figwidth() / grid.ncols - 0.5
        # A letter is about half as wide as high.
        text = _wrapped(title, int(inches * 72 / (0.52 * TITLE)))
        axes.set_title(text, fontsize=TITLE, color=INK, loc="left", pad=6)


def dress_floor(axes: Axes, title: str | None = None, y_label: str = "y [m]") -> None:
    """`dress` axes that show the floor: metres are as long along both, and plain numbers."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.ticklabel_format(useOffset=False, style="plain")
    dress(axes, "x [m]", y_label, title)


def add_legend(figure: Figure, *panels: Axes) -> Figure:
    """Add a small legend of the labels of `panels` below; return `figure`, which grows for it."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            handles.setdefault(label, handle)
    # In letters; the line before a text is as wide as eight.
    width = int(figure.get_figwidth() * 72 / SMALL * 2) - 2
    text_width = min(40, width - 8)
    texts = [_wrapped(label, text_width) for label in handles]
    all_lines = "\n".join(texts).split("\n")
    longest = max(map(len, all_lines))
    columns = max(1, min(len(texts), width // (longest + 8)))
    lines = max(text.count("\n") + 1 for text in texts)
    rows = lines * math.ceil(len(texts) / columns)
    inches = (1.4 * rows + 0.6) * SMALL / 72
    figure.set_figheight(figure.get_figheight() + inches)
    with _styled():
        figure.legend(handles.values(), texts, loc="outside lower left", ncols=columns)
    return figure


def colour_bar(figure: Figure, image: Any, axes: Axes, label: str) -> Figure:
    """Add the scale of an image's or a collection's colours beside `axes`; return `figure`."""
    with _styled():
        bar = figure.colorbar(image, ax=axes, pad=0.01, label=label)
    bar.outline.set_visible(False)
    return figure


def save_figure(figure: Figure, path: str | Path, recording: str = "") -> Path:
    """Write `figure` as PNG, PDF or SVG, by the ending of `path`, and make its folders.

    A PNG keeps a text on its `recording`, see `recording_of`.

    Raises:
        InputError: for another ending, or a file that cannot be written.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"{path}: a figure's name must end in .png, .pdf or .svg")
    kind = ending.removeprefix(".")
    metadata = _UNDATED.get(ending)
    if recording and ending == ".png":
        metadata = {RECORDING: recording}
    with new_file(path) as beside, _styled():
        figure.savefig(beside, format=kind, dpi=figure.dpi, metadata=metadata)
    return path


def recording_of(path: Path) -> str:
    """The text that `save_figure` has kept in a PNG; empty in another file."""
    try:
        with PIL.Image.open(path) as image:
            return str(image.info.get(RECORDING, ""))
    except (OSError, ValueError):
        return ""


def _styled() -> AbstractContextManager[None]:
    path = Path(__file__).with_name("neurosym.mplstyle")
    return mpl.rc_context(fname=str(path))


def _wrapped(text: str, width: int) -> str:
    """Text in lines of at most `width` characters, in which a dollar sign is not mathematics."""
    return textwrap.fill(text, width).replace("$", r"\$")
