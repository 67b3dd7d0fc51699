"""A forecast of a scene's pairs: paths, the most probable state of each step, events."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurosym_jax.plotting.matrix import draw_matrix
from neurosym_jax.plotting.palette import PALETTE
from neurosym_jax.plotting.style import LABEL, SMALL, WIDTH, dress, new_figure
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast_text import PairForecasts

__all__ = ["plot_symbol_forecast"]

PAIRS = 10
"""Pairs that fit the figure."""


def plot_symbol_forecast(
    observed: np.ndarray, samples: np.ndarray, found: PairForecasts, title: str
) -> Figure:
    """A scene's sampled paths beside the states and events of its ten most eventful pairs.

    Args:
        observed: [N, obs_len, 2] metres.
        samples: [k, N, T, 2] metres.
        found: states and events of these samples.
        title: of the figure.
    """
    people, chosen = found.people, found.pairs[:PAIRS]
    height = max(2.4, 1.0 + 0.2 * len(chosen))
    figure, ((where, when, what),) = new_figure(WIDTH, height, 1, 3, width_ratios=(1.1, 1.9, 1.5))
    _draw_samples(where, observed, samples, people)
    dress(where, "x [m]", "y [m]", title)
    rows = [found.likely_states(*pair) for pair in chosen]
    share = np.array([[share for _, share in row] for row in rows])
    draw_matrix(when, share, [[text for text, _ in row] for row in rows], SMALL - 1.5)
    seconds = [f"{found.settings.period * (step + 1):.1f}" for step in range(share.shape[1])]
    when.set_xticks(range(len(seconds)), seconds)
    when.set_yticks(range(len(chosen)), [f"{people[i]} → {people[j]}" for i, j in chosen])
    dress(when, "seconds ahead", "", "most probable state")
    k, l = np.array(chosen).T  # noqa: E741
    probability, medians = found.events.probability[:, k, l].T, found.events.seconds[:, k, l, 1].T
    cells = [
        [f"{100 * p:.0f}%\n{t:.1f} s" if p >= 0.2 and np.isfinite(t) else "" for p, t in zip(*both)]
        for both in zip(probability, medians)
    ]
    draw_matrix(what, np.asarray(probability), cells, SMALL - 2.5)
    names = [event.replace("_", " ") for event in EVENTS]
    what.set_xticks(range(len(names)), names, rotation=90)
    what.set_yticks([])
    dress(what, "", "", "events, median time")
    return figure


def _draw_samples(
    axes: Axes, observed: np.ndarray, samples: np.ndarray, people: np.ndarray
) -> None:
    for i, (person, colour) in enumerate(zip(people, PALETTE * len(people))):
        last = observed[i, -1:]
        for sample in samples[:, i]:
            axes.plot(*np.concatenate([last, sample]).T, color=colour, lw=0.5, alpha=0.3)
        axes.plot(*observed[i].T, "-", color=colour, lw=1.6)
        axes.plot(*last[0], "o", color=colour, ms=4)
        look = {"textcoords": "offset points", "color": colour, "fontsize": LABEL}
        axes.annotate(f"{person}", last[0], (4, 4), **look)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.1)
