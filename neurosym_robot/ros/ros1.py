"""A predictor in a ROS 1 graph.

People in, HumansTrajs out, on the topics of the robot experiment. Neither rospy nor a ROS
installation is needed, because `ros.tcpros` speaks for itself. The predictor knows nothing of
ROS; what is here is the way from topics to frames and from forecasts to topics.
"""

import contextlib
import dataclasses
import functools
import itertools
import queue
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.likely import AT_LEAST
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.ros.bags import TF_TOPICS
from neurosym_robot.ros.decoding import Decoder
from neurosym_robot.ros.definitions import HUMANS_TRAJS, PEOPLE, TRANSFORMS, blank, ros1_name
from neurosym_robot.ros.forecast_messages import forecast_message, truth_message
from neurosym_robot.ros.forecasting_node import DIAGNOSE, ForecastingNode
from neurosym_robot.ros.messages import PEOPLE_TOPICS, WAITING, make_people
from neurosym_robot.ros.outgoing import DIAGNOSTICS, diagnostics_message
from neurosym_robot.ros.source import Source
from neurosym_robot.ros.tcpros import Node, Publisher, Topic
from neurosym_robot.tracking.live import NOBODY, OnlineStitcher

__all__ = ["ForecastNode"]

LAST = 2.0**31 - 1000
"""Seconds; rosbags counts ROS 1's in 32 bits with a sign, and forecasts lie ahead."""

Heard = tuple[bytes, Mapping[str, str] | None, float]
"""A message, its publisher's header, and when it came."""


class ForecastNode(ForecastingNode):
    """A predictor in a ROS 1 graph; `run` it, and `close` it whatever happens."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str | None = None,
        source: Source | None = None,
        stitcher: OnlineStitcher | None = None,
        master: str | None = None,
        name: str = "neurosym_jax",
        remaps: Iterable[str] = (),
        status: float = 10.0,
        at_least: float = AT_LEAST,
        report: Callable[[str], None] = print,
    ):
        """Join the graph.

        Args:
            predictor: of one or several models, each with a topic of its own.
            topic: of the people; None is the first of `PEOPLE_TOPICS`, and the second where ids
                are mended.
            source: which messages belong to the stream, and where they are taken to.
            stitcher: mends ids, if given; the people are then published on the first topic.
            master: URI; see `names.master_uri`.
            name: of the node.
            remaps: "FROM:=TO" each, of names in the graph.
            status: seconds between reports of how it goes; 0 for none.
            at_least: probability from which on an event of a pair is told.
            report: is told, in one line each, how it goes and what happens to connections.

        Raises:
            InputError: for a topic, name or URI that is none, or if rosbags is not installed.
        """
        self.malformed = self.late = 0
        """Messages that could not be read; that came faster than they could be worked on."""
        source = source or Source(report=report)
        super().__init__(predictor, source, stitcher, at_least, status, report)
        self._decoder = Decoder()
        self._store = self._decoder.store
        self._waiting: queue.Queue[Heard] = queue.Queue(WAITING)
        self._make[HUMANS_TRAJS] = lambda new, *told, **common: forecast_message(
            self._store.types, *told, **common
        )
        self._diagnosed = 0.0
        filtered, raw = PEOPLE_TOPICS
        self.node = Node(name, master, report, remaps)
        people = Topic(self.node.names(topic or (raw if stitcher else filtered)))
        if stitcher and people.name == self.node.names(filtered):
            self.node.close()
            raise InputError(f"--stitch publishes {filtered}, so --topic must be another")
        advertise = self._advertise
        self.publish_on(HUMANS_TRAJS, advertise)
        self._diagnostics = advertise("/diagnostics", DIAGNOSTICS)
        self._mended = advertise(filtered, PEOPLE) if stitcher else None
        subscriber = self.node.subscribe(people, self.hear, self._decoder.refuse)
        self.source.is_there = subscriber.hears
        if self.source.needs_transforms:
            kind = self._topic(TF_TOPICS[0], TRANSFORMS)
            for name in TF_TOPICS:
                self.node.subscribe(
                    dataclasses.replace(kind, name=name),
                    functools.partial(self._hear_transforms, name == TF_TOPICS[1]),
                )
        report(f"{self.node.name}: listening to {people.name}, master {self.node.master}")

    def run(self) -> None:
        """Forecast until the node is stopped."""
        while not self.node.stopped.is_set():
            with contextlib.suppress(queue.Empty):
                self.work(*self._waiting.get(timeout=0.2))
            self.status.look()
            if time.monotonic() - self._diagnosed >= DIAGNOSE and self._diagnostics.subscribers:
                self._diagnosed = time.monotonic()
                message = diagnostics_message(self._new, self.status, self.node.name, time.time())
                self._send(self._diagnostics, message)

    def hear(self, data: bytes, header: Mapping[str, str] | None = None) -> None:
        """Queue serialised people; where there are too many the oldest are left out."""
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
        """Take in serialised people, and publish what they lead to.

        Args:
            data: the message.
            header: what its publisher said of itself; without one it is a People.
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
            frame = self._mend(self.stitcher, self._mended, frame, kind, message)
        self.forecast(frame)

    def _counts(self) -> dict[str, int]:
        return {**super()._counts(), "malformed": self.malformed, "late": self.late}

    def _new(self, kind: str) -> Any:
        return blank(self._store, kind)

    def _is_heard(self, publisher: Publisher) -> bool:
        return bool(publisher.subscribers)

    def _happened(self, *done: Any, **common: Any) -> Any:
        return truth_message(self._store.types, *done, **common)

    def _mend(
        self, stitcher: OnlineStitcher, to: Publisher, frame: Frame, kind: str, message: Any
    ) -> Frame:
        """Under mended names, which are published, too."""
        ids = stitcher.push(*frame)
        somebody = ids != NOBODY
        mended = Frame(frame.stamp, ids[somebody], frame.xy[somebody])
        if kind != PEOPLE or message.header.frame_id.removeprefix("/") != self.source.frame_id:
            self._send(to, make_people(self._store.types, mended, self.source.frame_id or ""))
        else:  # As they came but for their names.
            message.people = list(itertools.compress(message.people, somebody))
            for person, id in zip(message.people, mended.ids.tolist()):
                person.name = str(id)
            self._send(to, message)
        return mended

    def _hear_transforms(self, static: bool, data: bytes, header: Mapping[str, str]) -> None:
        from rosbags.serde import SerdeError

        with contextlib.suppress(SerdeError):
            message = self._store.deserialize_ros1(data, TRANSFORMS)
            self.source.transforms.hear(message, static)

    def close(self) -> None:
        """Leave the graph."""
        self.node.close()
        if self.dashboard is not None:
            self.dashboard.close()

    def _topic(self, name: str, kind: str) -> Topic:
        definition, md5 = self._store.generate_msgdef(kind, ros_version=1)
        return Topic(self.node.names(name), ros1_name(kind), md5, definition)

    def _advertise(self, name: str, kind: str) -> Publisher:
        return self.node.advertise(self._topic(name, kind))

    def _send(self, publisher: Publisher, message: Any) -> None:
        publisher.publish(bytes(self._store.serialize_ros1(message, message.__msgtype__)))
