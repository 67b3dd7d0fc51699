"""From a forecast to its topics: in a bag, and what the nodes of ROS 1 and ROS 2 share.

Of the messages that wait all are observed, but the newest alone is forecast: under load
frames are skipped and counted, and nothing queues.
"""

import abc
import collections
import functools
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from neurosym_robot.dashboard.view import View
from neurosym_robot.input.kinds import KINDS
from neurosym_robot.input.source import PeopleSource
from neurosym_robot.online.pairs import AT_LEAST, likely_events
from neurosym_robot.online.predictor import Forecast, Predictor
from neurosym_robot.online.replay import Analytics, ReplayEvent, advance
from neurosym_robot.online.status import STALE_AFTER, Status
from neurosym_robot.ros.bags import BagWriter
from neurosym_robot.ros.definitions import (
    DIAGNOSTICS,
    HUMANS_TRAJS,
    PEOPLE_TOPICS,
    TF_TOPICS,
    TRANSFORMS,
    TRUTH_TOPIC,
    blank,
    ros1_name,
)
from neurosym_robot.ros.messages import (
    diagnostics_message,
    make_people,
    outputs,
    truth_message,
)
from neurosym_robot.tracking.following import Frame
from neurosym_robot.tracking.stitching import OnlineStitcher

DIAGNOSE = 1.0  # seconds between messages on /diagnostics
IDLE, PATIENCE = (
    0.2,
    0.02,
)  # seconds between looks, and while people wait for a transform
SILENT = 5.0  # seconds without a message after which other topics are named
WAITING = 32  # messages of people that wait; of more the oldest are left out
SPARSE = 0.1  # seconds between messages that wait once there are half as many
LAST = 2.0**31 - 1000  # seconds: ROS counts in 32 bits, and forecasts lie ahead


class ForecastBag(View):
    """People, forecasts of every model and what happened, on the robot experiment's topics."""

    title = "forecasts are in"

    def __init__(
        self, path: Path, predictor: Predictor, source: PeopleSource, at_least: float
    ):
        """Open the bag, as `BagWriter`; `source` knows the frame of the coordinates."""
        self._bag = BagWriter(path, compress=True)
        self._source, self._period = source, predictor.window.period
        self.where, self._stamp = str(self._bag.path), 0.0
        self._outputs = [
            output
            for output in outputs(predictor.models, at_least, not predictor.is_light)
            if not output.live
        ]

    def show(self, event: ReplayEvent, now: Mapping[str, Any]) -> None:
        """Write a frame with its forecast and the futures that it completed."""
        self._stamp, forecast, new = event.frame.stamp, event.forecast, self._bag.new
        common = self._period, self._source.frame_id or "map"
        self._bag.write(
            PEOPLE_TOPICS[0], self._stamp, make_people(new, event.frame, common[1])
        )
        if forecast is not None:
            for output in self._outputs:
                message = output.make(new, forecast, output.model, *common)
                self._bag.write(output.topic, self._stamp, message)
        self.end({}, event.scored)

    def end(self, score: Mapping[str, Any], scored: Sequence[Forecast] = ()) -> None:
        """Write the observed futures of forecasts."""
        common = self._period, self._source.frame_id or "map"
        for done in scored:
            message = truth_message(self._bag.new, done, *common)
            if message is not None:
                self._bag.write(TRUTH_TOPIC, self._stamp, message)

    def close(self) -> None:
        """Write index and metadata."""
        self._bag.close()


class Outlet(NamedTuple):
    """A topic that we publish."""

    send: Callable[[Any], object]
    is_heard: Callable[[], bool]

    def publish(self, make: Callable[..., Any], *arguments: Any) -> None:
        """Send what `make` returns for the arguments, if it is a message and somebody listens."""
        message = make(*arguments) if self.is_heard() else None
        if message is not None:
            self.send(message)


UNHEARD = Outlet(lambda message: None, lambda: False)


