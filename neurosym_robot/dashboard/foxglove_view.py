"""A stream for Foxglove: over its websocket, or into an MCAP file.

`/forecasts` is a SceneUpdate of people, samples and most probable paths, `/stream` has
the numbers of `Status.now()` as JSON, and `/events`, of models in JAX, the probable
events in words. foxglove-sdk is imported when a view is made.
"""

import importlib
import itertools
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_robot.dashboard.view import View
from neurosym_robot.online.pairs import AT_LEAST, likely_events
from neurosym_robot.online.predictor import Forecast, Predictor
from neurosym_robot.online.replay import ReplayEvent
from neurosym_robot.tracking.names import name_of

LAST = 2.0**32  # seconds that Foxglove's stamps can hold
SEEN = 1  # seconds that a person or a forecast is shown at most
FAINT = 0.25  # opacity of samples
# Colours of the models in their order, after Okabe and Ito.
COLOURS = ((0.0, 0.45, 0.7), (0.84, 0.37, 0.0), (0.0, 0.62, 0.45), (0.8, 0.47, 0.65))


class FoxgloveView(View):
    """Serves the stream at a port, or writes it to a new `.mcap`."""

    def __init__(
        self,
        predictor: Predictor,
        to: int | Path,
        host: str = "127.0.0.1",
        *,
        frame_id: Callable[[], str | None] = lambda: None,
        at_least: float = AT_LEAST,
    ):
        """Begin to serve at port `to`, 0 for any free one, or to write the file `to`.

        `frame_id` returns the frame of the stream's coordinates, "map" while it is not
        known. InputError without foxglove-sdk, or if the port or the file cannot be
        used.
        """
        if isinstance(to, Path) and to.suffix != ".mcap":
            raise InputError(
                f"{to}: for Foxglove, a port or a new .mcap file is needed"
            )
        try:
            foxglove = importlib.import_module("foxglove")
            self._kinds = importlib.import_module("foxglove.messages")
        except ImportError:
            reason = "Foxglove needs foxglove-sdk: pip install 'neurosym-jax[foxglove]'"
            raise InputError(reason) from None
        self._frame_id, self._at_least = frame_id, at_least
        self._period, self._is_light = predictor.window.period, predictor.is_light
        # Channels are closed with their context, and log nothing then.
        self._context = context = foxglove.Context()
        self._scene = foxglove.channels.SceneUpdateChannel(
            "/forecasts", context=context
        )
        self._events = foxglove.channels.LogChannel("/events", context=context)
        self._numbers = foxglove.Channel(
            "/stream", message_encoding="json", context=context
        )
        try:
            if isinstance(to, Path):
                self.title, self.where = "Foxglove can open", str(to)
                self._stop = foxglove.open_mcap(to, context=context).close
            else:
                server = foxglove.start_server(host=host, port=to, context=context)
                self.title, self.where = (
                    "Foxglove can connect to",
                    f"ws://{host}:{server.port}",
                )
                self._stop = server.stop
        except (OSError, RuntimeError, OverflowError) as error:
            raise InputError(f"{to}: cannot be used for Foxglove ({error})") from None

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Publish a frame, its forecast and the numbers."""
        frame, forecast, kinds = event.frame, event.forecast, self._kinds
        if not 0 <= frame.stamp < LAST:
            return
        at = round(1e9 * frame.stamp)
        common = {
            "timestamp": kinds.Timestamp(*divmod(at, 10**9)),
            "frame_id": self._frame_id() or "map",
            "lifetime": kinds.Duration(SEEN),
        }
        entities = [
            kinds.SceneEntity(id=f"person {id}", **common, **self._person(id, *xy))
            for id, xy in zip(frame.ids.tolist(), frame.xy.tolist())
            if np.isfinite(xy).all()
        ]
        if forecast is not None:
            for colour, name in zip(itertools.cycle(COLOURS), forecast.models):
                entities += [
                    kinds.SceneEntity(id=f"{name} {id}", **common, lines=lines)
                    for id, lines in zip(
                        forecast.ids.tolist(), self._lines(forecast, name, colour)
                    )
                ]
                if not self._is_light:
                    self._log_events(forecast, name, at)
        self._scene.log(kinds.SceneUpdate(entities=entities), log_time=at)
        self._numbers.log(
            {
                **now,
                "missing": {
                    name_of(id): reason for id, reason in now["missing"].items()
                },
            },
            log_time=at,
        )

    def _log_events(self, forecast: Forecast, model: str, at: int) -> None:
        """Publish the probable events of a model's forecast at the stamp `at` [ns]."""
        kinds = self._kinds
        for likely in likely_events(forecast, model, self._period, self._at_least):
            log = kinds.Log(
                timestamp=kinds.Timestamp(*divmod(at, 10**9)),
                name=model,
                message=likely.words(forecast.ids),
                level=kinds.LogLevel.Info,
            )
            self._events.log(log, log_time=at)

    def close(self) -> None:
        """Finish the file, or end all connections."""
        self._stop()

    def _person(self, id: int, x: float, y: float) -> dict[str, Any]:
        """A ball and the id above it."""
        kinds = self._kinds
        ball, label = (
            kinds.Pose(
                position=kinds.Vector3(x=x, y=y, z=z),
                orientation=kinds.Quaternion(w=1.0),
            )
            for z in (0.2, 0.8)
        )
        size, grey = (
            kinds.Vector3(x=0.4, y=0.4, z=0.4),
            kinds.Color(r=0.5, g=0.5, b=0.5, a=0.9),
        )
        return {
            "spheres": [kinds.SpherePrimitive(pose=ball, size=size, color=grey)],
            "texts": [
                kinds.TextPrimitive(
                    pose=label,
                    color=grey,
                    billboard=True,
                    font_size=0.3,
                    text=name_of(id),
                )
            ],
        }

    def _lines(
        self, forecast: Forecast, model: str, colour: tuple[float, ...]
    ) -> Iterator[list]:
        """Lines of each person: the last 90 % region, the samples, the most probable path."""
        kinds, result = self._kinds, forecast.models[model]
        looks = [(sample, FAINT, 0.02) for sample in result.samples]
        looks.append((result.samples[result.central], 1.0, 0.06))
        rings = result.regions.outlines(-1)
        for n, start in enumerate(forecast.observed[:, -1:]):
            region = kinds.LinePrimitive(
                type=kinds.LinePrimitiveLineType.LineLoop,
                points=[kinds.Point3(x=x, y=y) for x, y in rings[-1, n].tolist()],
                color=kinds.Color(**dict(zip("rgb", colour)), a=FAINT),
                thickness=0.03,
            )
            lines = [region]
            for sample, opacity, thickness in looks:
                way = [*start, *sample[n]]
                line = kinds.LinePrimitive(
                    points=[kinds.Point3(x=x, y=y) for x, y in way],
                    color=kinds.Color(**dict(zip("rgb", colour)), a=opacity),
                    thickness=thickness,
                )
                lines.append(line)
            yield lines
