"""A stream of frames through stitching, prediction and analytics, in real time or faster."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.frames import Frame
from neurosym_robot.online.predictor import Forecast, Predictor
from neurosym_robot.tracking.stitching import OnlineStitcher

__all__ = ["ReplayEvent", "advance", "replay"]

LONGEST = 10.0  # seconds waited at most between two frames


class ReplayEvent(NamedTuple):
    """What follows from a frame."""

    frame: Frame  # as the predictor saw it, with mended ids if there is a stitcher
    forecast: Forecast | None  # if anybody's window is whole
    scored: Sequence[Forecast] = ()  # those whose future is known now
    skipped: int = 0  # older frames that were observed, but not forecast
    age: float = math.nan  # seconds from stamp to forecast, by the recording's clock
    robot: np.ndarray | None = None  # [3] its pose in metres, metres, radians, if known


def advance(
    frames: Sequence[Frame], predictor: Predictor, robot: np.ndarray | None = None
) -> ReplayEvent:
    """Observe all frames, and forecast the newest; those nearest to the `robot` [3] go first."""
    focus = None if robot is None else robot[:2]
    accepted = [frame for frame in frames if predictor.observe(*frame, focus=focus)]
    forecast = predictor.forecast(focus) if accepted else None
    newest = accepted[-1] if accepted else frames[-1]
    return ReplayEvent(newest, forecast, skipped=max(len(accepted) - 1, 0), robot=robot)


def replay(
    frames: Iterable[Frame],
    predictor: Predictor,
    analytics: Analytics,
    *,
    rate: float = math.inf,
    stitcher: OnlineStitcher | None = None,
    robot: Callable[[float], np.ndarray | None] = lambda stamp: None,
) -> Iterator[ReplayEvent]:
    """Push frames one by one; an event for each.

    At the end, `analytics.finish()` scores the forecasts that still wait. `rate` 1 is the speed of
    the stamps, infinite does not wait; `robot` returns the robot's pose [3] at a stamp, if known.

    Raises:
        InputError: for a rate that is not positive.
    """
    if not rate > 0:
        raise InputError(f"rate must be positive, not {rate}")
    due, last = time.monotonic(), math.inf
    for frame in frames:
        if not math.isfinite(rate):
            due = time.monotonic()
        elif math.isfinite(frame.stamp):
            due += min(max(frame.stamp - last, 0.0), LONGEST) / rate
            time.sleep(max(0.0, due - time.monotonic()))
            last = frame.stamp
        mended = frame if stitcher is None else stitcher.mend(frame)[0]
        waited = predictor.waited
        event = advance([mended], predictor, robot(frame.stamp))
        due += predictor.waited - waited  # The recording waits for the compiler.
        age = time.monotonic() - due
        yield event._replace(age=age, scored=analytics.add(event.forecast))
