"""The messages that we publish: people, forecasts by type of message, the status.

They come from `new(type)`, which returns empty ones, as `definitions.blank`. The way
from a message to people is `people.py`.
"""

import copy
import functools
import itertools
import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_robot.online.pairs import AT_LEAST, likely_events
from neurosym_robot.online.predictor import Forecast
from neurosym_robot.online.regions import LEVELS
from neurosym_robot.online.status import Status
from neurosym_robot.ros.costmap import CELL, Costmap
from neurosym_robot.ros.definitions import (
    DIAGNOSTICS,
    EVENTS,
    FORECAST,
    FORECAST_TOPIC,
    GRID,
    HUMANS,
    HUMANS_TRAJS,
    MARKER,
    MARKERS,
    PEOPLE,
)
from neurosym_robot.tracking.following import Frame
from neurosym_robot.tracking.names import name_of

New = Callable[..., Any]
# Red, green and blue of people's lines, after Okabe and Ito.
COLOURS = [(0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0)]
LAYERS = (1, 2, 3)  # seconds ahead of costmaps of single moments
FAINT = 0.35  # opacity of the line of a person who is not seen at the moment
UNITS = {"age": "ms", "p50": "ms", "p99": "ms", "offset": "s", "rate": "Hz"}
UNITS |= {"lag": "s", "skipped": "frames"}


class Output(NamedTuple):
    """A topic of one model's forecasts."""

    topic: str
    kind: str
    model: str
    make: Callable[..., Any]
    """Returns the message of (new, forecast, model, period, frame_id)."""
    live: bool = False
    """Whether it is published in a graph only, not written to bags."""


def outputs(
    models: Iterable[str], at_least: float = AT_LEAST, events: bool = True
) -> list[Output]:
    """The topics of each model; the first model's bear no model's name.

    So what listens needs no change when the model does. Events, which need JAX, have a
    probability of `at_least` or more.
    """
    rows = []
    for number, model in enumerate(models):
        base = FORECAST_TOPIC
        if number:
            base += "_" + re.sub(r"\W", "_", model, flags=re.ASCII)
        likely = functools.partial(events_message, at_least=at_least)
        rows += [
            Output(base, HUMANS_TRAJS, model, forecast_message),
            Output(f"{base}/samples", FORECAST, model, samples_message),
        ]
        if events:
            rows.append(Output(f"{base}/events", EVENTS, model, likely))
        rows += [
            Output(f"{base}/markers", MARKERS, model, markers_message, live=True),
            Output(f"{base}/costmap", GRID, model, CostmapMaker()),
        ]
        for ahead in LAYERS:
            layer = f"{base}/costmap/in_{ahead}s"
            rows.append(Output(layer, GRID, model, CostmapMaker(ahead), live=True))
    return rows


def filled(message: Any, /, **fields: Any) -> Any:
    """The message with values in its fields; those of a message in it are a mapping again."""
    for name, value in fields.items():
        if isinstance(value, Mapping):
            filled(getattr(message, name), **value)
        else:
            setattr(message, name, value)
    return message


def _time(seconds: float) -> dict[str, int]:
    """Fields of a time or a duration."""
    whole, rest = divmod(round(seconds * 1e9), 10**9)
    return {"sec": whole, "nanosec": rest}


def _header(stamp: float, frame_id: str) -> dict[str, Any]:
    return {"stamp": _time(stamp), "frame_id": frame_id}


