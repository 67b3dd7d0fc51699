"""Draw docs/figures/nav2.png: a forecast, its regions and its costmap; `python -m studies.costmap`.

People are simulated (seed 1), seen at 10 Hz; the model is `recommended`.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Polygon

from neurosym_jax.plotting import save_figure
from neurosym_jax.simulation.scenarios import simulate
from neurosym_robot.online.predictor import Forecast, Predictor, load_models
from neurosym_robot.ros.costmap import CELL, Costmap
from neurosym_robot.tracking.following import frames_of_tracks

__all__ = ["draw", "forecast_people"]

FIGURE = Path(__file__).resolve().parents[1] / "docs" / "figures" / "nav2.png"
PERIOD = 0.4


def forecast_people(seconds: float = 12.0) -> Forecast:
    """The last forecast of three people who cross each other's ways."""
    predictor = Predictor(load_models([Path("recommended")]), compile="needed")
    forecast = None
    for frame in frames_of_tracks(simulate("cross-path", 1, seconds, people=3)):
        forecast = predictor.push(*frame)
    assert forecast is not None
    return forecast


def draw(forecast: Forecast, file: Path = FIGURE) -> Path:
    """Draw people, what was observed, the draws' regions every 0.8 s, and the costmap beside."""
    (result,) = forecast.models.values()
    now = np.broadcast_to(
        forecast.observed[:, -1:], (len(result.draws), *forecast.ids.shape, 1, 2)
    )
    ways = np.concatenate([now, result.draws], axis=2)
    weights = np.full(len(ways), 1 / len(ways))
    per_cent, corner = Costmap().update(ways, weights, PERIOD)
    rows, columns = per_cent.shape
    extent = (
        corner[0],
        corner[0] + CELL * columns,
        corner[1],
        corner[1] + CELL * rows,
    )
    # Letters of 9 points on 5 inches are legible on a phone.
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(5, 2.6), sharex=True, sharey=True, layout="constrained"
    )
    for axes in (left, right):
        for person, seen in enumerate(forecast.observed):
            axes.plot(*seen.T, color="black", linewidth=1)
            axes.plot(*seen[-1], "o", color="black", markersize=4)
            central = result.samples[result.central, person]
            axes.plot(*central.T, "--", color="tab:blue", linewidth=1.2)
        axes.set_aspect("equal")
        axes.set_xlabel("x, m")
    left.set_ylabel("y, m")
    for step in range(1, result.draws.shape[2], 2):
        for outline in result.regions.outlines(step)[-1]:
            left.add_patch(
                Polygon(outline, fill=False, edgecolor="tab:blue", alpha=0.5)
            )
    left.set_title("90 % regions every 0.8 s")
    image = right.imshow(per_cent, origin="lower", extent=extent, cmap="Reds", vmax=100)
    figure.colorbar(image, ax=right, label="costmap, %")
    right.set_title("costmap")
    figure.set_dpi(200)
    return save_figure(figure, file)


if __name__ == "__main__":
    print(draw(forecast_people()))