class ForecastingNode(abc.ABC):
    """A predictor in a ROS graph; a subclass speaks to the graph, and calls `put`."""

    topic: str
    """Where people come from, by its full name."""
    kind = ""
    """The type of its messages; empty where any is taken."""

    @abc.abstractmethod
    def close(self) -> None:
        """Leave the graph."""

    @abc.abstractmethod
    def _now(self) -> float:
        """Seconds of ROS's clock."""

    def _is_simulated(self) -> bool:
        """Whether ROS's clock is /clock, which may run slower or stand still."""
        return False

    def _elapsed(self) -> float:
        """Seconds of a clock that goes on as ROS's does, and is never set back."""
        now = self._now() if self._is_simulated() else time.monotonic()
        with self._changed:
            self._passed += max(now - self._looked, 0.0)
            self._looked = now
            return self._passed

    @abc.abstractmethod
    def _published(self) -> Mapping[str, str]:
        """The types of the topics that others publish."""

    @abc.abstractmethod
    def _advertise(self, topic: str, kind: str) -> Outlet:
        """Publish a topic of a type; `UNHEARD` if there is no such type."""

    @abc.abstractmethod
    def _listen(self, topic: str, kind: str, hear: Callable[[Any], None]) -> None:
        """Subscribe to messages of a type that is known here."""

    def __init__(
        self,
        predictor: Predictor,
        store: Any,
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

        Messages are of the types of `store`, a `typestore`; `report` is called with one
        line at a time; `at_least` is the least probability of an event that is
        published; `status` is in seconds between status lines.
        """
        self.name, self.predictor, self.stitcher, self.report = (
            name,
            predictor,
            stitcher,
            report,
        )
        self._store, self._new = store, functools.partial(blank, store)
        self.source = source or PeopleSource(report=report)
        self.analytics = Analytics(predictor)
        if not predictor.is_light:
            predictor.programs.add(self._rehearse_events)
        self.stopped = threading.Event()
        self.views: list[View] = []
        """Show every forecast before the next; slow ones through `Newest`."""
        self.status = Status(
            predictor,
            self.analytics,
            report,
            status,
            stale_after,
            self._now,
            self.source,
            stitcher,
        )
        self._waiting: collections.deque[Any] = collections.deque(maxlen=WAITING)
        self._changed, self._moved = threading.Condition(), False
        self._looked = self._passed = 0.0
        self._silent_until: float | None = time.monotonic() + SILENT
        self._reason = ""  # why no message has come, as was reported
        self._diagnosed = 0.0
        self._forecasts = [
            (output, self._advertise(output.topic, output.kind))
            for output in outputs(predictor.models, at_least, not predictor.is_light)
        ]
        self._truth = self._advertise(TRUTH_TOPIC, HUMANS_TRAJS)
        self._diagnostics = self._advertise("/diagnostics", DIAGNOSTICS)
        self._mended = UNHEARD  # people under mended ids
        for topic, static in zip(TF_TOPICS, (False, True)):
            self._listen(topic, TRANSFORMS, functools.partial(self._move, static))

    def _rehearse_events(self, forecast: Forecast) -> None:
        """Compute events, so that their programs are compiled."""
        for model in forecast.models:
            likely_events(forecast, model, self.predictor.window.period)

    def put(self, kind: str, message: Any, publisher: str = "") -> None:
        """Let a message of people wait; called in any thread."""
        self._silent_until = None
        waiting, now = self._waiting, self._elapsed()
        with self._changed:
            dense = len(waiting) > WAITING // 2 and now - waiting[-2][-2] < SPARSE
            if dense:
                waiting.pop()  # so that what waits spans seconds, without a gap too long to bridge
            if dense or len(waiting) == WAITING:
                self.source.refused["late"] += 1
            waiting.append((kind, message, publisher, now, self._now()))
            self._changed.notify()

    def _move(self, static: bool, message: Any) -> None:
        """Take in a message of /tf; called in any thread."""
        self.source.transforms.hear(message, static, self._elapsed())
        if self.source.waiting:
            with self._changed:
                self._moved = True
                self._changed.notify()

    def run(self) -> None:
        """Forecast until the node is stopped."""
        while not self.stopped.is_set():
            with self._changed:
                patience = PATIENCE if self.source.waiting else IDLE
                self._changed.wait_for(lambda: self._waiting or self._moved, patience)
                self._moved = False
            self.work()
            self.status.look()
            if self._silent_until and time.monotonic() > self._silent_until:
                self._silent_until = time.monotonic() + SILENT
                self._explain_silence()
            if time.monotonic() - self._diagnosed >= DIAGNOSE:
                self._diagnosed, arguments = (
                    time.monotonic(),
                    (self.status, self.name, self._now()),
                )
                self._diagnostics.publish(diagnostics_message, self._new, *arguments)

    def _explain_silence(self) -> None:
        """Report why no message has come, once for each reason."""
        reason = self._reason_of_silence()
        if reason not in ("", self._reason):
            self.report(reason)
        self._reason = reason

    def _reason_of_silence(self) -> str:
        published = self._published()
        if not published:
            return ""  # There is no master, which was said.
        kind = published.get(self.topic)
        if kind is None:
            people = [name for name in sorted(published) if published[name] in KINDS]
            topics = [f"{name} ({ros1_name(published[name])})" for name in people]
            other = ", ".join(topics) or "no topic"
            return f"nobody publishes {self.topic}; there are people on {other}"
        if self.kind not in ("", kind):
            kinds = f"{ros1_name(kind)}, but is heard as {ros1_name(self.kind)}"
            return f"{self.topic} is of {kinds}: --message names its type"
        return f"no message has come on {self.topic}"

    def work(self) -> None:
        """Take in the messages that wait, and publish the forecast of the newest frame."""
        with self._changed:
            heard = list(self._waiting)
            self._waiting.clear()
        frames = []
        for message in heard:
            frames += self.source.take(*message)
        frames += self.source.release(self._elapsed())
        malformed = [frame for frame in frames if not 0 <= frame.stamp < LAST]
        self.source.refused["malformed"] += len(malformed)
        frames = [frame for frame in frames if 0 <= frame.stamp < LAST]
        if not frames:
            return
        if self.stitcher is not None:
            frames = [self.stitcher.mend(frame) for frame in frames]
        for frame in frames:
            self.status.heard(frame.stamp)
        event = advance(frames, self.predictor, self.source.robot(frames[-1].stamp))
        common = self.predictor.window.period, self.source.frame_id or ""
        if event.forecast is not None:
            for output, outlet in self._forecasts:
                arguments = self._new, event.forecast, output.model, *common
                outlet.publish(output.make, *arguments)
            self.status.published(self._now() - event.frame.stamp, event.skipped)
        self.predictor.learn()
        for done in self.analytics.add(event.forecast):
            self._truth.publish(truth_message, self._new, done, *common)
        for frame in frames:
            self._mended.publish(self._people, frame)
        for view in self.views:
            view.show(event, self.status.now())

    def _people(self, frame: Frame) -> Any:
        """The message of a frame, with velocities where they are known."""
        window = self.predictor.window
        before, now = window.resampled(
            frame.ids, frame.stamp - np.array([window.period, 0.0])
        ).swapaxes(0, 1)
        speed = (now - before) / window.period
        return make_people(self._new, frame, self.source.frame_id or "", speed)
