"""A predictor in a ROS 1 graph, on the topics of the robot experiment.

`ros.tcpros` speaks to the graph, so neither rospy nor a ROS installation is needed.
"""

import contextlib
import functools
import itertools
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.online.frames import Frame
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.ros.bags import TF_TOPICS
from neurosym_robot.ros.decoding import Decoder
from neurosym_robot.ros.definitions import PEOPLE, TRANSFORMS, blank, ros1_name
from neurosym_robot.ros.forecasting_node import ForecastingNode
from neurosym_robot.ros.messages import PEOPLE_TOPICS, make_people
from neurosym_robot.ros.people import seconds_of
from neurosym_robot.ros.tcpros import Node, Publisher, Topic
from neurosym_robot.ros.tcpros.xmlrpc import CallError, call

__all__ = ["ForecastNode"]

LAST = 2.0**31 - 1000  # seconds: rosbags counts ROS 1's in signed 32 bits, and forecasts lie ahead
CLOCK = "rosgraph_msgs/msg/Clock"


class ForecastNode(ForecastingNode):
    """A predictor in a ROS 1 graph; `run` it, and `close` it whatever happens."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str | None = None,
        master: str | None = None,
        remaps: Iterable[str] = (),
        report: Callable[[str], None] = print,
        **options: Any,
    ):
        """Join the graph.

        Args:
            predictor: of one or several models, each with a topic of its own.
            topic: of the people; None is the first of `PEOPLE_TOPICS`, or the second with a
                `stitcher`, as the mended people are published on the first.
            master: URI.
            remaps: of names in the graph.
            report: called with one line at a time.
            **options: see `ForecastingNode`.

        Raises:
            InputError: for an invalid topic, name or URI, or if rosbags is not installed.
        """
        self.malformed = 0
        """Messages that could not be read."""
        self._clock: float | None = None  # seconds of simulated time
        super().__init__(predictor, report, **options)
        self._decoder = Decoder()
        self._store = self._decoder.store
        filtered, raw = PEOPLE_TOPICS
        self.node = Node(self.name, master, report, remaps)
        self.stopped, self.name = self.node.stopped, self.node.name
        people = Topic(self.node.names(topic or (raw if self.stitcher else filtered)))
        if self.stitcher and people.name == self.node.names(filtered):
            self.node.close()
            raise InputError(f"--stitch publishes {filtered}, so --topic must be another")
        self.advertise()
        self._mended = self._advertise(filtered, PEOPLE) if self.stitcher else None
        subscriber = self.node.subscribe(people, self.hear, self._decoder.refuse)
        self.source.is_there = subscriber.hears
        for name in TF_TOPICS if self.source.needs_transforms else ():
            hear = functools.partial(self.source.transforms.hear, static=name == TF_TOPICS[1])
            self._listen(name, TRANSFORMS, hear)
        with contextlib.suppress(CallError):
            if call(self.node.master, "getParam", self.name, "/use_sim_time"):
                self._clock = 0.0
                self._listen("/clock", CLOCK, self._set_clock)
        report(f"{self.name}: listening to {people.name}, master {self.node.master}")

    def hear(self, data: bytes, header: Mapping[str, str] | None = None) -> None:
        """Let serialised people wait; without a header they are a People."""
        self.put(data, header, time.monotonic())

    def _read(self, data: bytes, header: Mapping[str, str] | None, received: float) -> Frame | None:
        from rosbags.serde import SerdeError

        try:
            kind, message = self._decoder.decode(data, header)
        except SerdeError:
            self.malformed += 1
            return None
        frame = self.source.take(kind, message, (header or {}).get("callerid", ""), received)
        if frame is None:
            return None
        if not 0 <= frame.stamp < LAST:
            self.malformed += 1
            return None
        if self.stitcher is not None and self._mended is not None:
            frame, known = self.stitcher.mend(frame)
            self._send(self._mended, self._renamed(kind, message, frame, known))
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

    def _listen(self, name: str, kind: str, hear: Callable[[Any], None]) -> None:
        """Subscribe to messages of a type that is known here."""
        from rosbags.serde import SerdeError

        def decode(data: bytes, header: Mapping[str, str]) -> None:
            with contextlib.suppress(SerdeError):
                hear(self._store.deserialize_ros1(data, kind))

        self.node.subscribe(self._topic(name, kind), decode)

    def _set_clock(self, message: Any) -> None:
        self._clock = seconds_of(message.clock)

    def _now(self) -> float:
        return time.time() if self._clock is None else self._clock

    def close(self) -> None:
        """Leave the graph."""
        self.node.close()

    def _counts(self) -> dict[str, int]:
        return {**super()._counts(), "malformed": self.malformed}

    def _topic(self, name: str, kind: str) -> Topic:
        definition, md5 = self._store.generate_msgdef(kind, ros_version=1)
        return Topic(self.node.names(name), ros1_name(kind), md5, definition)

    def _new(self, kind: str) -> Any:
        return blank(self._store, kind)

    def _advertise(self, topic: str, kind: str) -> Publisher:
        return self.node.advertise(self._topic(topic, kind))

    def _is_heard(self, publisher: Publisher) -> bool:
        return bool(publisher.subscribers)

    def _send(self, publisher: Publisher, message: Any) -> None:
        publisher.publish(bytes(self._store.serialize_ros1(message, message.__msgtype__)))
