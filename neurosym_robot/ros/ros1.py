"""A predictor in a ROS 1 graph, on the topics of the robot experiment.

`ros.tcpros` speaks to the graph, so neither rospy nor a ROS installation is needed.
"""

import contextlib
import importlib
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.input.kinds import KINDS
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.ros.definitions import (
    PEOPLE,
    PEOPLE_TOPICS,
    definitions,
    ros1_name,
    seconds_of,
    typestore,
)
from neurosym_robot.ros.forecasting_node import ForecastingNode, Outlet
from neurosym_robot.ros.tcpros import CallError, Node, Topic, call
from neurosym_robot.tracking.stitching import OnlineStitcher


class Decoder:
    """Reads messages of people of ROS 1, of the `KINDS`, each defined as its publisher defines it.

    A type that we define is refused if its publisher's definition differs. Raises
    InputError if rosbags is not installed.
    """

    def __init__(self, any_kind: bool = False):
        """Of `any_kind` instead, if options say where a message holds its people."""
        self._any_kind = any_kind
        self._learned: dict[tuple[str, str], Any] = {}
        self.store = typestore(1)
        self.error = importlib.import_module("rosbags.serde").SerdeError
        """What `decode` raises for bytes that are no such message."""

    def refuse(self, header: Mapping[str, str]) -> str | None:
        """Why messages of a publisher with this header cannot be read, or None."""
        kind, md5 = (
            header.get("type", "").replace("/", "/msg/"),
            header.get("md5sum", ""),
        )
        if kind not in KINDS and not self._any_kind:
            return "none of the types of docs/robot.md; --people says how to read it"
        if kind in definitions():
            own_md5 = self.store.generate_msgdef(kind, ros_version=1)[1]
            return (
                None if md5 == own_md5 else f"not {ros1_name(kind)} with md5 {own_md5}"
            )
        from rosbags.typesys import get_types_from_msg

        store = typestore(1)
        try:
            types = get_types_from_msg(header.get("message_definition", ""), kind)
            store.register(
                {name: form for name, form in types.items() if name not in store.types}
            )
            true_md5 = store.generate_msgdef(kind, ros_version=1)[1]
        except (
            Exception
        ) as error:  # The text is not ours and can make the parser raise anything.
            return f"whose definition cannot be read ({type(error).__name__})"
        if true_md5 != md5:
            return f"whose definition has the md5 {true_md5}"
        self._learned[kind, md5] = store
        return None

    def decode(self, data: bytes, header: Mapping[str, str]) -> tuple[str, Any]:
        """Type and message; `error` for bytes that are no such message."""
        kind = header["type"].replace("/", "/msg/")
        store = self._learned.get((kind, header["md5sum"]), self.store)
        return kind, store.deserialize_ros1(data, kind)


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
        name: str = "neurosym_jax",
        stitcher: OnlineStitcher | None = None,
        **options: Any,
    ):
        """Join the graph of the `master`, a URI; further arguments as of `ForecastingNode`.

        People come on `topic`; None is the first of `PEOPLE_TOPICS`, or the second with
        a `stitcher`, as the mended people are published on the first. InputError for an
        invalid topic, name or URI, or if rosbags is not installed.
        """
        filtered, raw = PEOPLE_TOPICS
        if stitcher is not None and topic == filtered:
            raise InputError(
                f"--stitch publishes {filtered}, so --topic must be another"
            )
        source = options.get("source")
        self._decoder = Decoder(source is not None and source.form is not None)
        self._clock: float | None = None  # seconds of simulated time
        self.node = Node(name, master, report, remaps)
        options |= {"name": self.node.name, "stitcher": stitcher}
        super().__init__(predictor, self._decoder.store, report, **options)
        self.stopped = self.node.stopped
        if stitcher is not None:
            self._mended = self._advertise(filtered, PEOPLE)
        people = Topic(self.node.names(topic or (raw if stitcher else filtered)))
        subscriber = self.node.subscribe(people, self.hear, self._decoder.refuse)
        self.source.is_there = lambda name: name in subscriber.publishers.values()
        with contextlib.suppress(CallError):
            if call(self.node.master, "getParam", self.name, "/use_sim_time"):
                self._clock = 0.0
                self._listen("/clock", "rosgraph_msgs/msg/Clock", self._set_clock)
        self.topic = people.name
        report(f"{self.name}: listening to {self.topic}, master {self.node.master}")

    def hear(self, data: bytes, header: Mapping[str, str]) -> None:
        """Let serialised people wait."""
        try:
            self.put(*self._decoder.decode(data, header), header.get("callerid", ""))
        except self._decoder.error:
            self.source.refused["malformed"] += 1

    def _listen(self, name: str, kind: str, hear: Callable[[Any], None]) -> None:
        def decode(data: bytes, header: Mapping[str, str]) -> None:
            with contextlib.suppress(self._decoder.error):
                hear(self._store.deserialize_ros1(data, kind))

        self.node.subscribe(self._topic(name, kind), decode)

    def _published(self) -> dict[str, str]:
        try:
            topics = call(self.node.master, "getPublishedTopics", self.name, "")
            return {name: kind.replace("/", "/msg/") for name, kind in topics}
        except (CallError, TypeError, ValueError):  # The answer may be anything.
            return {}

    def _set_clock(self, message: Any) -> None:
        self._clock = seconds_of(message.clock)

    def _now(self) -> float:
        return time.time() if self._clock is None else self._clock

    def _is_simulated(self) -> bool:
        return self._clock is not None

    def close(self) -> None:
        """Leave the graph."""
        self.node.close()

    def _topic(self, name: str, kind: str) -> Topic:
        definition, md5 = self._store.generate_msgdef(kind, ros_version=1)
        # As ROS 1 writes it: `rosbag play --rate-control-topic` knows no other form.
        definition = definition.replace("std_msgs/Header header", "Header header")
        return Topic(self.node.names(name), ros1_name(kind), md5, definition)

    def _advertise(self, topic: str, kind: str) -> Outlet:
        publisher = self.node.advertise(self._topic(topic, kind))

        def send(message: Any) -> None:
            publisher.publish(
                bytes(self._store.serialize_ros1(message, message.__msgtype__))
            )

        return Outlet(send, lambda: bool(publisher.subscribers))
