"""What the nodes of ROS 1 and ROS 2 share: from messages that wait to the topics of a forecast.

Of the messages that wait all are observed, but the newest alone is forecast: under load frames are
skipped and counted, and nothing queues.
"""

import abc
import collections
import threading
import time
from collections.abc import Callable
from typing import Any

from neurosym_robot.dashboard import Dashboard
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.frames import Frame
from neurosym_robot.online.pairs import AT_LEAST, LikelyEvents
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.replay import advance
from neurosym_robot.online.status import STALE_AFTER, Status
from neurosym_robot.ros.definitions import HUMANS_TRAJS
from neurosym_robot.ros.messages import TRUTH_TOPIC, forecast_topic
from neurosym_robot.ros.outgoing import DIAGNOSTICS, ENDINGS, diagnostics_message, makers
from neurosym_robot.ros.source import PeopleSource
from neurosym_robot.ros.trajectories import truth_message
from neurosym_robot.tracking.stitching import OnlineStitcher

__all__ = ["ForecastingNode"]

DIAGNOSE = 1.0  # seconds between messages on /diagnostics
SHOW = 0.05  # seconds at least between two moments of the page
WAITING = 32  # messages of people that wait; of more the oldest are left out


class ForecastingNode(abc.ABC):
    """A predictor in a ROS graph; a subclass speaks to the graph by the methods below."""

    @abc.abstractmethod
    def _read(self, *heard: Any) -> Frame | None:
        """The frame of what was `put`; None if it is left out."""

    @abc.abstractmethod
    def _now(self) -> float:
        """Seconds of ROS's clock."""

    @abc.abstractmethod
    def _new(self, kind: str) -> Any:
        """An empty message, by its type."""

    @abc.abstractmethod
    def _advertise(self, topic: str, kind: str) -> Any:
        """A publisher, by topic and type; None if there is no such type."""

    @abc.abstractmethod
    def _is_heard(self, publisher: Any) -> bool:
        """Whether a publisher has subscribers."""

    @abc.abstractmethod
    def _send(self, publisher: Any, message: Any) -> None: ...

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
        """Not in the graph yet.

        Args:
            predictor: of one or several models, each with topics of its own.
            report: called with one line at a time.
            name: of the node.
            source: which messages belong to the stream.
            stitcher: mends ids, if given.
            at_least: least probability of an event that is published.
            status: seconds between status lines; 0 for none.
            stale_after: see `Status`.
        """
        self.name, self.predictor, self.stitcher = name, predictor, stitcher
        self.source = source or PeopleSource(report=report)
        self.analytics = Analytics(predictor)
        LikelyEvents.of(predictor, at_least)  # Compiled ahead of use.
        self.late = 0
        """Messages that were left out because too many waited."""
        self.stopped = threading.Event()
        self.dashboard: Dashboard | None = None
        """Shows what is forecast, if set before `run`."""
        self.status = Status(
            predictor, self.analytics, report, status, stale_after, self._counts, self._now
        )
        self._make = makers(at_least)
        self._forecasts: dict[tuple[str, str], Any] = {}
        self._waiting: collections.deque[Any] = collections.deque()
        self._changed = threading.Condition()
        self._shown: Any = None  # what the page shows next
        self._diagnosed = 0.0

    def advertise(self) -> None:
        """Advertise all topics whose types there are."""
        for name in self.predictor.models:
            for kind, end in ENDINGS.items():
                publisher = self._advertise(forecast_topic(name) + end, kind)
                if publisher is not None:
                    self._forecasts[name, kind] = publisher
        self._truth = self._advertise(TRUTH_TOPIC, HUMANS_TRAJS)
        self._diagnostics = self._advertise("/diagnostics", DIAGNOSTICS)

    def put(self, *heard: Any) -> None:
        """Let a message wait; called in any thread."""
        with self._changed:
            if len(self._waiting) == WAITING:
                self._waiting.popleft()
                self.late += 1
            self._waiting.append(heard)
            self._changed.notify()

    def run(self) -> None:
        """Forecast until the node is stopped."""
        if self.dashboard is not None:
            threading.Thread(target=self._show, daemon=True).start()
        while not self.stopped.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self._waiting, 0.2)
                heard = list(self._waiting)
                self._waiting.clear()
            if heard:
                self.work(heard)
            self.status.look()
            if time.monotonic() - self._diagnosed >= DIAGNOSE:
                self._diagnosed = time.monotonic()
                self._diagnose()

    def work(self, heard: list[Any]) -> None:
        """Take in messages, and publish the forecast of the newest frame."""
        frames = [frame for each in heard if (frame := self._read(*each)) is not None]
        if not frames:
            return
        for frame in frames:
            self.status.heard(frame.stamp)
        robot = self.source.robot(frames[-1].stamp)
        event = advance(frames, self.predictor, robot)
        for (name, kind), publisher in self._forecasts.items():
            if event.forecast is not None and self._is_heard(publisher):
                message = self._make[kind](self._new, event.forecast, name, *self._common)
                self._send(publisher, message)
        if event.forecast is not None:
            self.status.published(self._now() - event.frame.stamp, event.skipped)
        scored = self.analytics.add(event.forecast)
        for done in scored if self._truth is not None and self._is_heard(self._truth) else ():
            message = truth_message(self._new, done, *self._common)
            if message is not None:
                self._send(self._truth, message)
        if self.dashboard is not None:
            self._shown = event, self.status.now(), robot

    @property
    def _common(self) -> tuple[float, str]:
        return self.predictor.window.period, self.source.frame_id or ""

    def _show(self) -> None:
        """Show what is newest, in a thread of its own: the page holds nothing up."""
        last = None
        while not self.stopped.wait(SHOW):
            if self._shown is not last and self.dashboard is not None:
                last = self._shown
                self.dashboard.show(*last)

    def _diagnose(self) -> None:
        if self._diagnostics is not None and self._is_heard(self._diagnostics):
            self._send(
                self._diagnostics,
                diagnostics_message(self._new, self.status, self.name, self._now()),
            )

    def _counts(self) -> dict[str, int]:
        """Counts of what was wrong with the stream, beside the predictor's health."""
        joined = self.stitcher.joined if self.stitcher else 0
        return {**self.source.refused, "tracks_joined": joined, "late": self.late}
