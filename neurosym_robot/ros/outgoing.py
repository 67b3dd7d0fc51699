"""What is published of a forecast, by type of message, and the status; on ROS 1, ROS 2 and in bags.

Messages come from `new(type)`; see `messages.py`.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from neurosym_robot.online.pairs import AT_LEAST, LikelyEvents
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.status import Status
from neurosym_robot.ros.definitions import EVENTS, FORECAST, HUMANS_TRAJS
from neurosym_robot.ros.messages import New, put_stamp
from neurosym_robot.ros.trajectories import forecast_message

__all__ = ["DIAGNOSTICS", "ENDINGS", "MARKERS", "diagnostics_message", "makers"]

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MARKERS = "visualization_msgs/msg/MarkerArray"
# Endings of the topics that a forecast goes to, by type; `makers` has what makes the messages.
ENDINGS = {HUMANS_TRAJS: "", FORECAST: "/samples", EVENTS: "/events", MARKERS: "/markers"}
# Colours of people's lines, after Okabe and Ito.
COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
FAINT = 0.35  # opacity of the line of a person who is not seen at the moment


def makers(at_least: float = AT_LEAST) -> dict[str, Callable[..., Any]]:
    """Functions (new, forecast, model, period, frame_id) that make the messages of `ENDINGS`."""
    return {
        HUMANS_TRAJS: forecast_message,
        FORECAST: samples_message,
        EVENTS: functools.partial(events_message, at_least=at_least),
        MARKERS: markers_message,
    }


def central_path(forecast: Forecast, model: str) -> np.ndarray:
    """[N, 1 + pred_len, 2] metres: the last position observed, and the most central sample."""
    result = forecast.models[model]
    return np.concatenate([forecast.observed[:, -1:], result.samples[result.central]], axis=1)


def samples_message(new: New, forecast: Forecast, model: str, period: float, frame_id: str) -> Any:
    """The neurosym_msgs/Forecast of one model."""
    result, message = forecast.models[model], new(FORECAST)
    put_stamp(message.header, forecast.stamp, frame_id)
    last = forecast.observed[:, -1]
    velocity = (last - forecast.observed[:, -2:-1].mean(axis=1)) / period
    count, _, steps = result.samples.shape[:3]
    message.model, message.period, message.central = model, period, result.central
    message.samples, message.steps = count, steps
    message.weights = result.weights.astype(np.float32)
    message.ids, message.extrapolated = forecast.ids, forecast.extrapolated.astype(np.uint32)
    message.position, message.velocity = last.ravel(), velocity.ravel().astype(np.float32)
    message.futures = (result.samples - last[:, None]).ravel().astype(np.float32)
    return message


def markers_message(new: New, forecast: Forecast, model: str, period: float, frame_id: str) -> Any:
    """A line for each person, from the last position observed; `ns` is model and id.

    Lines of people who are not seen at the moment are faint.
    """
    array = new(MARKERS)
    array.markers = []
    paths = central_path(forecast, model).tolist()
    for n, (id, path) in enumerate(zip(forecast.ids.tolist(), paths)):
        marker = new("visualization_msgs/msg/Marker")
        put_stamp(marker.header, forecast.stamp, frame_id)
        marker.ns, marker.type, marker.scale.x = f"{model}/{id}", marker.LINE_STRIP, 0.05
        marker.pose.orientation.w = 1.0
        marker.color.a = FAINT if forecast.extrapolated[n] else 1.0
        colour = [part / 255 for part in COLOURS[n % len(COLOURS)]]
        marker.color.r, marker.color.g, marker.color.b = colour
        # The line disappears by itself when forecasts end.
        marker.lifetime.sec, marker.lifetime.nanosec = divmod(round(2e9 * period), 10**9)
        marker.points = []
        for x, y in path:
            point = new("geometry_msgs/msg/Point")
            point.x, point.y = x, y
            marker.points.append(point)
        array.markers.append(marker)
    return array


def events_message(
    new: New,
    forecast: Forecast,
    model: str,
    period: float,
    frame_id: str,
    at_least: float = AT_LEAST,
) -> Any:
    """The neurosym_msgs/Events of one model: events with probability `at_least` or more."""
    message = new(EVENTS)
    put_stamp(message.header, forecast.stamp, frame_id)
    message.model, message.events = model, []
    for each in LikelyEvents(period, at_least)(forecast, model):
        event = new("neurosym_msgs/msg/Event")
        event.name, event.words = each.name, each.words(forecast.ids)
        event.k, event.l = (int(forecast.ids[row]) for row in (each.k, each.l))
        event.probability, event.seconds = each.probability, each.seconds
        message.events.append(event)
    return message


def diagnostics_message(new: New, status: Status, name: str, now: float) -> Any:
    """Status of the stream, for /diagnostics at `now` [s]: 0 is well, 3 is stale."""
    message, row = new(DIAGNOSTICS), new("diagnostic_msgs/msg/DiagnosticStatus")
    put_stamp(message.header, max(now, 0.0), "")
    row.name, row.hardware_id = f"{name.removeprefix('/')}: forecasts", "neurosym_jax"
    row.level = row.STALE if status.stale else row.OK
    row.message = status.line()
    said = status.now()
    units = {
        "age": "ms",
        "p50": "ms",
        "p99": "ms",
        "offset": "s",
        "rate": "Hz",
        "skipped": "frames",
    }
    values = {f"{key} [{unit}]": said[key] for key, unit in units.items()} | status.wrong()
    row.values = []
    for key, value in values.items():
        pair = new("diagnostic_msgs/msg/KeyValue")
        pair.key, pair.value = key, str(value)
        row.values.append(pair)
    message.status = [row]
    return message
