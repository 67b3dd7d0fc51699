"""A predictor in a ROS 2 graph, with rclpy.

People or poses in, poses and markers out. rclpy is imported when the node is made: this file is the
only one that needs it, and the predictor knows nothing of it.
"""

# pyright: reportMissingImports=false
# ROS 2 has its own installer; where the linters run there is none.

from typing import Any, Literal

import numpy as np

from neurosym_jax.dashboard import Dashboard
from neurosym_jax.errors import InputError
from neurosym_jax.online.analytics import Analytics
from neurosym_jax.online.frame import Frame
from neurosym_jax.online.predictor import Forecast, Predictor
from neurosym_jax.online.replay import advance
from neurosym_jax.ros.messages import (
    PEOPLE_TOPICS,
    WAITING,
    forecast_topic,
    frame_of_people,
    seconds_of,
)
from neurosym_jax.tracking.live import OnlineStitcher
from neurosym_jax.tracking.nearest import NearestIds

__all__ = ["ForecastNode", "message_types"]

COLOURS = ((0, 114, 178), (213, 94, 0), (0, 158, 115), (204, 121, 167), (230, 159, 0))
"""Of the people's lines, after Okabe and Ito."""


class ForecastNode:
    """A predictor in a ROS 2 graph; rclpy must have been initialised."""

    def __init__(
        self,
        predictor: Predictor,
        *,
        topic: str = PEOPLE_TOPICS[0],
        message: Literal["People", "PoseArray"] = "People",
        stitcher: OnlineStitcher | None = None,
        name: str = "neurosym_jax",
    ):
        """Join the graph.

        Args:
            predictor: of one or several models, each with topics of its own.
            topic: of the people.
            message: their type.
            stitcher: mends ids, if given.
            name: of the node.

        Raises:
            InputError: where ROS 2 has no such message.
        """
        import rclpy
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        self.types = message_types(message)
        self.predictor, self.stitcher = predictor, stitcher
        self.analytics = Analytics.of(predictor)
        self.dashboard: Dashboard | None = None
        """Shown every frame, where there is one."""
        self._nearest = NearestIds()
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
        kind = self.types[message]
        self.node.create_subscription(kind, topic, self.hear, quality)

    def hear(self, message: Any) -> None:
        """Take in a message of people, and publish what it leads to."""
        event = advance(self._frame(message), self.predictor, self.analytics, self.stitcher)
        if event.forecast is not None:
            for name in event.forecast.models:
                header = self._header(event.forecast.stamp, message.header.frame_id)
                self._poses[name].publish(self._pose_array(event.forecast, name, header))
                self._markers[name].publish(self._marker_array(event.forecast, name, header))
        if self.dashboard is not None:
            self.dashboard.show(event.frame, event.forecast, self.analytics.summary())

    def _frame(self, message: Any) -> Frame:
        if hasattr(message, "people"):
            return frame_of_people(message)
        stamp = seconds_of(message.header.stamp)
        xy = [(pose.position.x, pose.position.y) for pose in message.poses]
        points = np.array(xy, np.float64).reshape(-1, 2)
        return Frame(stamp, self._nearest.push(stamp, points), points)

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


def message_types(message: str) -> dict[str, Any]:
    """The classes of messages by name.

    Raises:
        InputError: where one of their packages is missing.
    """
    try:
        from geometry_msgs.msg import Point, Pose, PoseArray
        from std_msgs.msg import Header
        from visualization_msgs.msg import Marker, MarkerArray

        types = {each.__name__: each for each in (Header, Marker, MarkerArray, Point, Pose)}
        types["PoseArray"] = PoseArray
        if message == "People":
            from people_msgs.msg import People

            types["People"] = People
    except ImportError as error:
        raise InputError(f"this ROS 2 has no {error.name}") from None
    return types
