"""The messages that we publish: people, forecasts by type of message, the status.

They come from `new(type)`, which returns empty ones: rclpy's own, or `definitions.blank`. The way
from a message to people is `people.py`.
"""

import copy
import functools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neurosym_robot.online.frames import Frame
from neurosym_robot.online.pairs import AT_LEAST, likely_events
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.status import Status
from neurosym_robot.ros.definitions import (
    DIAGNOSTICS,
    EVENTS,
    FORECAST,
    HUMANS,
    HUMANS_TRAJS,
    MARKERS,
    PEOPLE,
)

__all__ = ["ENDINGS", "diagnostics_message", "forecast_message", "forecast_topic", "make_people"]
__all__ += ["make_trajectories", "makers", "truth_message"]

New = Callable[[str], Any]
# Endings of the topics that a forecast goes to, by type; `makers` has what makes the messages.
ENDINGS = {HUMANS_TRAJS: "", FORECAST: "/samples", EVENTS: "/events", MARKERS: "/markers"}
# Colours of people's lines, after Okabe and Ito.
COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
FAINT = 0.35  # opacity of the line of a person who is not seen at the moment
UNITS = {"age": "ms", "p50": "ms", "p99": "ms", "offset": "s", "rate": "Hz", "skipped": "frames"}


def makers(at_least: float = AT_LEAST) -> dict[str, Callable[..., Any]]:
    """Functions (new, forecast, model, period, frame_id) that make the messages of `ENDINGS`."""
    return {
        HUMANS_TRAJS: forecast_message,
        FORECAST: samples_message,
        EVENTS: functools.partial(events_message, at_least=at_least),
        MARKERS: markers_message,
    }


def forecast_topic(model: str) -> str:
    """Topic of a model's forecasts; "NeuroSyM" and "SGAN" have those of the robot experiment."""
    name = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in model)
    name = {"sgan": "baseline"}.get(name.lower(), name.lower())
    return f"/hri/human_poses_prediction_{name}"


def _begun(new: New, kind: str, stamp: float, frame_id: str) -> Any:
    """An empty message with time [s] and frame in its header."""
    message = new(kind)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
    message.header.frame_id = frame_id
    return message


def make_people(new: New, frame: Frame, frame_id: str = "map") -> Any:
    """The People message of a frame."""
    message = _begun(new, PEOPLE, frame.stamp, frame_id)
    for id, (x, y) in zip(frame.ids.tolist(), frame.xy.tolist()):
        person = new("people_msgs/msg/Person")
        person.name, person.reliability = str(id), 1.0
        person.position.x, person.position.y = x, y
        message.people.append(person)
    return message


def make_trajectories(
    new: New,
    steps: ArrayLike,
    ids: np.ndarray,
    xy: ArrayLike,
    covariance: ArrayLike = 0.0,
    frame_id: str = "map",
    confidence: ArrayLike = 1.0,
    now: int = -1,
) -> Any:
    """The HumansTrajs message of positions `xy` [N, T, 2] in metres at `steps` [T] in seconds.

    `ids` are [N], `covariance` [N, T, 2, 2] square metres, `confidence` [N]; the stamp is that of
    the step `now`, the last one observed.
    """
    positions, times = np.asarray(xy, np.float64), np.asarray(steps, np.float64).tolist()
    people, length = positions.shape[:2]
    spread = np.zeros((people, length, 6, 6))
    spread[..., :2, :2] = covariance
    spread = spread.reshape(people, length, 36)
    sure = np.broadcast_to(confidence, people).tolist()
    message = _begun(new, HUMANS_TRAJS, times[now], frame_id)
    empty = new("darko_perception_msgs/msg/Human")
    empty.centroid.pose.orientation.w = 1.0
    for step, at in enumerate(times):
        humans = _begun(new, HUMANS, at, frame_id)
        for n in range(people):
            # Only what is written is copied, because a message has thousands of positions.
            human, place = copy.copy(empty), copy.copy(empty.centroid)
            place.pose = copy.copy(place.pose)
            place.pose.position = point = copy.copy(place.pose.position)
            point.x, point.y = positions[n, step].tolist()
            place.covariance = spread[n, step]
            human.id, human.confidence, human.centroid = int(ids[n]) % 2**64, sure[n], place
            humans.humans.append(human)
        message.trajs.append(humans)
    return message


