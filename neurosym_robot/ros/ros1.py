"""A predictor in a ROS 1 graph, on the topics of the robot experiment.

`ros.tcpros` speaks to the graph, so neither rospy nor a ROS installation is needed.
"""

import contextlib
import functools
import itertools
import queue
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.online.frames import Frame
from neurosym_robot.online.pairs import AT_LEAST
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.ros.bags import TF_TOPICS
from neurosym_robot.ros.decoding import Decoder
from neurosym_robot.ros.definitions import HUMANS_TRAJS, PEOPLE, TRANSFORMS, blank, ros1_name
from neurosym_robot.ros.forecasting_node import DIAGNOSE, ForecastingNode
from neurosym_robot.ros.messages import PEOPLE_TOPICS, WAITING, make_people
from neurosym_robot.ros.source import PeopleSource
from neurosym_robot.ros.tcpros import Node, Publisher, Topic
from neurosym_robot.tracking.live import OnlineStitcher, mend

__all__ = ["ForecastNode"]

LAST = 2.0**31 - 1000  # seconds: rosbags counts ROS 1's in signed 32 bits, and forecasts lie ahead

# A message, its publisher's header, and its time of arrival.
Heard = tuple[bytes, Mapping[str, str] | None, float]


class ForecastNode(ForecastingNode):
    """A predictor in a ROS 1 graph; `run` it, and `close` it whatever happens."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str | None = None,
        source: PeopleSource | None = None,
        stitcher: OnlineStitcher | None = None,
        master: str | None = None,
        name: str = "neurosym_jax",
        remaps: Iterable[str] = (),
        status: float = 10.0,
        at_least: float = AT_LEAST,
        report: Callable[[str], None] = print,
    ):
        """Join the graph; other arguments are those of `ForecastingNode` and `tcpros.Node`.

        Args:
            predictor: of one or several models, each with a topic of its own.
            topic: of the people; None is the first of `PEOPLE_TOPICS`, or the second with a
                `stitcher`, as the mended people are published on the first.
            source: which messages belong to the stream.
            stitcher: mends ids, if given.
            master: URI.
            name: of the node.
            remaps: of names in the graph.
            status: seconds between status lines.
            at_least: least probability of an event.
            report: called with one line at a time.

        Raises:
            InputError: for an invalid topic, name or URI, or if rosbags is not installed.
        """
        self.malformed = self.late = 0
        """Messages that could not be read; that were dropped from a full queue."""
        source = source or PeopleSource(report=report)
        super().__init__(predictor, source, stitcher, at_least, status, report)
        self._decoder = Decoder()
        self._store = self._decoder.store
        self._waiting: queue.Queue[Heard] = queue.Queue(WAITING)
        self._diagnosed = 0.0
        filtered, raw = PEOPLE_TOPICS
        self.node = Node(name, master, report, remaps)
        people = Topic(self.node.names(topic or (raw if stitcher else filtered)))
        if stitcher and people.name == self.node.names(filtered):
            self.node.close()
            raise InputError(f"--stitch publishes {filtered}, so --topic must be another")
        self.publish(HUMANS_TRAJS)
        self._mended = self._advertise(filtered, PEOPLE) if stitcher else None
        subscriber = self.node.subscribe(people, self.hear, self._decoder.refuse)
        self.source.is_there = subscriber.hears
        for name in TF_TOPICS if self.source.needs_transforms else ():
            hear = functools.partial(self._hear_transforms, name == TF_TOPICS[1])
            self.node.subscribe(self._topic(name, TRANSFORMS), hear)
        report(f"{self.node.name}: listening to {people.name}, master {self.node.master}")

    def run(self) -> None:
        """Forecast until the node is stopped."""
        while not self.node.stopped.is_set():
            with contextlib.suppress(queue.Empty):
                self.work(*self._waiting.get(timeout=0.2))
            self.status.look()
            if time.monotonic() - self._diagnosed >= DIAGNOSE:
                self._diagnosed = time.monotonic()
                self.diagnose(self.node.name)

    def hear(self, data: bytes, header: Mapping[str, str] | None = None) -> None:
        """Queue serialised people; a full queue drops the oldest."""
        while True:
            try:
                return self._waiting.put_nowait((data, header, time.monotonic()))
            except queue.Full:
                with contextlib.suppress(queue.Empty):
                    self._waiting.get_nowait()
                    self.late += 1

    def work(
        self, data: bytes, header: Mapping[str, str] | None = None, received: float = 0.0
    ) -> None:
        """Take in serialised people, and publish what follows from them.

        Args:
            data: the message.
            header: the publisher's connection header; without one the message is a People.
            received: seconds of this computer's clock.
        """
        from rosbags.serde import SerdeError

        try:
            kind, message = self._decoder.decode(data, header)
        except SerdeError:
            self.malformed += 1
            return
        publisher = (header or {}).get("callerid", "")
        frame = self.source.take(kind, message, publisher, received)
        if frame is None:
            return
        if not 0 <= frame.stamp < LAST:
            self.malformed += 1
            return
        if self.stitcher is not None and self._mended is not None:
            frame, known = mend(self.stitcher, frame)
            self._send(self._mended, self._renamed(kind, message, frame, known))
        self.forecast(frame)

    def _renamed(self, kind: str, message: Any, frame: Frame, known: Any) -> Any:
        """People with mended ids: the message received, renamed, if its coordinates are ours."""
        if kind != PEOPLE or message.header.frame_id.removeprefix("/") != self.source.frame_id:
            return make_people(self._new, frame, self.source.frame_id or "")
        message.people = list(itertools.compress(message.people, known))
        for person, id in zip(message.people, frame.ids.tolist()):
            person.name = str(id)
        return message

    def _hear_transforms(self, static: bool, data: bytes, header: Mapping[str, str]) -> None:
        from rosbags.serde import SerdeError

        with contextlib.suppress(SerdeError):
            message = self._store.deserialize_ros1(data, TRANSFORMS)
            self.source.transforms.hear(message, static)

    def close(self) -> None:
        """Leave the graph."""
        self.node.close()

    def _counts(self) -> dict[str, int]:
        return {**super()._counts(), "malformed": self.malformed, "late": self.late}

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
