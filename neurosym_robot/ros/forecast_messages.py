"""What a forecast says to others, as messages: the same on a topic of ROS 1 and in a bag."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.ros.messages import make_trajectories

__all__ = ["forecast_message", "truth_message"]


def forecast_message(
    types: Mapping[str, Callable[..., Any]],
    forecast: Forecast,
    model: str,
    period: float,
    frame_id: str = "map",
) -> Any:
    """The HumansTrajs of one model: observed steps, then those of its most central sample.

    The covariance of a position is that of the samples around their mean, the confidence of a
    person the share of the observed steps that were seen and not extrapolated.
    """
    result = forecast.models[model]
    observed = forecast.observed.shape[1]
    xy = np.concatenate([forecast.observed, result.samples[result.central]], axis=1)
    around = result.samples - result.mean
    covariance = np.zeros((*xy.shape, 2))
    covariance[:, observed:] = np.einsum("knti,kntj->ntij", around, around) / len(around)
    steps = forecast.stamp + period * np.arange(1 - observed, xy.shape[1] - observed + 1)
    message = make_trajectories(
        types, forecast.stamp, steps, forecast.ids, xy, covariance, frame_id
    )
    for step in message.trajs:
        for human, lost in zip(step.humans, forecast.extrapolated.tolist()):
            human.confidence = 1 - lost / observed
    return message


def truth_message(
    types: Mapping[str, Callable[..., Any]],
    forecast: Forecast,
    period: float,
    frame_id: str = "map",
) -> Any:
    """The HumansTrajs of what happened to those seen to the end; None if there is nobody.

    It has the stamp of the forecast, so that the two can be put together.

    Raises:
        InputError: for a forecast that `Analytics` has not completed.
    """
    if forecast.future is None:
        raise InputError("the future of this forecast is not known yet")
    seen = np.isfinite(forecast.future).all(axis=(1, 2))
    if not seen.any():
        return None
    xy = np.concatenate([forecast.observed, forecast.future], axis=1)[seen]
    observed = forecast.observed.shape[1]
    steps = forecast.stamp + period * np.arange(1 - observed, xy.shape[1] - observed + 1)
    return make_trajectories(types, forecast.stamp, steps, forecast.ids[seen], xy, None, frame_id)
