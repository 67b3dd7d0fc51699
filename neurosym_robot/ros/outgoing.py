"""What ROS 1 and ROS 2 are told alike: samples, what pairs will do, lines for RViz, the status.

Messages come from `new(type)`, which gives empty ones: rclpy's own, or `definitions.blank`.
"""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from neurosym_jax.symbolic.calculi import CALCULI
from neurosym_jax.symbolic.states import format_state
from neurosym_robot.online.likely import AT_LEAST, LikelyEvents
from neurosym_robot.online.pair_states import PairStates
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.status import Status
from neurosym_robot.ros.definitions import EVENT, EVENTS, FORECAST, PAIR_STATES, STATES

__all__ = [
    "DIAGNOSTICS",
    "ENDINGS",
    "MARKERS",
    "central_path",
    "diagnostics_message",
    "events_message",
    "makers",
    "markers_message",
    "put_stamp",
    "samples_message",
    "states_message",
]

New = Callable[[str], Any]

DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
MARKERS = "visualization_msgs/msg/MarkerArray"
ENDINGS = {FORECAST: "/samples", EVENTS: "/events", STATES: "/states", MARKERS: "/markers"}
"""How the topics end that a forecast goes to on either ROS, by type; `makers` has what they say."""
COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
"""Of the people's lines, after Okabe and Ito."""
FAINT = 0.35
"""Opacity of somebody whom nobody sees at the moment."""


def put_stamp(header: Any, stamp: float, frame_id: str) -> None:
    """Write time [s] and frame into a header."""
    header.stamp.sec, header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    header.frame_id = frame_id


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
    message.weights = np.full(count, 1 / count, np.float32)
    message.ids, message.extrapolated = forecast.ids, forecast.extrapolated.astype(np.uint32)
    message.position, message.velocity = last.ravel(), velocity.ravel().astype(np.float32)
    message.futures = (result.samples - last[:, None]).ravel().astype(np.float32)
    return message


def markers_message(new: New, forecast: Forecast, model: str, period: float, frame_id: str) -> Any:
    """A line for each person, from the last position observed; `ns` is model and id.

    Lines of people whom nobody sees at the moment are faint.
    """
    array = new(MARKERS)
    markers = []
    paths = central_path(forecast, model).tolist()
    for n, (id, path) in enumerate(zip(forecast.ids.tolist(), paths)):
        marker = new("visualization_msgs/msg/Marker")
        put_stamp(marker.header, forecast.stamp, frame_id)
        marker.ns, marker.type, marker.scale.x = f"{model}/{id}", marker.LINE_STRIP, 0.05
        marker.pose.orientation.w = 1.0
        marker.color.a = FAINT if forecast.extrapolated[n] else 1.0
        colour = [part / 255 for part in COLOURS[n % len(COLOURS)]]
        marker.color.r, marker.color.g, marker.color.b = colour
        # It disappears by itself when nobody is forecast any more.
        marker.lifetime.sec, marker.lifetime.nanosec = divmod(round(2e9 * period), 10**9)
        marker.points = [_point(new, x, y) for x, y in path]
        markers.append(marker)
    array.markers = markers
    return array


def events_message(
    new: New,
    forecast: Forecast,
    model: str,
    period: float,
    frame_id: str,
    at_least: float = AT_LEAST,
) -> Any:
    """The neurosym_msgs/Events of one model: what is at least `at_least` probable."""
    message = new(EVENTS)
    put_stamp(message.header, forecast.stamp, frame_id)
    message.model, message.events = model, []
    for each in LikelyEvents(period, at_least)(forecast, model):
        event = new(EVENT)
        event.name, event.words = each.name, each.words(forecast.ids)
        event.k, event.l = (int(forecast.ids[row]) for row in (each.k, each.l))
        event.probability, event.seconds = each.probability, each.seconds
        message.events.append(event)
    return message


def states_message(new: New, forecast: Forecast, model: str, period: float, frame_id: str) -> Any:
    """The neurosym_msgs/States of one model: how the nearest pairs will move, step by step."""
    message, of = new(STATES), PairStates(period)
    put_stamp(message.header, forecast.stamp, frame_id)
    message.model, message.period, message.pairs = model, period, []
    message.calculus, message.speed = of.settings.calculus, of.settings.speed
    texts = [format_state(state, "") for state in CALCULI[message.calculus].states]
    near, found = of(forecast, model)
    for (k, l), shares, symbols in zip(near.tolist(), *found):  # noqa: E741
        pair = new(PAIR_STATES)
        pair.k, pair.l = int(forecast.ids[k]), int(forecast.ids[l])
        pair.states = [texts[row] for row in shares.argmax(axis=1)]
        pair.probability, pair.symbols = shares.max(axis=1), symbols.ravel()
        message.pairs.append(pair)
    return message


def makers(at_least: float = AT_LEAST) -> dict[str, Callable[..., Any]]:
    """What makes the messages of `ENDINGS`, by type."""
    told = functools.partial(events_message, at_least=at_least)
    return {
        FORECAST: samples_message,
        EVENTS: told,
        STATES: states_message,
        MARKERS: markers_message,
    }


def diagnostics_message(new: New, status: Status, name: str, now: float) -> Any:
    """How the stream goes, for /diagnostics at `now` [s]: 0 is well, 3 is stale."""
    message, row = new(DIAGNOSTICS), new("diagnostic_msgs/msg/DiagnosticStatus")
    put_stamp(message.header, now, "")
    row.name, row.hardware_id = f"{name.removeprefix('/')}: forecasts", "neurosym_jax"
    row.level = row.STALE if status.stale else row.OK
    row.message = status.line()
    row.values = []
    for key, value in {"age [s]": f"{status.age:.1f}", **status.wrong()}.items():
        pair = new("diagnostic_msgs/msg/KeyValue")
        pair.key, pair.value = key, str(value)
        row.values.append(pair)
    message.status = [row]
    return message


def _point(new: New, x: float, y: float) -> Any:
    point = new("geometry_msgs/msg/Point")
    point.x, point.y = x, y
    return point
