"""The curves of a training run: losses, and errors on the validation split."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.figure import Figure

from neurosym_jax.errors import InputError
from neurosym_jax.plotting.palette import PALETTE
from neurosym_jax.plotting.style import COLUMN, add_legend, dress, new_figure

__all__ = ["plot_training"]

Curve = tuple[Sequence[float], Sequence[float]]
"""Steps and values."""


def plot_training(
    losses: Mapping[str, Curve], validation: Mapping[str, Curve], title: str | None = None
) -> Figure:
    """Training runs: losses in the upper panel, validation errors (metres) in the lower.

    Both map a name to (steps, values); a panel without curves is left out. Beyond 100 points, the
    running mean over 1/20 is drawn over pale points. Values that are not finite leave a gap.

    Raises:
        InputError: for no curve, or lists of unequal lengths.
    """
    panels = {"loss": losses, "validation error [m]": validation}
    panels = {label: curves for label, curves in panels.items() if curves}
    if not panels:
        raise InputError("there is neither a loss nor a validation curve to plot")
    figure, rows = new_figure(COLUMN, 0.2 + 1.7 * len(panels), len(panels), sharex=True)
    colours = cycle(PALETTE)
    for (axes,), (label, curves) in zip(rows, panels.items()):
        for (name, curve), colour in zip(curves.items(), colours):
            steps, values = (np.asarray(numbers, np.float64) for numbers in curve)
            if steps.ndim != 1 or steps.shape != values.shape:
                raise InputError(f"{name!r}: steps and values are not two lists of one length")
            if len(steps) > 100:
                axes.plot(steps, values, color=colour, linewidth=0.5, alpha=0.3)
                half = len(steps) // 40
                values = np.convolve(values, np.full(2 * half + 1, 1 / (2 * half + 1)), "valid")
                steps = steps[half:-half]
            look = {"linewidth": 1.4, "marker": "o", "markersize": 2.5 if len(steps) <= 40 else 0}
            axes.plot(steps, values, color=colour, label=name, **look)
        last, first = axes is rows[-1, 0], axes is rows[0, 0]
        dress(axes, "step" if last else "", label, title if first else None)
    add_legend(figure, *rows[:, 0])
    return figure
