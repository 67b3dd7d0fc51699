"""What the pairs of a scene will do: paths, the most probable state of each step, events."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurosym_jax.plotting.matrix import draw_matrix
from neurosym_jax.plotting.palette import PALETTE
from neurosym_jax.plotting.style import LABEL, SMALL, WIDTH, dress, new_figure

__all__ = ["plot_symbol_forecast"]

PAIRS = 10
"""That fit."""


def plot_symbol_forecast(
    observed: np.ndarray,
    samples: np.ndarray,
    people: np.ndarray,
    pairs: Sequence[tuple[int, int]],
    states: np.ndarray,
    texts: list[str],
    probability: np.ndarray,
    seconds: np.ndarray,
    events: Sequence[str],
    title: str,
    period: float = 0.4,
) -> Figure:
    """A scene's forecast beside what it means: the states and events of its first ten pairs.

    Args:
        observed: [N, obs_len, 2] metres.
        samples: [k, N, T, 2] metres.
        people: [N] ids.
        pairs: of agents, in the order in which they are shown.
        states: [N, N, T, S] probabilities.
        texts: of the S states.
        probability: [E, N, N] of events.
        seconds: [E, N, N, 3] quartiles of their times.
        events: E names.
        title: of the figure.
        period: seconds between steps.
    """
    chosen = list(pairs)[:PAIRS]
    height = max(2.4, 1.0 + 0.2 * len(chosen))
    figure, ((where, when, what),) = new_figure(WIDTH, height, 1, 3, width_ratios=(1.1, 1.9, 1.5))
    _draw_samples(where, observed, samples, people)
    dress(where, "x [m]", "y [m]", title)
    best = np.array([states[pair].argmax(axis=1) for pair in chosen])
    share = np.array([states[pair].max(axis=1) for pair in chosen])
    steps = share.shape[1]
    cells = [[texts[row] for row in rows] for rows in best]
    draw_matrix(when, share, cells, SMALL - 1.5)
    when.set_xticks(range(steps), [f"{period * (step + 1):.1f}" for step in range(steps)])
    when.set_yticks(range(len(chosen)), [f"{people[i]} → {people[j]}" for i, j in chosen])
    dress(when, "seconds ahead", "", "most probable state")
    of_pairs = np.array([probability[:, i, j] for i, j in chosen])
    medians = np.array([seconds[:, i, j, 1] for i, j in chosen])
    cells = [
        [f"{100 * p:.0f}%\n{t:.1f} s" if p >= 0.2 and np.isfinite(t) else "" for p, t in zip(*both)]
        for both in zip(of_pairs, medians)
    ]
    draw_matrix(what, of_pairs, cells, SMALL - 2.5)
    names = [event.replace("_", "\n") for event in events]
    what.set_xticks(range(len(events)), names, rotation=60, ha="right", rotation_mode="anchor")
    what.set_yticks([])
    dress(what, "", "", "events, median time")
    for axes in (when, what):
        axes.grid(visible=False)
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
