"""Forecasts and observed futures as HumansTrajs, the messages of the robot experiment."""

import copy
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.ros.definitions import HUMANS, HUMANS_TRAJS
from neurosym_robot.ros.messages import New, put_stamp

__all__ = ["forecast_message", "make_trajectories", "truth_message"]


def make_trajectories(
    new: New,
    stamp: float,
    steps: ArrayLike,
    ids: np.ndarray,
    xy: ArrayLike,
    covariance: ArrayLike = 0.0,
    frame_id: str = "map",
    confidence: ArrayLike = 1.0,
) -> Any:
    """The HumansTrajs message of positions `xy` [N, T, 2] in metres at `steps` [T] in seconds.

    `ids` are [N], `covariance` [N, T, 2, 2] square metres, `confidence` [N]; `stamp` is that of the
    last step observed.
    """
    positions = np.asarray(xy, np.float64)
    people, length = positions.shape[:2]
    spread = np.zeros((people, length, 6, 6))
    spread[..., :2, :2] = covariance
    spread = spread.reshape(people, length, 36)
    sure = np.broadcast_to(confidence, people).tolist()
    message, empty = new(HUMANS_TRAJS), new("darko_perception_msgs/msg/Human")
    empty.centroid.pose.orientation.w = 1.0
    put_stamp(message.header, stamp, frame_id)
    for step, at in enumerate(np.asarray(steps, np.float64).tolist()):
        now = new(HUMANS)
        put_stamp(now.header, at, frame_id)
        for n in range(people):
            # Only what is written is copied, because a message has thousands of positions.
            human, place = copy.copy(empty), copy.copy(empty.centroid)
            place.pose = copy.copy(place.pose)
            place.pose.position = point = copy.copy(place.pose.position)
            point.x, point.y = positions[n, step].tolist()
            place.covariance = spread[n, step]
            human.id, human.confidence, human.centroid = int(ids[n]) % 2**64, sure[n], place
            now.humans.append(human)
        message.trajs.append(now)
    return message


def forecast_message(
    new: New, forecast: Forecast, model: str, period: float, frame_id: str = "map"
) -> Any:
    """The HumansTrajs of one model: observed steps, then those of its most central sample.

    The covariance of a position is that of the samples around their mean; the confidence of a
    person is the share of observed steps that were seen, not extrapolated.
    """
    result, observed = forecast.models[model], forecast.observed.shape[1]
    around = result.samples - result.mean
    future = result.samples[result.central]
    covariance = np.zeros((len(future), observed + future.shape[1], 2, 2))
    covariance[:, observed:] = np.einsum("k,knti,kntj->ntij", result.weights, around, around)
    everybody = np.arange(len(future))
    confidence = 1 - forecast.extrapolated / observed
    return _with_future(new, forecast, everybody, future, period, frame_id, covariance, confidence)


def truth_message(new: New, forecast: Forecast, period: float, frame_id: str = "map") -> Any:
    """The HumansTrajs of the observed future of those seen to the end; None without any.

    It has the stamp of the forecast, so that the two can be matched.

    Raises:
        InputError: for a forecast that `Analytics` has not completed.
    """
    if forecast.future is None:
        raise InputError("the future of this forecast is not known yet")
    seen = np.flatnonzero(np.isfinite(forecast.future).all(axis=(1, 2)))
    if not len(seen):
        return None
    return _with_future(new, forecast, seen, forecast.future[seen], period, frame_id)


def _with_future(
    new: New,
    forecast: Forecast,
    rows: np.ndarray,
    future: np.ndarray,
    period: float,
    frame_id: str,
    covariance: ArrayLike = 0.0,
    confidence: ArrayLike = 1.0,
) -> Any:
    """Observed steps of some people, then their `future` [N, T, 2]."""
    xy = np.concatenate([forecast.observed[rows], future], axis=1)
    observed = forecast.observed.shape[1]
    steps = forecast.stamp + period * np.arange(1 - observed, xy.shape[1] - observed + 1)
    ids = forecast.ids[rows]
    return make_trajectories(new, forecast.stamp, steps, ids, xy, covariance, frame_id, confidence)