def make_people(
    new: New, frame: Frame, frame_id: str = "map", velocity: np.ndarray | None = None
) -> Any:
    """The People message of a frame; of people without a `velocity` [N, 2] (m/s, NaN) it is 0."""
    speeds = np.zeros_like(frame.xy)
    if velocity is not None:
        speeds = np.nan_to_num(velocity)
    rows = zip(frame.ids.tolist(), frame.xy.tolist(), speeds.tolist())
    people = []
    for id, (x, y), (vx, vy) in rows:
        person = filled(
            new("people_msgs/msg/Person"),
            name=name_of(id),
            reliability=1.0,
            position={"x": x, "y": y},
            velocity={"x": vx, "y": vy},
        )
        people.append(person)
    return filled(new(PEOPLE), header=_header(frame.stamp, frame_id), people=people)


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

    `ids` are [N], `covariance` [N, T, 2, 2] square metres, `confidence` [N]; the stamp
    is that of the step `now`, the last one observed.
    """
    positions = np.asarray(xy, np.float64)
    times = np.asarray(steps, np.float64).tolist()
    people, length, _ = positions.shape
    velocity = np.zeros_like(positions)
    if length > 1:
        velocity = np.gradient(positions, times, axis=1)
    spread = np.zeros((people, length, 6, 6))
    spread[..., :2, :2] = covariance
    spread = spread.reshape(people, length, 36)
    sure = np.broadcast_to(confidence, people).tolist()
    # Only what differs is made for each, because a message has thousands of positions.
    empty = new("darko_perception_msgs/msg/Human")
    pose, twist = empty.centroid.pose, empty.velocity.twist
    turn = filled(pose.orientation, w=1.0)
    no_turn = twist.angular
    unknown = np.zeros(36)
    Place, Pose, Point = map(type, (empty.centroid, pose, pose.position))
    Motion, Twist, Vector = map(type, (empty.velocity, twist, twist.linear))

    def human(n: int, step: int) -> Any:
        point = Point(*positions[n, step].tolist(), 0.0)
        vector = Vector(*velocity[n, step].tolist(), 0.0)
        return filled(
            copy.copy(empty),
            id=int(ids[n]) % 2**64,
            confidence=sure[n],
            centroid=Place(Pose(point, turn), spread[n, step]),
            velocity=Motion(Twist(vector, no_turn), unknown),
        )

    def everybody(step: int) -> Any:
        return filled(
            new(HUMANS),
            header=_header(times[step], frame_id),
            humans=[human(n, step) for n in range(people)],
        )

    return filled(
        new(HUMANS_TRAJS),
        header=_header(times[now], frame_id),
        trajs=[everybody(step) for step in range(length)],
    )


def forecast_message(
    new: New, forecast: Forecast, model: str, period: float, frame_id: str = "map"
) -> Any:
    """The HumansTrajs of one model: observed steps, then those of its central forecast.

    The covariance of a position is that of the draws around their mean; the confidence
    of a person is the share of observed steps that were seen, not extrapolated.
    """
    result = forecast.models[model]
    seen = forecast.observed.shape[1]
    xy = np.concatenate([forecast.observed, result.samples[result.central]], axis=1)
    deviation = result.draws - result.draws.mean(axis=0)
    products = np.einsum("knti,kntj->ntij", deviation, deviation)
    spread = np.zeros((*xy.shape, 2))
    spread[:, seen:] = products / len(deviation)
    return make_trajectories(
        new,
        _steps(forecast, xy, period),
        forecast.ids,
        xy,
        covariance=spread,
        frame_id=frame_id,
        confidence=1 - forecast.extrapolated / seen,
        now=seen - 1,
    )


def truth_message(
    new: New, forecast: Forecast, period: float, frame_id: str = "map"
) -> Any:
    """The HumansTrajs of the observed future of those seen to the end; None without any.

    It has the stamp of the forecast, so that the two can be matched; `Analytics` must
    have completed it.
    """
    assert forecast.future is not None
    xy = np.concatenate([forecast.observed, forecast.future], axis=1)
    is_whole = np.isfinite(xy).all(axis=(1, 2))
    if not is_whole.any():
        return None
    return make_trajectories(
        new,
        _steps(forecast, xy, period),
        forecast.ids[is_whole],
        xy[is_whole],
        frame_id=frame_id,
        now=forecast.observed.shape[1] - 1,
    )


def _steps(forecast: Forecast, xy: np.ndarray, period: float) -> np.ndarray:
    """[T] seconds of the steps of `xy` [N, T, 2], observed and future."""
    now = forecast.observed.shape[1] - 1
    number = np.arange(xy.shape[1]) - now
    return forecast.stamp + period * number


def samples_message(
    new: New, forecast: Forecast, model: str, period: float, frame_id: str
) -> Any:
    """The neurosym_msgs/Forecast of one model."""
    last = forecast.observed[:, -1]
    before = forecast.observed[:, -2:-1].mean(axis=1)
    velocity = (last - before) / period
    futures, weights, central = forecast.models[model].weighted
    regions = forecast.models[model].regions
    covariance = regions.covariance[..., [0, 0, 1], [0, 1, 1]]
    present: Any = np.isfinite(forecast.whereabouts).all(axis=1)
    other_ids = np.array([*forecast.dropped], np.int64)
    return filled(
        new(FORECAST),
        header=_header(forecast.stamp, frame_id),
        model=model,
        period=period,
        central=central,
        samples=len(futures),
        steps=futures.shape[2],
        weights=weights.astype(np.float32),
        ids=forecast.ids,
        names=[name_of(id) for id in forecast.ids.tolist()],
        extrapolated=forecast.extrapolated.astype(np.uint32),
        position=last.ravel(),
        seen=forecast.seen.astype(np.float32),
        other_ids=other_ids[present],
        other_position=forecast.whereabouts[present].ravel(),
        other_reason=[*itertools.compress(forecast.dropped.values(), present)],
        levels=np.array(LEVELS, np.float32),
        mean=_flat(regions.mean - last[:, None]),
        covariance=_flat(covariance),
        radius=_flat(regions.radius),
        velocity=_flat(velocity),
        futures=_flat(futures - last[:, None]),
    )


def _flat(values: np.ndarray) -> np.ndarray:
    """The values as a message has them."""
    return values.ravel().astype(np.float32)


def markers_message(
    new: New, forecast: Forecast, model: str, period: float, frame_id: str
) -> Any:
    """A line for each person, from the last position observed; `ns` is model and id.

    The first marker deletes those of the frame before.

    Lines of people who are not seen at the moment are faint.
    """
    result = forecast.models[model]
    last = forecast.observed[:, -1:]
    paths = np.append(last, result.samples[result.central], axis=1)
    people, points, _ = paths.shape
    xyz = np.pad(paths, [(0, 0), (0, 0), (0, 1)]).reshape(people, 3 * points)
    empty = new(MARKER, points)
    filled(
        empty,
        header=_header(forecast.stamp, frame_id),
        type=empty.LINE_STRIP,
        scale={"x": 0.05},
        pose={"orientation": {"w": 1.0}},
        # The line disappears by itself when the node ends.
        lifetime=_time(2 * period),
    )
    Colour, Line = type(empty.color), type(empty.points)
    nothing = Line(points, np.zeros(3 * points))
    clear = copy.copy(empty)
    filled(clear, ns=model, action=empty.DELETEALL, points=nothing)

    markers = [clear]
    colours = itertools.cycle(np.divide(COLOURS, 255).tolist())
    opacity = np.where(forecast.extrapolated, FAINT, 1.0).tolist()
    for id, colour, alpha, path in zip(forecast.ids.tolist(), colours, opacity, xyz):
        marker = filled(
            copy.copy(empty),
            ns=f"{model}/{name_of(id)}",
            color=Colour(*colour, alpha),
            points=Line(points, path),
        )
        markers.append(marker)
    return filled(new(MARKERS, points), markers=markers)


class CostmapMaker:
    """Makes the OccupancyGrid of each forecast of one model, see `Costmap`."""

    def __init__(self, ahead: float | None = None):
        """Of the moment `ahead` seconds from now alone; by default of all moments."""
        self._costmap = Costmap(ahead)

    def __call__(
        self, new: New, forecast: Forecast, model: str, period: float, frame_id: str
    ) -> Any:
        """The nav_msgs/OccupancyGrid of one model's draws."""
        futures, weights, _ = forecast.models[model].weighted
        now = np.broadcast_to(forecast.observed[:, -1:], futures[:, :, :1].shape)
        ways = np.concatenate([now, futures], axis=2)
        # Who has no forecast stands.
        present = np.isfinite(forecast.whereabouts).all(axis=1)
        others = forecast.whereabouts[present, None]
        standing = np.broadcast_to(others, (len(ways), len(others), *ways.shape[2:]))
        ways = np.concatenate([ways, standing], axis=1)
        per_cent, corner = self._costmap.update(ways, weights, period)
        x, y = corner.tolist()
        return filled(
            new(GRID),
            header=_header(forecast.stamp, frame_id),
            info={
                "resolution": CELL,
                "height": per_cent.shape[0],
                "width": per_cent.shape[1],
                "origin": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}},
            },
            data=per_cent.ravel(),
        )


