"""Draw docs/figures/qtc_symbols.png and events.png: what symbols of QTC_C1 and events mean.

Each is drawn a second time with fewer panels in a row, for phones.

python -m studies.draw_symbols

The symbols, and when an event happens, are computed, not typed.
"""

import textwrap
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle

from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import symbolic_events
from neurosym_jax.symbolic.qtc import Convention, format_state, observe

K, L = np.array([0.0, 0.0]), np.array([3.2, 0.0])
BLUE, ORANGE, INK, GREY = "#0072B2", "#D55E00", "#222222", "#777777"
TOWARDS, AWAY = "#E3EFF8", "#FBF1E6"
FRAME = (-2.2, 4.1, -2.35, 2.35)
SIGNS = str.maketrans("-", "−")

WALKS = {
    "approaches": (((0, 0), (1, 0)), ((3.4, 0.6), (0, 0))),
    "passes_left": (((0, 0), (1, 0)), ((1.5, 1), (0, 0))),
    "passes_right": (((0, 0), (1, 0)), ((4.1, -1), (-0.6, 0))),
    "crosses_before": (((-1.5, 0), (1, 0)), ((0.2, -3.2), (0, 0.7))),
    "crosses_behind": (((-1.5, 0), (1, 0)), ((0, 0.4), (0, 0.8))),
    "follows": (((0, 0), (1, 0)), ((1.4, 0.3), (1, 0))),
    "overtakes": (((0, 0), (1.5, 0)), ((0.6, 0.7), (0.8, 0))),
    "meets": (((0, 0), (0.9, 0.1)), ((4.6, 0.6), (-0.9, 0))),
}
"""(Start in metres, velocity in m/s) of k and of l who do it."""


