"""The curves of a training run: losses, and errors on the validation split."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from neurosym_jax.plotting.style import COLUMN, PALETTE, add_legend, dress, new_figure

__all__ = ["plot_training"]

Curve = tuple[Sequence[float], Sequence[float]]
"""Steps and values."""


def plot_training(
    losses: Mapping[str, Curve], validation: Mapping[str, Curve], title: str | None = None
) -> Figure:
    """Training runs: losses in the upper panel, validation errors (metres) in the lower.

    Both map a name to (steps, values). Beyond 100 points, the running mean over 1/20 is drawn over
    pale points. Values that are not finite leave a gap.
    """
    figure, ((upper,), (lower,)) = new_figure(COLUMN, 3.6, 2, sharex=True)
    colours = cycle(PALETTE)
    for axes, curves in ((upper, losses), (lower, validation)):
        for (name, curve), colour in zip(curves.items(), colours):
            steps, values = (np.asarray(numbers, np.float64) for numbers in curve)
            if len(steps) > 100:
                axes.plot(steps, values, color=colour, linewidth=0.5, alpha=0.3)
                half = len(steps) // 40
                values = np.convolve(values, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid")
                steps = steps[half:-half]
            look = {"linewidth": 1.4, "marker": "o", "markersize": 2.5 if len(steps) <= 40 else 0}
            axes.plot(steps, values, color=colour, label=name, **look)
    dress(upper, "", "loss", title)
    dress(lower, "step", "validation error [m]")
    add_legend(figure, upper, lower)
    return figure
