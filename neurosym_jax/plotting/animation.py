"""A forecast as a GIF: people walk, and lines between them are as wide as alpha."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from neurosym_jax.plotting.palette import PALETTE
from neurosym_jax.plotting.style import dress, new_figure
from neurosym_jax.runtime.files import new_file

__all__ = ["animate_forecast"]

WIDEST = 7.0
"""Width of the line of the largest weight in the scene, points."""
HOLD = 5
"""Steps for which the last frame stays."""


def animate_forecast(
    path: Path,
    position: np.ndarray,
    forecast: np.ndarray,
    alpha: np.ndarray,
    title: str,
    period: float = 0.4,
) -> None:
    """Write the GIF, one frame a step, in real time.

    While people are observed, lines join the pairs, their width the mean of the pair's two weights;
    then the last lines stay, pale, while the samples grow beside the true future.

    Args:
        path: of the file.
        position: [N, T, 2] metres, observed and true future.
        forecast: [k, N, T - obs_len, 2] metres.
        alpha: [N, N, obs_len].
        title: of the figure.
        period: seconds between steps.

    Raises:
        InputError: for a path that cannot be written.
    """
    steps, obs_len = position.shape[1], alpha.shape[-1]
    figure, ((axes,),) = new_figure(5.6, 5.0)
    low, high = _view(position, forecast)
    # Learned weights may be negative.
    weight = abs(alpha + alpha.swapaxes(0, 1)) * ~np.eye(len(position), dtype=bool)[..., None]
    weight = WIDEST * weight / max(float(weight.max()), 1e-12)
    figure.set_dpi(100)
    canvas, frames = FigureCanvasAgg(figure), []
    for step in range(steps):
        for artist in (*axes.lines, *axes.texts):
            artist.remove()
        # All frames have these limits.
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        _links(axes, position[:, step], weight[..., min(step, obs_len - 1)], step >= obs_len)
        for agent, path_ in enumerate(position):
            colour = PALETTE[agent % len(PALETTE)]
            axes.plot(*path_[: min(step + 1, obs_len)].T, color=colour, lw=1.6)
            axes.plot(*path_[step], "o", color=colour, ms=7, zorder=5)
            if step >= obs_len:
                for sample in forecast[:, agent, : step - obs_len + 1]:
                    line = np.concatenate([path_[obs_len - 1 : obs_len], sample])
                    axes.plot(*line.T, color=colour, lw=0.6, alpha=0.35)
                axes.plot(*path_[obs_len - 1 : step + 1].T, ":", color=colour, lw=1.6)
        state = "observed" if step < obs_len else f"forecast, {len(forecast)} samples"
        dress(axes, "x [m]", "y [m]", title)
        seconds = f"{period * (step - obs_len + 1):+.1f} s: {state}"
        axes.text(0.01, 0.99, seconds, transform=axes.transAxes, va="top", fontsize=9)
        canvas.draw()
        figure.set_layout_engine("none")  # The first frame's layout serves all.
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB"))
    shown = [round(1000 * period)] * (steps - 1) + [round(1000 * period * HOLD)]
    with new_file(path) as beside:
        frames[0].save(
            beside, format="GIF", save_all=True, append_images=frames[1:], duration=shown, loop=0
        )


def _view(position: np.ndarray, forecast: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the square that shows all positions, and all but the most distant forecasts."""
    everything = np.concatenate([position.reshape(-1, 2), forecast.reshape(-1, 2)])
    low, high = np.percentile(everything, [1, 99], axis=0)
    low = np.minimum(low, position.min(axis=(0, 1)))
    high = np.maximum(high, position.max(axis=(0, 1)))
    centre, reach = (low + high) / 2, 0.58 * (high - low).max() + 0.3
    return centre - reach, centre + reach


def _links(axes: Axes, place: np.ndarray, width: np.ndarray, pale: bool) -> None:
    """Draw a line between every two people at `place` [N, 2], of `width` [N, N] points."""
    look = {"color": "#888888", "alpha": 0.15 if pale else 0.55, "zorder": 1}
    for i in range(len(place)):
        for j in range(i):
            axes.plot(*place[[i, j]].T, lw=width[i, j], solid_capstyle="round", **look)
