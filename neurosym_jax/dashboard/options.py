"""The options of every command that has a live view, and the dashboard they describe."""

import dataclasses
from pathlib import Path

from neurosym_jax.dashboard.dashboard import Dashboard
from neurosym_jax.dashboard.floor_map import read_floor_map
from neurosym_jax.dashboard.moments import Moments
from neurosym_jax.online.predictor import Predictor

__all__ = ["ViewOptions", "make_moments", "open_dashboard"]


@dataclasses.dataclass(frozen=True)
class ViewOptions:
    """A web page of what is seen and forecast."""

    dashboard: bool = False
    """Serve the page while it goes on."""
    port: int = 8765
    """Of the page; 0 for any that is free."""
    host: str = "127.0.0.1"
    """Address to serve at; 0.0.0.0 lets other computers look, without a password."""
    map: Path | None = None
    """The floor underneath: a ROS map's .yaml."""


def make_moments(options: ViewOptions, predictor: Predictor, title: str) -> Moments:
    """How this predictor's stream is told.

    Raises:
        InputError: where the map cannot be read.
    """
    return Moments(
        predictor.models,
        predictor.window.period,
        title=title,
        floor_map=None if options.map is None else read_floor_map(options.map),
        reset_after=predictor.window.reset_after,
    )


def open_dashboard(options: ViewOptions, predictor: Predictor, title: str) -> Dashboard:
    """A dashboard that serves already.

    Raises:
        InputError: where the map cannot be read, or the address cannot be had.
    """
    moments = make_moments(options, predictor, title)
    dashboard = Dashboard(moments, options.host, options.port)
    dashboard.start()
    return dashboard
