"""`python -m neurosym_jax ros1 --model MODEL`: forecasts in a ROS 1 graph.

People in, HumansTrajs out, on the topics of the robot experiment. Neither rospy nor a ROS
installation is needed, because `online.tcpros` speaks for itself. The predictor knows nothing of
ROS; what is here is the way from topics to frames and from forecasts to topics.
"""

import contextlib
import dataclasses
import functools
import queue
import signal
import sys
import time
from collections.abc import Callable

from neurosym_jax.online.analytics import Analytics
from neurosym_jax.online.forecast_messages import forecast_message, truth_message
from neurosym_jax.online.live_options import LiveOptions, make_predictor
from neurosym_jax.online.messages import (
    HUMANS_TRAJS,
    PEOPLE,
    PEOPLE_TOPICS,
    TRUTH_TOPIC,
    forecast_topic,
    frame_of_people,
    typestore,
)
from neurosym_jax.online.predictor import Forecast, Predictor
from neurosym_jax.online.tcpros import Node, Topic

__all__ = ["ForecastNode", "Ros1Options", "ros1"]

WAITING = 32
"""Messages that wait at most: three seconds of a tracker's."""
LAST = 2.0**31 - 1000
"""Seconds; rosbags counts ROS 1's in 32 bits with a sign, and forecasts lie ahead."""


@dataclasses.dataclass(frozen=True)
class Ros1Options(LiveOptions):
    """Forecast the people of a ROS 1 graph until interrupted; needs no ROS here."""

    topic: str = PEOPLE_TOPICS[0]
    """Of the people, people_msgs/People."""
    master: str | None = None
    """URI; by default $ROS_MASTER_URI, else http://localhost:11311."""
    name: str = "neurosym_jax"
    """Of this node."""
    status: float = 10.0
    """Seconds between lines that say how it goes; 0 for none."""


class ForecastNode:
    """A predictor in a ROS 1 graph; `run` it, and `close` it whatever happens."""

    def __init__(self, predictor: Predictor, options: Ros1Options, report: Callable[[str], None]):
        """Join the graph.

        Raises:
            InputError: for a topic, name or URI that is none, or if rosbags is not installed.
        """
        self.predictor, self.analytics = predictor, Analytics()
        self.malformed = self.late = 0
        """Messages that could not be read; that came faster than they could be worked on."""
        self._store = typestore(1)
        self._waiting: queue.Queue[bytes] = queue.Queue(WAITING)
        self._frame_id = "map"
        self._status, self._report = options.status, report
        people = self._topic(options.topic, PEOPLE)
        self.node = Node(options.name, options.master, report)
        self._forecasts = {
            name: self.node.advertise(self._topic(forecast_topic(name), HUMANS_TRAJS))
            for name in predictor.models
        }
        self._truth = self.node.advertise(self._topic(TRUTH_TOPIC, HUMANS_TRAJS))
        self.node.subscribe(people, self._hear)

    def run(self) -> None:
        """Forecast until the node is stopped."""
        looked = time.monotonic()
        while not self.node.stopped.is_set():
            with contextlib.suppress(queue.Empty):
                self._work(self._waiting.get(timeout=0.2))
            if self._status and time.monotonic() - looked >= self._status:
                looked = time.monotonic()
                self._report(self.status())

    def status(self) -> str:
        """How it went so far, in one line."""
        summary, health = self.analytics.summary(), dataclasses.asdict(self.predictor.health)
        parts = [f"{health.pop('frames')} frames, {summary['forecasts']} forecasts"]
        if summary["forecasts"]:
            latency = summary["latency_ms"]
            parts.append(f"latency p50 {latency['p50']:.1f} ms, p99 {latency['p99']:.1f} ms")
        parts += [
            f"{name} ADE {means['joint_ade']:.2f} m, FDE {means['joint_fde']:.2f} m"
            for name, means in summary["models"].items()
            if means["people"]
        ]
        counts = {**health, "malformed": self.malformed, "late": self.late}
        parts.append(", ".join(f"{name} {n}" for name, n in counts.items() if n))
        return "; ".join(filter(None, parts))

    def close(self) -> None:
        """Leave the graph."""
        self.node.close()

    def _topic(self, name: str, kind: str) -> Topic:
        definition, md5 = self._store.generate_msgdef(kind, ros_version=1)
        return Topic(name, kind.replace("/msg/", "/"), md5, definition)

    def _hear(self, data: bytes, publisher: str) -> None:
        """Queue a message; where there are too many the oldest is left out."""
        while True:
            try:
                return self._waiting.put_nowait(data)
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._waiting.get_nowait()
                    self.late += 1

    def _work(self, data: bytes) -> None:
        from rosbags.serde import SerdeError

        try:
            message = self._store.deserialize_ros1(data, PEOPLE)
        except SerdeError:
            self.malformed += 1
            return
        frame = frame_of_people(message)
        if not 0 <= frame.stamp < LAST:
            self.malformed += 1
            return
        self._frame_id = message.header.frame_id
        forecast = self.predictor.push(*frame)
        if forecast is not None:
            self._publish(forecast)

    def _publish(self, forecast: Forecast) -> None:
        say = {"types": self._store.types, "period": self.predictor.window.period}
        say["frame_id"] = self._frame_id
        for name, publisher in self._forecasts.items():
            if publisher.subscribers:
                message = forecast_message(forecast=forecast, model=name, **say)
                publisher.publish(bytes(self._store.serialize_ros1(message, HUMANS_TRAJS)))
        for done in self.analytics.add(forecast):
            if self._truth.subscribers and (message := truth_message(forecast=done, **say)):
                self._truth.publish(bytes(self._store.serialize_ros1(message, HUMANS_TRAJS)))


def ros1(options: Ros1Options) -> None:
    """Do what the verb says.

    Raises:
        InputError: for a model, topic, name or URI that cannot be used.
    """
    report = functools.partial(print, file=sys.stderr, flush=True)
    predictor = make_predictor(options)
    node = ForecastNode(predictor, options, report)
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: node.node.stopped.set())
        report(f"{node.node.name}: listening to {options.topic}, master {node.node.master}")
        node.run()
    finally:
        node.close()
    report(node.status())
