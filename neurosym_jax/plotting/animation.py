"""Forecasts as an animation: moment by moment where people are, and what they may do next."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.animation import FFMpegWriter, FuncAnimation, PillowWriter
from matplotlib.colors import to_rgb
from PIL import Image

from neurosym_jax.errors import InputError
from neurosym_jax.plotting import style
from neurosym_jax.plotting.forecasts import draw_paths
from neurosym_jax.runtime.files import new_file

__all__ = ["ENDINGS", "Moment", "plot_animation", "save_animation"]

ENDINGS = (".gif", ".mp4")
MARGIN = 1.0
"""Metres around all people who are shown."""
REACH = 0.95
"""Share of forecast positions, along x and along y, that are shown at least."""
WIDTH, DOTS = 5.0, 110
"""Inches, and dots of an inch."""


class Moment(NamedTuple):
    """N people at one step, and what they may do next."""

    people: np.ndarray
    """[N] ids, the same for a person in all moments."""
    observed: np.ndarray
    """[N, obs_len, 2] metres."""
    futures: np.ndarray
    """[n, N, pred_len, 2] metres."""


def plot_animation(
    moments: Sequence[Moment], period: float = 0.4, title: str | None = None
) -> FuncAnimation:
    """An animation with a picture of each moment; each person has a colour.

    Args:
        moments: one after the other, at least one.
        period: seconds between two of them.
        title: of all pictures.
    """
    low, high = _limits(moments)
    left, bottom = low
    right, top = high
    shape = (top - bottom) / (right - left)
    height = WIDTH * float(np.clip(shape, 0.4, 1.0))
    figure, ((axes,),) = style.new_figure(WIDTH, height + 0.5)
    figure.set_dpi(DOTS)
    ids = np.concatenate([moment.people for moment in moments])
    people = np.unique(ids).tolist()
    colours = dict(zip(people, style.PALETTE * len(people)))

    def draw(number: int) -> None:
        axes.clear()
        style.dress_floor(axes, title)
        axes.set_aspect("equal", adjustable="box")
        axes.set(xlim=(left, right), ylim=(bottom, top))
        moment = moments[number]
        for row, person in enumerate(moment.people.tolist()):
            colour = colours[person]
            past = moment.observed[row]
            futures = moment.futures[:, row]
            before = np.repeat(past[None], len(futures), axis=0)
            draw_paths(axes, futures, before, color=colour, linewidth=0.7, alpha=0.4)
            draw_paths(axes, past[None], color=style.INK, linewidth=1.2)
            axes.plot(*past[-1], "o", color=colour, markersize=6)

    interval = 1000 * period
    return FuncAnimation(figure, draw, frames=len(moments), interval=interval)


def _limits(moments: Sequence[Moment]) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner [2] of all people and most of what they may do."""
    ends = np.concatenate([moment.observed[:, -1] for moment in moments])
    low = ends.min(axis=0) - MARGIN
    high = ends.max(axis=0) + MARGIN
    futures = [moment.futures.reshape(-1, 2) for moment in moments]
    points = np.concatenate(futures)
    outside = (1 - REACH) / 2
    least, most = np.quantile(points, [outside, 1 - outside], axis=0)
    return np.minimum(low, least), np.maximum(high, most)


def save_animation(animation: FuncAnimation, path: str | Path, period: float) -> Path:
    """Write an animation as GIF or MP4, by the ending of `path`, at its own speed.

    Raises:
        InputError: for another ending, MP4 without the program ffmpeg, or a file that
            cannot be written.
    """
    path = Path(path)
    check_animation(path)
    writer = FFMpegWriter if path.suffix.lower() == ".mp4" else _GifWriter
    rate: Any = 1 / period  # A film may have 2.5 pictures a second.
    with new_file(path) as beside:
        animation.save(str(beside), writer=writer(fps=rate))
    return path


class _GifWriter(PillowWriter):
    """Writes pictures in the colours of our figures.

    A palette of a picture's own, which Pillow makes, changes the colours of few dots.
    """

    def finish(self) -> None:
        """Write the file."""
        palette = Image.new("P", (1, 1))
        palette.putpalette(_shades().tobytes())
        none = Image.Dither.NONE
        pictures = [frame.convert("RGB") for frame in self._frames]
        self._frames = [
            picture.quantize(palette=palette, dither=none) for picture in pictures
        ]
        super().finish()


def _shades() -> np.ndarray:
    """[n, 3] uint8: every colour of our figures and black, in steps to white."""
    steps = np.linspace(0, 1, 14)[:, None]
    names = (*style.PALETTE, style.INK, "black")
    colours = np.array([to_rgb(name) for name in names])
    shades = steps * colours[:, None] + (1 - steps)
    numbers = (255 * shades).round().astype(np.uint8)
    return np.unique(numbers.reshape(-1, 3), axis=0)


def check_animation(path: Path) -> None:
    """Refuse a name that `save_animation` would refuse.

    Raises:
        InputError: as `save_animation`.
    """
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        raise InputError(f"{path}: an animation's name must end in .gif or .mp4")
    if ending == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError(f"{path}: .mp4 needs the program ffmpeg; .gif needs nothing")
