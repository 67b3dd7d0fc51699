"""Where people go from a place, as arrows on the floor."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from neurosym_jax.models.place.flows import STAYS, Flows
from neurosym_jax.plotting import style

__all__ = ["draw_flows", "plot_flows"]

SURE = 8
"""People from whom on a flow is drawn in full."""
LONGEST = 0.8
"""Length of the longest arrow, metres."""


def plot_flows(flows: Flows, title: str | None = None) -> Figure:
    """What a place taught, `Place.flows()`: darker arrows are surer, dots are people who stay."""
    figure, ((axes,),) = style.new_figure(style.COLUMN, style.COLUMN)
    style.dress(axes, "x [m]", "y [m]", title)
    axes.set_aspect("equal")
    draw_flows(axes, flows)
    return figure


def draw_flows(axes: Axes, flows: Flows) -> None:
    """Draw an arrow for each flow, a quarter of its way long."""
    length = np.linalg.norm(flows.way, axis=1)
    stays = length < STAYS
    support = np.minimum(flows.people / SURE, 1)
    sure = flows.share * support
    # From the faintest on, so that sure ones lie above.
    for row in np.argsort(sure):
        look = {"color": style.INK, "alpha": 0.1 + 0.8 * sure[row], "zorder": 1}
        start = flows.start[row]
        if stays[row]:
            axes.plot(*start, marker="o", markersize=2.5, linestyle="none", **look)
            continue
        drawn_length = min(0.25 * length[row], LONGEST)
        tip = start + drawn_length * flows.way[row] / length[row]
        arrow = {"arrowstyle": "->", "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}
        axes.annotate("", tuple(tip), tuple(start), arrowprops={**arrow, **look})
    if len(flows.start):
        axes.update_datalim(flows.start)
        axes.autoscale_view()
