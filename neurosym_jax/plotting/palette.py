"""The colours and lines of all figures: each model has its own, the same in every figure."""

from collections.abc import Iterable, Mapping
from itertools import cycle
from typing import TypeVar

__all__ = [
    "AMBER",
    "BLUE",
    "GREEN",
    "GREY",
    "INK",
    "PALETTE",
    "PURPLE",
    "RED",
    "SKY",
    "TRUTH",
    "LineStyle",
    "line_styles",
    "model_colours",
]

LineStyle = str | tuple[float, tuple[float, ...]]
Look = TypeVar("Look")

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#4D4D4D")
"""Those of Okabe and Ito, safe for colour-blind readers, less the yellow that fades on white."""
BLUE, RED, GREEN, PURPLE, AMBER, SKY, GREY = PALETTE

INK = "#222222"
"""Of what is known: observed paths, text."""
TRUTH = GREEN
"""Of what happened after the observation, as in the live view."""

# The first part that is found in a model's name decides. A NeuroSyM is named by its weighting, too.
_COLOURS = {
    "sampled": "#999999",
    "constant": GREY,
    "cv": GREY,
    "linear": GREY,
    "cnd_shipped": SKY,
    "cnd": BLUE,
    "ones": AMBER,
    "learned": PURPLE,
    "quantised": "#7A6400",
    "shuffled": "#882255",
    "neurosym": BLUE,
    "sgan": RED,
}
_OTHER_COLOURS = (PURPLE, AMBER, SKY, "#7A6400", "#882255", "#44AA99", "#332288", RED, BLUE)
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

    Another kind, or a second model of one kind, takes the next of a cycle.
    """
    return _looks(names, _COLOURS, _OTHER_COLOURS)


def line_styles(names: Iterable[str]) -> dict[str, LineStyle]:
    """The line style of each model: NeuroSyM dotted, SGAN dash-dotted, constant velocity dashed.

    Another kind, or a second model of one kind, takes the next style of a cycle of five.
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
