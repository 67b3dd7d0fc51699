"""Draw the gallery of figures, and those of home: `python -m studies.gallery DATA`.

DATA is ETH/UCY (`neurosym download eth-ucy`). The gallery is made by the code of its
page, docs/reference/plotting.md; wide ones have the large letters of a talk, for phones.
Home shows zara1 and `recommended`, which did not learn from it, 8 + 12 steps:
one scene of seven people who walk, and 16 s of the recording as an animation. Its three
doors have pictures without letters. Seeds are 0.
"""

import itertools
import re
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from neurosym_jax import load_model, predict, predict_distribution
from neurosym_jax.data.recordings import open_source
from neurosym_jax.data.tracks import PERIOD
from neurosym_jax.data.windows import Windows, cut_windows
from neurosym_jax.evaluation.metrics import METRICS
from neurosym_jax.plotting import plot_forecasts, save_figure
from neurosym_jax.plotting.animation import Moment, plot_animation, save_animation
from neurosym_jax.plotting.style import INK, PALETTE, use_style
from neurosym_jax.symbolic import make_weighting

__all__ = ["draw", "draw_home"]

DOCS = Path(__file__).resolve().parents[1] / "docs"
CODE = re.compile(r"(?:\(\.\./figures/(\w+)\.png\)\n\n)?```python\n(.*?)```", re.DOTALL)
"""Code, and the name of the figure above it; the first code begins all others."""
WIDE = 1300
"""Most dots of a figure's width."""
PLACE, PEOPLE, MOMENTS = "zara1", 7, 40
DRAWS = 30
LARGE = ("gallery_forecasts",)
FLOOR = (230, 130, 420)
"""Left, top and width of what home shows of the live page, dots."""


def draw(data: str, folder: Path = DOCS / "figures") -> list[Path]:
    """Draw the figures of the page into `folder`."""
    page = (DOCS / "reference" / "plotting.md").read_text()
    section = page.split("\n## Gallery\n")[1].replace('"eth-ucy"', repr(data))
    (_, start), *figures = CODE.findall(section)
    paths = []
    for name, code in figures:
        names: dict[str, Any] = {}
        use_style("talk" if name in LARGE else "paper")
        with mock.patch.dict(METRICS):
            exec(start + code, names)
        use_style("paper")
        path = save_figure(names["figure"], folder / f"{name}.png")
        shrink(path)
        paths.append(path)
    return paths


def shrink(path: Path) -> None:
    """Write a picture again with 256 colours, and at most `WIDE` dots wide."""
    image = Image.open(path).convert("RGB")
    image.thumbnail((WIDE, 2 * WIDE))
    image.quantize(dither=Image.Dither.NONE).save(path, optimize=True)


def draw_home(data: str, folder: Path = DOCS / "figures") -> list[Path]:
    """Draw `home.png`, a scene with its forecasts, and the animation `home.gif`."""
    source = open_source(Path(data), PLACE)
    windows = cut_windows(source.recordings(PLACE), 8, 12)
    model = load_model("recommended", dataset=PLACE, pred_len=12)
    scene = windows.take(slice(*_lively(windows)))
    past, future = np.split(scene.position, [8], axis=1)
    title = f"{PLACE}: what {PEOPLE} people may do in the next 4.8 s"
    use_style("talk")
    figure = plot_forecasts(past, future, {"recommended": predict(model, past)}, title)
    use_style("paper")
    picture = save_figure(figure, folder / "home.png")
    shrink(picture)
    animation = _animate(model, windows, folder / "home.gif")
    return [picture, animation, *_draw_doors(past, predict(model, past), folder)]


def _draw_doors(past: np.ndarray, samples: np.ndarray, folder: Path) -> list[Path]:
    """Pictures of 3 by 2: a scene's forecasts, weights of its pairs, and the live page's floor."""
    forecasts, (axes,) = _empty(past, samples)
    for person, colour in zip(range(len(past)), itertools.cycle(PALETTE)):
        now = np.broadcast_to(past[person, -1:], (len(samples), 1, 2))
        ways = np.concatenate([now, samples[:, person]], axis=1)
        axes.plot(*ways.transpose(2, 1, 0), color=colour, alpha=0.3, linewidth=1)
        axes.plot(*past[person].T, color=INK, linewidth=2)
        axes.plot(*past[person, -1], "o", color=colour, markersize=9)
    pairs, (axes,) = _empty(past, past[None])
    weigh = make_weighting("quantised", period=PERIOD)
    alpha = np.asarray(weigh(past, np.ones(len(past), bool)))[..., -1]
    for pair in itertools.combinations(range(len(past)), 2):
        width = 60 * (alpha[pair] - alpha[alpha > 0].min()) + 0.8
        axes.plot(*past[list(pair), -1].T, color=PALETTE[0], alpha=0.5, linewidth=width)
    for person in past:
        axes.plot(*person.T, color=INK, linewidth=2)
        axes.plot(*person[-1], "o", color=PALETTE[1], markersize=9)
    paths = [folder / f"door_{name}.png" for name in ("forecasts", "pairs", "robot")]
    for figure, path in zip((forecasts, pairs), paths):
        save_figure(figure, path)
    left, upper, width = FLOOR
    page = Image.open(folder / "dashboard.png").convert("RGB")
    page.crop((left, upper, left + width, upper + 2 * width // 3)).save(paths[-1])
    for path in paths:
        shrink(path)
    return paths


def _empty(past: np.ndarray, samples: np.ndarray) -> tuple[Figure, tuple[Axes]]:
    """A figure of 3 by 2 without axes, wide enough for all positions but the farthest samples."""
    figure = Figure(figsize=(3, 2), dpi=220)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.axis("off")
    points = np.concatenate([past.reshape(-1, 2), samples.reshape(-1, 2)])
    low, high = np.percentile(points, (2, 98), axis=0)
    width = max(high[0] - low[0], 1.5 * (high[1] - low[1])) + 1
    x, y = (low + high) / 2
    axes.set(xlim=(x - width / 2, x + width / 2), ylim=(y - width / 3, y + width / 3))
    return figure, (axes,)


def _lively(windows: Windows) -> tuple[int, int]:
    """The scene of `PEOPLE` people in which the slowest goes farthest, as a range."""
    (candidates,) = np.nonzero(windows.sizes == PEOPLE)
    farthest, best = 0.0, int(candidates[0])
    for number in candidates:
        position = windows.take(slice(number, number + 1)).position
        way = np.linalg.norm(position[:, -1] - position[:, 0], axis=-1).min()
        if way > farthest:
            farthest, best = float(way), int(number)
    return best, best + 1


def _animate(model: Any, windows: Windows, path: Path) -> Path:
    """Write successive moments of the recording, and at each what everybody may do next."""
    first = _lively(windows)[0] - 3
    moments = []
    for number in range(first, first + MOMENTS):
        scene = windows.take(slice(number, number + 1))
        past, _ = np.split(scene.position, [8], axis=1)
        draws = predict_distribution(model, past, draws=DRAWS, seed=0)
        moments.append(Moment(scene.agent, past, draws))
    title = f"{PLACE}: the next 4.8 s, by recommended"
    save_animation(plot_animation(moments, title=title), path, PERIOD)
    return path


if __name__ == "__main__":
    print(*draw(sys.argv[1]), *draw_home(sys.argv[1]), sep="\n")
