"""What the nodes of ROS 1 and ROS 2 share: from messages that wait to the topics of a forecast.

Of the messages that wait all are observed, but the newest alone is forecast: under load frames are
skipped and counted, and nothing queues.
"""

import abc
import collections
import itertools
import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

from neurosym_robot.dashboard import Dashboard
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.frames import Frame
from neurosym_robot.online.pairs import AT_LEAST, compile_events
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.replay import advance
from neurosym_robot.online.status import STALE_AFTER, Status
from neurosym_robot.ros.definitions import DIAGNOSTICS, HUMANS_TRAJS, PEOPLE, TRUTH_TOPIC
from neurosym_robot.ros.messages import (
    ENDINGS,
    diagnostics_message,
    forecast_topic,
    make_people,
    makers,
    truth_message,
)
from neurosym_robot.ros.source import PeopleSource
from neurosym_robot.tracking.stitching import OnlineStitcher

__all__ = ["ForecastingNode", "Outlet"]

DIAGNOSE = 1.0  # seconds between messages on /diagnostics
SHOW = 0.05  # seconds at least between two moments of the page
WAITING = 32  # messages of people that wait; of more the oldest are left out
LAST = 2.0**31 - 1000  # seconds: ROS counts in 32 bits, and forecasts lie ahead


class Outlet(NamedTuple):
    """A topic that we publish."""

    send: Callable[[Any], object]
    is_heard: Callable[[], bool]


class ForecastingNode(abc.ABC):
    """A predictor in a ROS graph; a subclass speaks to the graph, and calls `put`."""

    @abc.abstractmethod
    def _now(self) -> float:
        """Seconds of ROS's clock."""

    @abc.abstractmethod
    def _new(self, kind: str) -> Any:
        """An empty message, by its type."""

    @abc.abstractmethod
    def _advertise(self, topic: str, kind: str) -> Outlet | None:
        """Publish a topic of a type; None if there is no such type."""

    def __init__(
        self,
        predictor: Predictor,
        report: Callable[[str], None],
        *,
        name: str = "neurosym_jax",
        source: PeopleSource | None = None,
        stitcher: OnlineStitcher | None = None,
        at_least: float = AT_LEAST,
        status: float = 10.0,
        stale_after: float = STALE_AFTER,
    ):
        """Advertise all topics whose types there are: for each of the models topics of its own.

        `report` is called with one line at a time; `at_least` is the least probability of an event
        that is published; `status` is in seconds between status lines.
        """
        self.name, self.predictor, self.stitcher = name, predictor, stitcher
        self.source = source or PeopleSource(report=report)
        self.analytics = Analytics(predictor)
        compile_events(predictor)
        self.late = self.malformed = 0  # messages left out: too many waited, or not readable
        self.stopped = threading.Event()
        self.dashboard: Dashboard | None = None
        """Shows what is forecast, if set before `run`."""
        self.status = Status(
            predictor, self.analytics, report, status, stale_after, self._counts, self._now
        )
        self._make = makers(at_least)
        self._waiting: collections.deque[Any] = collections.deque()
        self._changed = threading.Condition()
        self._shown: Any = None  # what the page shows next
        self._diagnosed = 0.0
        topics = itertools.product(predictor.models, ENDINGS.items())
        self._forecasts = {
            (model, kind): self._advertise(forecast_topic(model) + end, kind)
            for model, (kind, end) in topics
        }
        self._truth = self._advertise(TRUTH_TOPIC, HUMANS_TRAJS)
        self._diagnostics = self._advertise("/diagnostics", DIAGNOSTICS)
        self._mended: Outlet | None = None  # people under mended ids

    def put(self, kind: str, message: Any, publisher: str = "") -> None:
        """Let a message of people wait; called in any thread."""
        with self._changed:
            if len(self._waiting) == WAITING:
                self._waiting.popleft()
                self.late += 1
            self._waiting.append((kind, message, publisher, time.monotonic()))
            self._changed.notify()

    def run(self) -> None:
        """Forecast until the node is stopped."""
        if self.dashboard is not None:
            threading.Thread(target=self._show, daemon=True).start()
        while not self.stopped.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self._waiting, 0.2)
            self.work()
            self.status.look()
            if time.monotonic() - self._diagnosed >= DIAGNOSE:
                self._diagnosed = time.monotonic()
                _publish(
                    self._diagnostics,
                    lambda: diagnostics_message(self._new, self.status, self.name, self._now()),
                )

    def work(self) -> None:
        """Take in the messages that wait, and publish the forecast of the newest frame."""
        with self._changed:
            heard = list(self._waiting)
            self._waiting.clear()
        frames = [frame for each in heard if (frame := self._read(*each)) is not None]
        if not frames:
            return
        for frame in frames:
            self.status.heard(frame.stamp)
        robot = self.source.robot(frames[-1].stamp)
        event = advance(frames, self.predictor, robot)
        forecast, common = (
            event.forecast,
            (self.predictor.window.period, self.source.frame_id or ""),
        )
        if forecast is not None:
            for (model, kind), outlet in self._forecasts.items():
                make = self._make[kind]
                _publish(outlet, lambda: make(self._new, forecast, model, *common))  # noqa: B023
            self.status.published(self._now() - event.frame.stamp, event.skipped)
        for done in self.analytics.add(forecast):
            _publish(self._truth, lambda: truth_message(self._new, done, *common))  # noqa: B023
        if self.dashboard is not None:
            self._shown = event, self.status.now(), robot

    def _read(self, kind: str, message: Any, publisher: str, received: float) -> Frame | None:
        """The frame of a message, with mended ids; None if it is left out."""
        frame = self.source.take(kind, message, publisher, received)
        if frame is None:
            return None
        if not 0 <= frame.stamp < LAST:
            self.malformed += 1
            return None
        if self.stitcher is None:
            return frame
        frame, known = self.stitcher.mend(frame)
        _publish(self._mended, lambda: self._renamed(kind, message, frame, known))
        return frame

    def _renamed(self, kind: str, message: Any, frame: Frame, known: Any) -> Any:
        """People with mended ids: the message received, renamed, if its people are all ours."""
        ours = message.header.frame_id.removeprefix("/") == self.source.frame_id
        if kind != PEOPLE or not ours or len(message.people) != len(known):
            return make_people(self._new, frame, self.source.frame_id or "")
        message.people = list(itertools.compress(message.people, known))
        for person, id in zip(message.people, frame.ids.tolist()):
            person.name = str(id)
        return message

    def _show(self) -> None:
        """Show what is newest, in a thread of its own: the page holds nothing up."""
        last = None
        while not self.stopped.wait(SHOW):
            if self._shown is not last and self.dashboard is not None:
                last = self._shown
                self.dashboard.show(*last)

    def _counts(self) -> dict[str, int]:
        """Counts of what was wrong with the stream, beside the predictor's health."""
        joined = self.stitcher.joined if self.stitcher else 0
        more = {"tracks_joined": joined, "late": self.late, "malformed": self.malformed}
        return {**self.source.refused, **more}


def _publish(outlet: Outlet | None, make: Callable[[], Any]) -> None:
    """Send what `make` returns, if somebody listens."""
    if outlet is not None and outlet.is_heard():
        message = make()
        if message is not None:
            outlet.send(message)
