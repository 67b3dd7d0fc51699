"""What the nodes of ROS 1 and of ROS 2 have in common: from a frame to whoever hears of it."""

from collections.abc import Callable
from typing import Any

from neurosym_robot.dashboard import Dashboard
from neurosym_robot.online.analytics import Analytics
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.likely import LikelyEvents
from neurosym_robot.online.pair_states import PairStates
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.online.replay import advance
from neurosym_robot.online.status import Status
from neurosym_robot.ros.messages import TRUTH_TOPIC, forecast_topic
from neurosym_robot.ros.outgoing import ENDINGS, makers
from neurosym_robot.ros.source import Source
from neurosym_robot.tracking.live import OnlineStitcher

__all__ = ["DIAGNOSE", "ForecastingNode"]

DIAGNOSE = 1.0
"""Seconds between messages on /diagnostics."""


class ForecastingNode:
    """A predictor in some graph; how that is spoken to is its subclasses'."""

    _new: Callable[[str], Any]
    """An empty message, by its type."""
    _is_heard: Callable[[Any], bool]
    """Whether somebody has subscribed to a publisher."""
    _send: Callable[[Any, Any], None]
    """A message by a publisher."""
    _happened: Callable[..., Any]
    """The message of a forecast whose future is known, or None."""

    def __init__(
        self,
        predictor: Predictor,
        source: Source,
        stitcher: OnlineStitcher | None,
        at_least: float,
        status: float,
        report: Callable[[str], None],
    ):
        """Not in the graph yet; what is given is what the subclasses are given."""
        self.predictor, self.source, self.stitcher = predictor, source, stitcher
        self.analytics = Analytics.of(predictor)
        LikelyEvents.of(predictor, at_least)  # Compiled before they are asked for.
        PairStates.of(predictor)
        self.status = Status(predictor, self.analytics, report, status, self._counts)
        self.dashboard: Dashboard | None = None
        """Shown every frame, where there is one."""
        self._make: dict[str, Callable[..., Any]] = makers(at_least)
        self._forecasts: dict[tuple[str, str], Any] = {}
        self._truth: Any = None

    def publish_on(self, kind: str, advertise: Callable[[str, str], Any]) -> None:
        """Have publishers of what is told on either ROS, and of forecasts as `kind`.

        Args:
            kind: type of the messages whose topics have no ending.
            advertise: a publisher, by topic and type; None where there is no such type.
        """
        for name in self.predictor.models:
            for each, end in {kind: "", **ENDINGS}.items():
                publisher = advertise(forecast_topic(name) + end, each)
                if publisher is not None:
                    self._forecasts[name, each] = publisher
        self._truth = advertise(TRUTH_TOPIC, kind)

    def forecast(self, frame: Frame, stitcher: OnlineStitcher | None = None) -> None:
        """Take in a frame, and publish what it leads to."""
        self.status.heard()
        robot = self.source.robot(frame.stamp)
        event = advance(frame, self.predictor, self.analytics, stitcher, robot)
        frame_id = self.source.frame_id or ""
        common: dict[str, Any] = {"period": self.predictor.window.period, "frame_id": frame_id}
        for (name, kind), publisher in self._forecasts.items():
            if event.forecast is not None and self._is_heard(publisher):
                make = self._make[kind]
                self._send(publisher, make(self._new, event.forecast, name, **common))
        for done in event.scored:
            if self._is_heard(self._truth) and (message := self._happened(done, **common)):
                self._send(self._truth, message)
        if self.dashboard is not None:
            self.dashboard.show(event.frame, event.forecast, self.analytics.summary(), robot)

    def _counts(self) -> dict[str, int]:
        """What went wrong so far beside the predictor's health."""
        joined = self.stitcher.joined if self.stitcher else 0
        return {**self.source.refused, "tracks_joined": joined}
