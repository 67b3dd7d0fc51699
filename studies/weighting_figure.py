"""Draw docs/weighting.png and print the differences of docs/weighting.md, from docs/weighting.csv.

    python -m studies.weighting_figure

A difference is that of two networks' joint ADE of people who interact, seed by seed, in
per cent of the second network's mean. Left out are trainings whose network ignores
neighbours; where they are more than a tenth, the question has no answer.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from neurosym_jax.evaluation.intervals import student_half
from neurosym_jax.plotting.style import (
    COLUMN,
    PALETTE,
    add_legend,
    dress,
    new_figure,
    save_figure,
)

__all__ = ["Difference", "difference", "draw"]

DOCS = Path(__file__).resolve().parents[1] / "docs"
ALIVE, DEAD = 0.95, 0.1
"""Least share of people whom a near neighbour changes; most of the trainings below it."""
BAND = 2.0
"""Per cent: the smallest difference of interest."""
PLACES = ("corridors", "zara2")
ROWS = {
    "papers' weights, small\nmovements ignored": ("papers, quantised", "papers"),
    "the same weights,\ngiven to wrong pairs": ("papers, shuffled", "papers"),
    "papers' weights\nas they are": ("papers, cnd", "papers"),
    "81 learned weights": ("papers, learned", "papers"),
    "no pooling at all": ("papers, none", "papers"),
    "weights in an attention\nover geometry": ("encounter, quantised", "encounter"),
    "attention to symbols,\nagainst no attention": (
        "anchors, symbols",
        "anchors, nothing",
    ),
    "attention to geometry,\nagainst no attention": (
        "anchors, geometry",
        "anchors, nothing",
    ),
    "symbols beside geometry,\nagainst geometry": (
        "anchors, both",
        "anchors, geometry",
    ),
}
"""What a line says, and the two networks of its difference."""


class Difference(NamedTuple):
    """A mean over seeds and half of its 95 % interval, in per cent."""

    mean: float
    half: float
    answered: bool

    def __str__(self) -> str:
        return f"{self.mean:+.1f} ± {self.half:.1f}".replace("-", "−")


def difference(rows: pl.DataFrame, place: str, arm: str, reference: str) -> Difference:
    """`arm` minus `reference` at a place; below 0 the arm is better."""
    errors, answered = [], True
    for name in (arm, reference):
        network = rows.filter(set=place, arm=name)
        near = network.filter(metric="neighbour_near")
        dead = near.filter(pl.col("value") < ALIVE)
        answered &= len(dead) <= DEAD * len(near)
        error = network.filter(metric="interacting joint_ade")
        error = error.join(dead, on="seed", how="anti")
        errors.append(dict(error.select("seed", "value").iter_rows()))
    first, second = errors
    seeds = sorted(first.keys() & second.keys())
    reference_mean = np.mean([second[seed] for seed in seeds])
    percent = [100 * (first[seed] - second[seed]) / reference_mean for seed in seeds]
    return Difference(float(np.mean(percent)), student_half(percent), answered)


def draw(rows: pl.DataFrame, path: Path = DOCS / "weighting.png") -> Path:
    """Draw a line for each difference, a point on it for each place."""
    figure, ((axes,),) = new_figure(1.1 * COLUMN, 4.6)
    axes.axvspan(-BAND, BAND, color="0.92")
    axes.axvline(0, color="0.5", linewidth=1)
    for number, (place, colour) in enumerate(zip(PLACES, PALETTE)):
        shift = 0.3 * number - 0.15
        for line, (arm, reference) in enumerate(ROWS.values()):
            found = difference(rows, place, arm, reference)
            look = {"color": colour if found.answered else "0.65", "markersize": 4.5}
            axes.errorbar(
                found.mean, line + shift, xerr=found.half, fmt="os"[number], **look
            )
        axes.plot([], [], "os"[number], color=colour, label=place)
    axes.set_yticks(range(len(ROWS)), list(ROWS))
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    dress(axes, "change of the error [%]; left is better", "", "")
    return save_figure(add_legend(figure, axes), path)


def main() -> None:
    """Print the differences, and draw them."""
    rows = pl.read_csv(DOCS / "weighting.csv")
    for label, (arm, reference) in ROWS.items():
        cells = [str(difference(rows, place, arm, reference)) for place in PLACES]
        print(label.replace("\n", " "), *cells, sep=" | ")
    print(draw(rows))


if __name__ == "__main__":
    main()
