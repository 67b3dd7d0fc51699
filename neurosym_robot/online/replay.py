"""A stream of frames through stitching, prediction and analytics; as fast as it was, or can be.

`for event in replay(...)` is all there is: screens and files look at the events. Files are opened
elsewhere (`online.recordings`, `online.forecast_files`), the command is `commands.replay`.
"""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.predictor import Forecast, Predictor
from neurosym_robot.tracking.live import NOBODY, OnlineStitcher

__all__ = ["Event", "advance", "replay"]

LONGEST = 10.0
"""Seconds of the recording that are waited for at most between two frames."""


class Event(NamedTuple):
    """What a frame led to."""

    frame: Frame
    """As the predictor saw it, its ids mended where there is a stitcher."""
    forecast: Forecast | None
    """Where the frame completed a step."""
    scored: list[Forecast]
    """Those whose future is known now."""


def advance(
    frame: Frame,
    predictor: Predictor,
    analytics: Analytics,
    stitcher: OnlineStitcher | None = None,
    robot: np.ndarray | None = None,
) -> Event:
    """Push one frame through everything; who is nearest to the `robot` [3] goes first."""
    if stitcher is not None:
        ids = stitcher.push(*frame)
        somebody = ids != NOBODY
        frame = Frame(frame.stamp, ids[somebody], frame.xy[somebody])
    forecast = predictor.push(*frame, focus=None if robot is None else robot[:2])
    scored = [] if forecast is None else analytics.add(forecast)
    return Event(frame, forecast, scored)


def replay(
    frames: Iterable[Frame],
    predictor: Predictor,
    analytics: Analytics,
    *,
    rate: float = math.inf,
    stitcher: OnlineStitcher | None = None,
    robot: Callable[[float], np.ndarray | None] = lambda stamp: None,
) -> Iterator[Event]:
    """Push frames one by one; an event for each.

    At the end, `analytics.finish()` scores the forecasts that still wait.

    Args:
        frames: a live stream or a recording's.
        predictor: of one or several models.
        analytics: their score.
        rate: speed, 1 is that of the stamps; infinite does not wait.
        stitcher: mends ids first, if given.
        robot: where it is [3] at a stamp, if that is known.

    Raises:
        InputError: for a rate that is not positive.
    """
    if not rate > 0:
        raise InputError(f"rate must be positive, not {rate}")
    due, last = time.monotonic(), math.inf
    for frame in frames:
        if math.isfinite(rate) and math.isfinite(frame.stamp):
            due += min(max(frame.stamp - last, 0.0), LONGEST) / rate
            time.sleep(max(0.0, due - time.monotonic()))
            last = frame.stamp
        yield advance(frame, predictor, analytics, stitcher, robot(frame.stamp))
