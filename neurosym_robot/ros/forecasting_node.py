"""What the nodes of ROS 1 and ROS 2 share: from a frame to the topics of its forecast."""

import abc
import time
from collections.abc import Callable
from typing import Any

from neurosym_robot.dashboard import Dashboard
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.frames import Frame
from neurosym_robot.online.pairs import LikelyEvents, PairStates
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.replay import advance
from neurosym_robot.online.status import Status
from neurosym_robot.ros.messages import TRUTH_TOPIC, forecast_topic
from neurosym_robot.ros.outgoing import DIAGNOSTICS, ENDINGS, TRUTH, diagnostics_message, makers
from neurosym_robot.ros.source import PeopleSource
from neurosym_robot.tracking.live import OnlineStitcher

__all__ = ["DIAGNOSE", "ForecastingNode"]

DIAGNOSE = 1.0  # seconds between messages on /diagnostics


class ForecastingNode(abc.ABC):
    """A predictor in a ROS graph; a subclass speaks to the graph by the four methods below."""

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
        source: PeopleSource,
        stitcher: OnlineStitcher | None,
        at_least: float,
        status: float,
        report: Callable[[str], None],
    ):
        """Not in the graph yet; the arguments are those of the subclasses."""
        self.predictor, self.source, self.stitcher = predictor, source, stitcher
        self.analytics = Analytics.of(predictor)
        LikelyEvents.of(predictor, at_least)  # Compiled ahead of use.
        PairStates.of(predictor)
        self.status = Status(predictor, self.analytics, report, status, self._counts)
        self.dashboard: Dashboard | None = None
        """Shows every frame, if set."""
        self._make = makers(at_least)
        self._forecasts: dict[tuple[str, str], Any] = {}

    def publish(self, kind: str) -> None:
        """Advertise all topics, with forecasts and observed futures as messages of type `kind`."""
        for name in self.predictor.models:
            for each, end in ENDINGS.items():
                publisher = None
                if end or each == kind:
                    publisher = self._advertise(forecast_topic(name) + end, each)
                if publisher is not None:
                    self._forecasts[name, each] = publisher
        self._happened, self._truth = TRUTH[kind], self._advertise(TRUTH_TOPIC, kind)
        self._diagnostics = self._advertise("/diagnostics", DIAGNOSTICS)

    def forecast(self, frame: Frame, stitcher: OnlineStitcher | None = None) -> None:
        """Take in a frame, and publish what follows from it."""
        self.status.heard()
        robot = self.source.robot(frame.stamp)
        event = advance(frame, self.predictor, self.analytics, stitcher, robot)
        common = self.predictor.window.period, self.source.frame_id or ""
        for (name, kind), publisher in self._forecasts.items():
            if event.forecast is not None and self._is_heard(publisher):
                message = self._make[kind](self._new, event.forecast, name, *common)
                self._send(publisher, message)
        for done in event.scored if self._is_heard(self._truth) else ():
            message = self._happened(self._new, done, *common)
            if message is not None:
                self._send(self._truth, message)
        if self.dashboard is not None:
            self.dashboard.show(event.frame, event.forecast, self.analytics.summary(), robot)

    def diagnose(self, name: str) -> None:
        """Publish the status of the node of this name."""
        if self._diagnostics is not None and self._is_heard(self._diagnostics):
            message = diagnostics_message(self._new, self.status, name, time.time())
            self._send(self._diagnostics, message)

    def _counts(self) -> dict[str, int]:
        """Counts of what was wrong with the stream, beside the predictor's health."""
        joined = self.stitcher.joined if self.stitcher else 0
        return {**self.source.refused, "tracks_joined": joined}
