"""A forecast as a GIF: people walk, the lines between them are as wide as alpha says."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from neurosym_jax.plotting.palette import PALETTE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["animate_forecast"]

WIDEST = 9.0
"""Points, of the line of the largest weight in the scene."""
PERIOD = 0.4
HOLD = 4
"""Frames for which the end stays."""


def animate_forecast(
    path: Path, position: np.ndarray, forecast: np.ndarray, alpha: np.ndarray, title: str
) -> None:
    """Write the GIF, one frame a step, in the time in which it happened.

    While people are observed, lines join the pairs, their width the mean of the pair's two weights;
    then the samples grow from where everybody was last, beside what happened.

    Args:
        path: where to.
        position: [N, T, 2] metres, observed and what happened then.
        forecast: [k, N, T - obs_len, 2] metres.
        alpha: [N, N, obs_len].
        title: of the figure.
    """
    from matplotlib.animation import PillowWriter
    from matplotlib.figure import Figure

    steps, obs_len = position.shape[1], alpha.shape[-1]
    figure = Figure(figsize=(7, 6.2), layout="constrained", facecolor="white")
    axes = figure.subplots()
    everything = np.concatenate([position.reshape(-1, 2), forecast.reshape(-1, 2)])
    # Samples that go far would make everything else small.
    low, high = np.percentile(everything, [1, 99], axis=0)
    low = np.minimum(low, position.min(axis=(0, 1)))
    high = np.maximum(high, position.max(axis=(0, 1)))
    margin = 0.08 * (high - low).max() + 0.3
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = PillowWriter(fps=1 / PERIOD)  # pyright: ignore[reportArgumentType]
    writer.setup(figure, str(path), dpi=80)
    for frame in range(steps + HOLD):
        step = min(frame, steps - 1)
        axes.clear()
        # The limits that keep the aspect for all frames alike.
        axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
        axes.set_aspect("equal", adjustable="box")
        _links(axes, position, alpha, min(step, obs_len - 1), faint=step >= obs_len)
        for agent, colour in enumerate(PALETTE[i % len(PALETTE)] for i in range(len(position))):
            walked = position[agent, : min(step, obs_len - 1) + 1]
            axes.plot(*walked.T, color=colour, lw=2)
            axes.plot(*position[agent, step], "o", color=colour, ms=9, zorder=5)
            if step >= obs_len:
                last = position[agent, obs_len - 1 : obs_len]
                for sample in forecast[:, agent, : step - obs_len + 1]:
                    line = np.concatenate([last, sample])
                    axes.plot(*line.T, color=colour, lw=0.8, alpha=0.35)
                axes.plot(*position[agent, obs_len - 1 : step + 1].T, ":", color=colour, lw=2)
        state = "observed" if step < obs_len else f"forecast, {len(forecast)} samples"
        axes.set_title(f"{title}\n{PERIOD * (step - obs_len + 1):+.1f} s: {state}", loc="left")
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.grid(color="#EEEEEE")
        writer.grab_frame()
    writer.finish()


def _links(axes: "Axes", position: np.ndarray, alpha: np.ndarray, step: int, faint: bool) -> None:
    """A line between every two people, as wide as their weight at `step`."""
    others = alpha * ~np.eye(len(position), dtype=bool)[..., None]
    highest = max(float(abs(others).max()), 1e-12)
    for i in range(len(position)):
        for j in range(i):
            # Learned weights may be negative.
            weight = abs(alpha[i, j, step] + alpha[j, i, step]) / 2 / highest
            ends = position[[i, j], step].T
            look = {"color": "#888888", "alpha": 0.2 if faint else 0.6, "zorder": 1}
            axes.plot(*ends, lw=WIDEST * weight, solid_capstyle="round", **look)
