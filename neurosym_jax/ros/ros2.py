"""A predictor in a ROS 2 graph, with rclpy.

People or poses in, poses and markers out. rclpy is imported when the node is made: this file is the
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

from neurosym_jax.dashboard import Dashboard
from neurosym_jax.errors import InputError
from neurosym_jax.online.analytics import Analytics
from neurosym_jax.online.predictor import Forecast, Predictor
from neurosym_jax.online.replay import advance
from neurosym_jax.ros.bags import TF_TOPICS
from neurosym_jax.ros.definitions import PEOPLE, TRANSFORMS
from neurosym_jax.ros.messages import PEOPLE_TOPICS, WAITING, forecast_topic
from neurosym_jax.ros.source import Source
from neurosym_jax.tracking.live import OnlineStitcher

__all__ = ["ForecastNode", "message_type", "message_types"]

OURS = (
    *("geometry_msgs/msg/Point", "geometry_msgs/msg/Pose", "geometry_msgs/msg/PoseArray"),
    *("std_msgs/msg/Header", "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray"),
)
COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
"""Of the people's lines, after Okabe and Ito."""


class ForecastNode:
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
    ):
        """Join the graph.

        Args:
            predictor: of one or several models, each with topics of its own.
            topic: of the people.
            kind: their type, a key of `people.KINDS`.
            source: which messages belong to the stream, and where they are taken to.
            stitcher: mends ids, if given.
            name: of the node.

        Raises:
            InputError: where ROS 2 has no such message.
        """
        import rclpy
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        self.types, people = message_types(), message_type(kind)
        self.kind, self.source = kind, source or Source()
        self.predictor, self.stitcher = predictor, stitcher
        self.analytics = Analytics.of(predictor)
        self.dashboard: Dashboard | None = None
        """Shown every frame, where there is one."""
        self.node = rclpy.create_node(name)
        self._poses, self._markers = (
            {
                name: self.node.create_publisher(self.types[kind], forecast_topic(name) + end, 10)
                for name in predictor.models
            }
            for kind, end in (("PoseArray", ""), ("MarkerArray", "/markers"))
        )
        # Best effort hears publishers of either kind.
        quality = QoSProfile(depth=WAITING, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.node.create_subscription(people, topic, self.hear, quality)
        if self.source.fixed_frame:
            latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            for name, quality in zip(TF_TOPICS, (QoSProfile(depth=100), latched)):
                hear = functools.partial(self.source.transforms.hear, static=name == TF_TOPICS[1])
                self.node.create_subscription(message_type(TRANSFORMS), name, hear, quality)

    def hear(self, message: Any, info: Mapping[str, Any]) -> None:
        """Take in a message of people, and publish what it leads to."""
        publisher = (info.get("publisher_gid") or {}).get("data", b"")
        frame = self.source.take(self.kind, message, bytes(publisher).hex(), time.monotonic())
        if frame is None:
            return
        event = advance(frame, self.predictor, self.analytics, self.stitcher)
        if event.forecast is not None:
            for name in event.forecast.models:
                header = self._header(event.forecast.stamp, self.source.frame_id or "")
                self._poses[name].publish(self._pose_array(event.forecast, name, header))
                self._markers[name].publish(self._marker_array(event.forecast, name, header))
        if self.dashboard is not None:
            self.dashboard.show(event.frame, event.forecast, self.analytics.summary())

    def _header(self, stamp: float, frame_id: str) -> Any:
        header = self.types["Header"](frame_id=frame_id)
        header.stamp.sec, header.stamp.nanosec = divmod(round(stamp * 1e9), 10**9)
        return header

    def _pose_array(self, forecast: Forecast, name: str, header: Any) -> Any:
        """Person by person, every step of the most central sample, facing the way of walking."""
        array = self.types["PoseArray"](header=header)
        path = _path(forecast, name)
        heading = np.diff(path, axis=1)
        half = 0.5 * np.arctan2(heading[..., 1], heading[..., 0])
        for xy, angle in zip(path[:, 1:].reshape(-1, 2).tolist(), half.ravel().tolist()):
            pose = self.types["Pose"]()
            pose.position.x, pose.position.y = xy
            pose.orientation.z, pose.orientation.w = float(np.sin(angle)), float(np.cos(angle))
            array.poses.append(pose)
        return array

    def _marker_array(self, forecast: Forecast, name: str, header: Any) -> Any:
        """A line for each person, from the last position observed; `ns` is model and id."""
        array = self.types["MarkerArray"]()
        for n, (id, path) in enumerate(zip(forecast.ids.tolist(), _path(forecast, name).tolist())):
            marker = self.types["Marker"](header=header, ns=f"{name}/{id}")
            marker.type, marker.scale.x = marker.LINE_STRIP, 0.05
            marker.pose.orientation.w, marker.color.a = 1.0, 1.0
            red, green, blue = COLOURS[n % len(COLOURS)]
            marker.color.r, marker.color.g, marker.color.b = red / 255, green / 255, blue / 255
            # It disappears by itself when nobody is forecast any more.
            lifetime = round(2e9 * self.predictor.window.period)
            marker.lifetime.sec, marker.lifetime.nanosec = divmod(lifetime, 10**9)
            marker.points = [self.types["Point"](x=x, y=y) for x, y in path]
            array.markers.append(marker)
        return array


def _path(forecast: Forecast, name: str) -> np.ndarray:
    """[N, 1 + pred_len, 2] metres: the last position observed, and the most central sample."""
    result = forecast.models[name]
    return np.concatenate([forecast.observed[:, -1:], result.samples[result.central]], axis=1)


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


def message_types() -> dict[str, Any]:
    """The classes that forecasts are made of, by name.

    Raises:
        InputError: where one of their packages is missing.
    """
    return {kind.split("/")[2]: message_type(kind) for kind in OURS}