def draw_events(path: Path, columns: int = 3) -> None:
    """Write the figure of all events, each with two who do it."""
    rows = -(-(len(WALKS) + 1) // columns)
    size = 3.2 * columns, 3.2 * rows
    figure = Figure(figsize=size, dpi=130, facecolor="white", layout="constrained")
    panels = figure.subplots(rows, columns).ravel()
    for axes in panels[len(WALKS) :]:
        axes.axis("off")
    t = 0.4 * np.arange(9)[:, None]
    for axes, (name, walks) in zip(panels, WALKS.items()):
        paths = np.stack(
            [np.array(start) + t * np.array(speed) for start, speed in walks]
        )
        events = symbolic_events(
            paths[None, :, 1:], paths[:, :1], events=(name,), smoothing=0.0
        )
        seconds = float(events.seconds[0, 0, 1, 1])
        assert np.isfinite(seconds), f"{name} does not happen"
        at = round(seconds / 0.4)
        for way, letter, colour in zip(paths, "kl", (BLUE, ORANGE)):
            axes.plot(*way.T, "o-", color=colour, ms=3, lw=1.2, alpha=0.55)
            if np.ptp(way, axis=0).any():
                step(axes, way[-2], way[-1], colour)
            agent(axes, way[0], letter, colour, (-0.3 if letter == "k" else 0.3, 0.0))
            ring = {
                "facecolor": "none",
                "edgecolor": INK,
                "linewidth": 1.6,
                "zorder": 5,
            }
            axes.add_patch(Circle((way[at, 0], way[at, 1]), 0.2, **ring))
        x, y = (paths.min(axis=(0, 1)) + paths.max(axis=(0, 1))) / 2
        frame(axes, (x - 2.9, x + 2.9, y - 2.1, y + 2.1))
        axes.set_title(
            f"{name}, {seconds:.1f} s", fontsize=13, color=INK, loc="left", pad=8
        )
        words_of = textwrap.fill(EVENTS[name].sentence, 40)
        axes.set_xlabel(words_of, fontsize=9.5, color=GREY, loc="left")
    legend = "Big dots: where they were seen last.\nSmall ones: each 0.4 s after.\n\n"
    legend += (
        "Rings: where they are when the\nevent happens, at the time beside\nits name."
    )
    panels[len(WALKS)].text(0, 0.9, legend, fontsize=11.5, color=INK, va="top")
    figure.savefig(path)


def draw(path: Path, columns: int = 3) -> None:
    """Write the figure."""
    size = 4.13 * columns, 3.75 * 3 / columns
    figure = Figure(figsize=size, dpi=130, facecolor="white", layout="constrained")
    panels = figure.subplots(3 // columns, columns).ravel()
    titles = ("q1 q3 by distance (papers)", "q1 q3 by the line (QSRlib)")
    for axes, convention, title in zip(panels, ("distance", "line"), titles):
        regions(axes, convention)
        axes.set_title(title, fontsize=13, color=INK, loc="left", pad=8)
    example(panels[2])
    panels[2].set_title(
        "a state of the pair k, l", fontsize=13, color=INK, loc="left", pad=8
    )
    figure.savefig(path)


def regions(axes: Axes, convention: Convention) -> None:
    """Where k's next position makes q1 and q3 which: the plane cut by a border and by the line."""
    left, right, bottom, top = FRAME
    axes.add_patch(
        Rectangle((left, bottom), right - left, top - bottom, color=AWAY, zorder=0)
    )
    border = {
        "edgecolor": GREY,
        "linewidth": 1.4,
        "linestyle": (0, (5, 3)),
        "zorder": 1,
    }
    if convention == "distance":
        axes.add_patch(Circle((L[0], L[1]), L[0] - K[0], facecolor=TOWARDS, **border))
    else:
        half = [
            (0, bottom - 1),
            (right + 1, bottom - 1),
            (right + 1, top + 1),
            (0, top + 1),
        ]
        axes.add_patch(Polygon(half, facecolor=TOWARDS, **border))
    axes.plot(
        [left, right],
        [0, 0],
        color=GREY,
        linewidth=1.4,
        linestyle=(0, (5, 3)),
        zorder=1,
    )
    for end in (
        (1.35, 1.05),
        (1.35, -1.05),
        (-1.15, 1.05),
        (-1.15, -1.05),
        (0.0, 1.75),
    ):
        step(axes, K, np.array(end), BLUE)
        q1, _, q3, _ = state(np.array(end), L, convention)
        beside = (
            (0.24 * np.sign(end[0]), 0.29 * np.sign(end[1]))
            if end[0]
            else (-0.5, -0.15)
        )
        at = np.array(end) + np.array(beside)
        label(axes, at, f"{q1} {q3}", BLUE)
    agent(axes, K, "k", BLUE, (0.3, -0.66))
    agent(axes, L, "l", ORANGE, (0.0, -0.42))
    words(axes, (2.62, 2.08), "q1 −  towards l")
    words(axes, (-1.22, 2.08), "q1 +  away")
    words(axes, (-1.5, 0.2), "q3 −  left")
    words(axes, (-1.5, -0.2), "q3 +  right")
    frame(axes)


def example(axes: Axes) -> None:
    """One step of both, and its four symbols with what they say."""
    k1, l1 = np.array([1.25, 0.95]), np.array([3.35, -1.15])
    axes.plot(
        [K[0], L[0]], [0, 0], color=GREY, linewidth=1.4, linestyle=(0, (5, 3)), zorder=1
    )
    step(axes, K, k1, BLUE)
    step(axes, L, l1, ORANGE)
    agent(axes, K, "k", BLUE, (-0.3, -0.05))
    agent(axes, L, "l", ORANGE, (0.3, 0.05))
    symbols = state(k1, l1, "distance")
    meaning = (
        (BLUE, "q1", "k", {"−": "towards l", "+": "away from l", "0": "neither"}),
        (ORANGE, "q2", "l", {"−": "towards k", "+": "away from k", "0": "neither"}),
        (
            BLUE,
            "q3",
            "k",
            {"−": "left of k→l", "+": "right of k→l", "0": "along the line"},
        ),
        (
            ORANGE,
            "q4",
            "l",
            {"−": "left of l→k", "+": "right of l→k", "0": "along the line"},
        ),
    )
    for row, (symbol, (colour, name, who, words_of)) in enumerate(
        zip(symbols, meaning)
    ):
        y = -0.72 - 0.42 * row
        axes.text(-2.0, y, name, color=GREY, fontsize=11.5, va="center")
        label(axes, np.array([-1.35, y]), symbol, colour)
        sentence = f"{who} moves {words_of[symbol]}"
        axes.text(-1.05, y, sentence, color=INK, fontsize=11.5, va="center")
    bold = {"fontsize": 17, "va": "center", "fontweight": "bold"}
    axes.text(-2.0, 1.9, "( " + "  ".join(symbols) + " )", color=INK, **bold)
    frame(axes)


def state(k1: np.ndarray, l1: np.ndarray, convention: Convention) -> list[str]:
    """The four symbols, as printed, of one step from K and L."""
    states = observe(np.stack([K, k1]), np.stack([L, l1]), convention=convention)
    return format_state(states[0]).translate(SIGNS).split()


def step(axes: Axes, start: np.ndarray, end: np.ndarray, colour: str) -> None:
    """Draw an arrow from a position to the next."""
    look = {
        "arrowstyle": "-|>,head_length=0.5,head_width=0.22",
        "color": colour,
        "linewidth": 2,
    }
    gaps = {"shrinkA": 7, "shrinkB": 0}
    tip, tail = (end[0], end[1]), (start[0], start[1])
    axes.annotate("", tip, tail, arrowprops={**look, **gaps}, zorder=3)


def agent(
    axes: Axes, at: np.ndarray, name: str, colour: str, offset: tuple[float, float]
) -> None:
    """A dot with its name."""
    axes.plot(*at, "o", markersize=11, color=colour, zorder=4)
    look = {"fontsize": 15, "style": "italic", "ha": "center", "va": "center"}
    axes.text(at[0] + offset[0], at[1] + offset[1], name, color=colour, **look)


def label(axes: Axes, at: np.ndarray, text: str, colour: str) -> None:
    """Symbols, centred."""
    look = {
        "fontsize": 14,
        "fontweight": "bold",
        "ha": "center",
        "va": "center",
        "zorder": 5,
    }
    axes.text(at[0], at[1], text, color=colour, **look)


def words(axes: Axes, at: tuple[float, float], text: str) -> None:
    """What a region means."""
    axes.text(*at, text, color=GREY, fontsize=10.5, ha="center", va="center", zorder=5)


def frame(axes: Axes, extent: tuple[float, float, float, float] = FRAME) -> None:
    """Show an extent, with nothing around it."""
    left, right, bottom, top = extent
    axes.set(
        xlim=(left, right), ylim=(bottom, top), aspect="equal", xticks=[], yticks=[]
    )
    for spine in axes.spines.values():
        spine.set_color("#CCCCCC")


if __name__ == "__main__":
    figures = Path(__file__).parents[1] / "docs/figures"
    draw(figures / "qtc_symbols.png")
    draw(figures / "qtc_symbols_phone.png", columns=1)
    draw_events(figures / "events.png")
    draw_events(figures / "events_phone.png", columns=2)
