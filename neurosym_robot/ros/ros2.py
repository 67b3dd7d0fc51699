"""A predictor in a ROS 2 graph, with rclpy.

People in, poses, markers and samples out. rclpy is imported when the node is made: this file is the
only one that needs it, and the predictor knows nothing of it.
"""

# pyright: reportMissingImports=false
# ROS 2 has its own installer; where the linters run there is none.

import functools
import importlib
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from neurosym_jax.errors import InputError
from neurosym_robot.online.likely import AT_LEAST
from neurosym_robot.online.predictor import Forecast, Predictor
from neurosym_robot.ros.bags import TF_TOPICS
from neurosym_robot.ros.definitions import PEOPLE, TRANSFORMS
from neurosym_robot.ros.forecasting_node import DIAGNOSE, ForecastingNode
from neurosym_robot.ros.messages import PEOPLE_TOPICS, WAITING
from neurosym_robot.ros.outgoing import DIAGNOSTICS, central_path, diagnostics_message, put_stamp
from neurosym_robot.ros.people import POSES
from neurosym_robot.ros.source import Source
from neurosym_robot.tracking.live import OnlineStitcher

__all__ = ["ForecastNode", "has", "message_type"]


class ForecastNode(ForecastingNode):
    """A predictor in a ROS 2 graph; rclpy must have been initialised."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str = PEOPLE_TOPICS[0],
        kind: str = PEOPLE,
        source: Source | None = None,
        stitcher: OnlineStitcher | None = None,
        name: str = "neurosym_jax",
        status: float = 10.0,
        at_least: float = AT_LEAST,
    ):
        """Join the graph.

        Args:
            predictor: of one or several models, each with topics of its own.
            topic: of the people.
            kind: their type, a key of `people.KINDS`.
            source: which messages belong to the stream, and where they are taken to.
            stitcher: mends ids, if given.
            name: of the node.
            status: seconds between lines on how it goes; 0 for none.
            at_least: probability from which on an event of a pair is told.

        Raises:
            InputError: where ROS 2 has no such message.
        """
        import rclpy
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        people = message_type(kind)
        self.kind, self.node = kind, rclpy.create_node(name)
        report = self.node.get_logger().info
        super().__init__(predictor, source or Source(), stitcher, at_least, status, report)
        self._make[POSES] = _path
        self.publish_on(POSES, self._advertise)
        self.node.create_timer(DIAGNOSE, self._look)
        self._diagnostics = self._advertise("/diagnostics", DIAGNOSTICS)
        # Best effort hears publishers of either kind.
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
        """Take in a message of people, and publish what it leads to."""
        publisher = (info.get("publisher_gid") or {}).get("data", b"")
        frame = self.source.take(self.kind, message, bytes(publisher).hex(), time.monotonic())
        if frame is not None:
            self.forecast(frame, self.stitcher)

    def _advertise(self, topic: str, kind: str) -> Any:
        return self.node.create_publisher(message_type(kind), topic, 10) if has(kind) else None

    def _is_heard(self, publisher: Any) -> bool:
        return publisher.get_subscription_count() > 0

    def _send(self, publisher: Any, message: Any) -> None:
        publisher.publish(message)

    def _new(self, kind: str) -> Any:
        return _new(kind)

    def _happened(self, done: Forecast, period: float, frame_id: str) -> Any:
        assert done.future is not None
        seen = np.isfinite(done.future).all(axis=(1, 2))
        path = np.concatenate([done.observed[:, -1:], done.future], axis=1)[seen]
        return _poses(path, done.stamp, frame_id)

    def _look(self) -> None:
        self.status.look()
        if self._diagnostics is not None:
            now, name = time.time(), self.node.get_fully_qualified_name()
            self._diagnostics.publish(diagnostics_message(_new, self.status, name, now))


def _path(new: Any, forecast: Forecast, model: str, period: float, frame_id: str) -> Any:
    return _poses(central_path(forecast, model), forecast.stamp, frame_id)


def _poses(path: np.ndarray, stamp: float, frame_id: str) -> Any:
    """Person by person, every step of [N, 1 + T, 2] after the first, facing the way of walking."""
    array = _new(POSES)
    put_stamp(array.header, stamp, frame_id)
    heading = np.diff(path, axis=1)
    half = 0.5 * np.arctan2(heading[..., 1], heading[..., 0])
    for xy, angle in zip(path[:, 1:].reshape(-1, 2).tolist(), half.ravel().tolist()):
        pose = _new("geometry_msgs/msg/Pose")
        pose.position.x, pose.position.y = xy
        pose.orientation.z, pose.orientation.w = float(np.sin(angle)), float(np.cos(angle))
        array.poses.append(pose)
    return array


def _new(kind: str) -> Any:
    return message_type(kind)()


def has(kind: str) -> bool:
    """Whether this ROS 2 has the package of a message."""
    try:
        return bool(message_type(kind))
    except InputError:
        return False


def message_type(kind: str) -> Any:
    """The class of a message, by its type.

    Raises:
        InputError: where its package is missing.
    """
    package, _, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise InputError(f"this ROS 2 has no {package}") from None