def forecast_message(
    new: New, forecast: Forecast, model: str, period: float, frame_id: str = "map"
) -> Any:
    """The HumansTrajs of one model: observed steps, then those of its most central sample.

    The covariance of a position is that of the samples around their mean; the confidence of a
    person is the share of observed steps that were seen, not extrapolated.
    """
    result, seen = forecast.models[model], forecast.observed.shape[1]
    xy = np.concatenate([forecast.observed, result.samples[result.central]], axis=1)
    around = result.samples - result.mean
    spread = np.zeros((*xy.shape, 2))
    spread[:, seen:] = np.einsum("k,knti,kntj->ntij", result.weights, around, around)
    steps, sure = _steps(forecast, xy, period), 1 - forecast.extrapolated / seen
    return make_trajectories(new, steps, forecast.ids, xy, spread, frame_id, sure, seen - 1)


def truth_message(new: New, forecast: Forecast, period: float, frame_id: str = "map") -> Any:
    """The HumansTrajs of the observed future of those seen to the end; None without any.

    It has the stamp of the forecast, so that the two can be matched; `Analytics` must have
    completed it.
    """
    assert forecast.future is not None
    xy = np.concatenate([forecast.observed, forecast.future], axis=1)
    whole = np.isfinite(xy).all(axis=(1, 2))
    if not whole.any():
        return None
    steps, now = _steps(forecast, xy, period), forecast.observed.shape[1] - 1
    ids = forecast.ids[whole]
    return make_trajectories(new, steps, ids, xy[whole], frame_id=frame_id, now=now)


def _steps(forecast: Forecast, xy: np.ndarray, period: float) -> np.ndarray:
    """[T] seconds of the steps of `xy` [N, T, 2], observed and future."""
    now = forecast.observed.shape[1] - 1
    return forecast.stamp + period * np.arange(-now, xy.shape[1] - now)


def samples_message(new: New, forecast: Forecast, model: str, period: float, frame_id: str) -> Any:
    """The neurosym_msgs/Forecast of one model."""
    result, message = forecast.models[model], _begun(new, FORECAST, forecast.stamp, frame_id)
    last = forecast.observed[:, -1]
    velocity = (last - forecast.observed[:, -2:-1].mean(axis=1)) / period
    message.model, message.period, message.central = model, period, result.central
    message.samples, _, message.steps, _ = result.samples.shape
    message.weights = result.weights.astype(np.float32)
    message.ids, message.extrapolated = forecast.ids, forecast.extrapolated.astype(np.uint32)
    message.position, message.velocity = last.ravel(), velocity.ravel().astype(np.float32)
    message.futures = (result.samples - last[:, None]).ravel().astype(np.float32)
    return message


def markers_message(new: New, forecast: Forecast, model: str, period: float, frame_id: str) -> Any:
    """A line for each person, from the last position observed; `ns` is model and id.

    Lines of people who are not seen at the moment are faint.
    """
    array, result = new(MARKERS), forecast.models[model]
    array.markers = []
    paths = np.append(forecast.observed[:, -1:], result.samples[result.central], axis=1).tolist()
    for n, (id, path) in enumerate(zip(forecast.ids.tolist(), paths)):
        marker = _begun(new, "visualization_msgs/msg/Marker", forecast.stamp, frame_id)
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
    message = _begun(new, EVENTS, forecast.stamp, frame_id)
    message.model, message.events = model, []
    for each in likely_events(forecast, model, period, at_least):
        event = new("neurosym_msgs/msg/Event")
        event.name, event.words = each.name, each.words(forecast.ids)
        event.k, event.l = (int(forecast.ids[row]) for row in (each.k, each.l))
        event.probability, event.seconds = each.probability, each.seconds
        message.events.append(event)
    return message


def diagnostics_message(new: New, status: Status, name: str, now: float) -> Any:
    """Status of the stream, for /diagnostics at `now` [s]: 0 is well, 3 is stale."""
    message = _begun(new, DIAGNOSTICS, max(now, 0.0), "")
    row = new("diagnostic_msgs/msg/DiagnosticStatus")
    row.name, row.hardware_id = f"{name.removeprefix('/')}: forecasts", "neurosym_jax"
    row.level = row.STALE if status.stale else row.OK
    row.message = status.line()
    said = status.now()
    values = {f"{key} [{unit}]": said[key] for key, unit in UNITS.items()} | said["wrong"]
    row.values = []
    for key, value in values.items():
        pair = new("diagnostic_msgs/msg/KeyValue")
        pair.key, pair.value = key, str(value)
        row.values.append(pair)
    message.status = [row]
    return message