def events_message(
    new: New,
    forecast: Forecast,
    model: str,
    period: float,
    frame_id: str,
    at_least: float = AT_LEAST,
) -> Any:
    """The neurosym_msgs/Events of one model: events with probability `at_least` or more."""
    events = [
        filled(
            new("neurosym_msgs/msg/Event"),
            name=event.name,
            words=event.words(forecast.ids),
            k=int(forecast.ids[event.k]),
            l=int(forecast.ids[event.l]),
            probability=event.probability,
            seconds=event.seconds,
        )
        for event in likely_events(forecast, model, period, at_least)
    ]
    return filled(
        new(EVENTS),
        header=_header(forecast.stamp, frame_id),
        model=model,
        events=events,
    )


def diagnostics_message(new: New, status: Status, name: str, now: float) -> Any:
    """Status of the stream, for /diagnostics at `now` [s]: 0 is well, 3 is stale."""
    state = status.now()
    values = {f"{key} [{unit}]": state[key] for key, unit in UNITS.items()}
    values |= state["wrong"]
    for number, text in enumerate(state["reports"], 1):
        values[f"report {number}"] = text
    row = new("diagnostic_msgs/msg/DiagnosticStatus")
    filled(
        row,
        name=f"{name.removeprefix('/')}: forecasts",
        hardware_id="neurosym_jax",
        level=row.STALE if status.stale else row.OK,
        message=status.line(),
        values=[
            filled(new("diagnostic_msgs/msg/KeyValue"), key=key, value=str(value))
            for key, value in values.items()
        ],
    )
    return filled(new(DIAGNOSTICS), header=_header(max(now, 0.0), ""), status=[row])
