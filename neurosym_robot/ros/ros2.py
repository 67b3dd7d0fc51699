"""A predictor in a ROS 2 graph, with rclpy, and the parameters that a launch file gives it."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer and is absent where the linters run.

import functools
import importlib
import time
from collections.abc import Mapping, Sequence
from typing import Any

from neurosym_jax.errors import InputError
from neurosym_robot.online.pairs import AT_LEAST
from neurosym_robot.online.predictor import Predictor
from neurosym_robot.ros.bags import TF_TOPICS
from neurosym_robot.ros.definitions import PEOPLE, TRANSFORMS
from neurosym_robot.ros.forecasting_node import DIAGNOSE, ForecastingNode
from neurosym_robot.ros.messages import PEOPLE_TOPICS, WAITING
from neurosym_robot.ros.people import POSES
from neurosym_robot.ros.source import PeopleSource
from neurosym_robot.tracking.live import OnlineStitcher

__all__ = ["ForecastNode", "import_rclpy", "message_type", "node_parameters"]

OF_EVERY_NODE = ("use_sim_time", "start_type_description_service", "qos_overrides")


def import_rclpy() -> Any:
    """The module rclpy; InputError if ROS 2 is not set up."""
    try:
        return importlib.import_module("rclpy")
    except ImportError:
        text = "this needs rclpy in the same Python: set up a ROS 2 (Jazzy or later) first"
        raise InputError(text) from None


def message_type(kind: str) -> Any:
    """The class of a message, by its type; InputError if its package is missing."""
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(f"this ROS 2 has no {package}") from None


def node_parameters(arguments: Sequence[str], name: str) -> dict[str, Any]:
    """Parameters by name, from files and `-p` in the `arguments` after `--ros-args`.

    `name` is the node's, unless the arguments name it. InputError for arguments that ROS 2 refuses.
    """
    rclpy = import_rclpy()
    context = rclpy.context.Context()
    try:
        rclpy.init(args=["--ros-args", *arguments], context=context)
        node = rclpy.create_node(
            name, context=context, automatically_declare_parameters_from_overrides=True
        )
        found = {key: value.value for key, value in node.get_parameters_by_prefix("").items()}
        node.destroy_node()
    except Exception as error:  # rclpy passes on several kinds of errors of its C library.
        raise InputError(f"--ros-args: {' '.join(str(error).split())}") from None
    finally:
        rclpy.try_shutdown(context=context)
    return {key: value for key, value in found.items() if key.split(".")[0] not in OF_EVERY_NODE}


class ForecastNode(ForecastingNode):
    """A predictor in a ROS 2 graph; rclpy must have been initialised."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str = PEOPLE_TOPICS[0],
        kind: str = PEOPLE,
        source: PeopleSource | None = None,
        stitcher: OnlineStitcher | None = None,
        name: str = "neurosym_jax",
        status: float = 10.0,
        at_least: float = AT_LEAST,
    ):
        """Join the graph.

        Args:
            predictor: of one or several models, each with topics of its own.
            topic: of the people.
            kind: type of their messages, a key of `people.KINDS`.
            source: which messages belong to the stream and into which frame they are transformed.
            stitcher: mends ids, if given.
            name: of the node.
            status: seconds between lines about the stream; 0 for none.
            at_least: least probability of an event that is published.

        Raises:
            InputError: if ROS 2 has no such message.
        """
        rclpy, people = import_rclpy(), message_type(kind)
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        self.kind, self.node = kind, rclpy.create_node(name)
        report = self.node.get_logger().info
        super().__init__(predictor, source or PeopleSource(), stitcher, at_least, status, report)
        self.publish(POSES)
        self.node.create_timer(DIAGNOSE, self._look)
        # A best-effort subscription receives from reliable publishers, too.
        quality = QoSProfile(depth=WAITING, reliability=ReliabilityPolicy.BEST_EFFORT)
        heard = self.node.create_subscription(people, topic, self.hear, quality)
        self.topic = heard.topic_name
        """Of the people, after remapping."""
        if self.source.needs_transforms:
            latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            for name, quality in zip(TF_TOPICS, (QoSProfile(depth=100), latched)):
                hear = functools.partial(self.source.transforms.hear, static=name == TF_TOPICS[1])
                self.node.create_subscription(message_type(TRANSFORMS), name, hear, quality)

    def hear(self, message: Any, info: Mapping[str, Any]) -> None:
        """Take in a message of people, and publish what follows from it."""
        publisher = (info.get("publisher_gid") or {}).get("data", b"")
        frame = self.source.take(self.kind, message, bytes(publisher).hex(), time.monotonic())
        if frame is not None:
            self.forecast(frame, self.stitcher)

    def _look(self) -> None:
        self.status.look()
        self.diagnose(self.node.get_fully_qualified_name())

    def _new(self, kind: str) -> Any:
        return message_type(kind)()

    def _advertise(self, topic: str, kind: str) -> Any:
        try:
            return self.node.create_publisher(message_type(kind), topic, 10)
        except InputError:  # This ROS 2 lacks the message's package.
            return None

    def _is_heard(self, publisher: Any) -> bool:
        return publisher.get_subscription_count() > 0

    def _send(self, publisher: Any, message: Any) -> None:
        publisher.publish(message)
