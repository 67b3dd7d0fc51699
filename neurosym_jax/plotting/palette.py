"""Colours and line styles of all figures: each model has its own, the same in every figure."""

from collections.abc import Iterable, Mapping
from itertools import cycle
from typing import TypeVar

__all__ = ["INK", "PALETTE", "TRUTH", "LineStyle", "line_styles", "model_colours"]

LineStyle = str | tuple[float, tuple[float, ...]]
Look = TypeVar("Look")

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
"""Those of Okabe and Ito, safe for colour-blind readers, without the yellow that fades on white."""
BLUE, RED, GREEN, PURPLE, AMBER, SKY, GREY = PALETTE
OLIVE, WINE = "#7A6400", "#882255"

INK = "#222222"
"""Colour of observed paths and text."""
TRUTH = GREEN
"""Colour of the true future, as in the live view."""

# The first part found in a model's title decides; a NeuroSyM's title holds its weighting.
_COLOURS = {
    "sampled": "#999999",
    "constant": GREY,
    "cv": GREY,
    "linear": GREY,
    "cnd_shipped": SKY,
    "cnd": BLUE,
    "ones": AMBER,
    "learned": PURPLE,
    "quantised": OLIVE,
    "shuffled": WINE,
    "neurosym": BLUE,
    "sgan": RED,
}
_OTHER_COLOURS = (PURPLE, AMBER, SKY, OLIVE, WINE, "#44AA99", "#332288", RED, BLUE)
# The styles of the robot paper.
_STYLES: dict[str, LineStyle] = {
    "neurosym": ":",
    "sgan": "-.",
    "constant": "--",
    "cv": "--",
    "linear": "--",
}
_OTHER_STYLES = (0, (6, 1, 1, 1, 1, 1)), (0, (8, 3)), (0, (1, 3)), (0, (2, 1)), (0, (6, 1, 2, 1))


def model_colours(names: Iterable[str]) -> dict[str, str]:
    """The colour of each model: NeuroSyM blue, SGAN red, constant velocity grey, and so on.

    An unknown kind, or a second model of one kind, takes the next of a cycle.
    """
    return _looks(names, _COLOURS, _OTHER_COLOURS)


def line_styles(names: Iterable[str]) -> dict[str, LineStyle]:
    """The line style of each model: NeuroSyM dotted, SGAN dash-dotted, constant velocity dashed.

    An unknown kind, or a second model of one kind, takes the next of a cycle.
    """
    return _looks(names, _STYLES, _OTHER_STYLES)


def _looks(
    names: Iterable[str], by_kind: Mapping[str, Look], others: Iterable[Look]
) -> dict[str, Look]:
    looks: dict[str, Look] = {}
    rest = cycle(others)
    for name in dict.fromkeys(names):
        look = next((look for kind, look in by_kind.items() if kind in name.lower()), None)
        if look is None or look in looks.values():
            free = (other for other in (next(rest) for _ in others) if other not in looks.values())
            look = next(free, None) or next(rest)
        looks[name] = look
    return looks
