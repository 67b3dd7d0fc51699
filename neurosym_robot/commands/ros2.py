"""Forecast in a ROS 2 graph."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer and is absent where the linters run.

import dataclasses
import shlex
from typing import Literal

from neurosym_robot.commands._live_options import NodeOptions
from neurosym_robot.commands._ros_arguments import ros2_arguments
from neurosym_robot.ros.definitions import PEOPLE_TOPICS
from neurosym_robot.ros.people import KINDS
from neurosym_robot.ros.ros2 import ForecastNode, import_rclpy, message_type

__all__ = ["PREPARE", "Options", "run"]

PREPARE = ros2_arguments
Message = Literal["People", "Humans", "TrackedPersons", "Agents", "Detection3DArray", "PoseArray"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(NodeOptions):
    """Forecast the people of a ROS 2 graph until interrupted."""

    topic: str = PEOPLE_TOPICS[0]
    """Topic of the people."""
    message: Message = "People"
    """Type of their messages."""
    ros_args: str = ""
    """What stands between --ros-args and -- on the command line of a launch file."""


def run(options: Options) -> None:
    """Forecast until interrupted; InputError names what cannot be used or is missing."""
    rclpy = import_rclpy()
    kind = next(kind for kind in KINDS if kind.endswith(f"/{options.message}"))
    message_type(kind)  # Refused before the models are loaded.
    predictor = options.predictor()
    rclpy.init(args=["--ros-args", *shlex.split(options.ros_args)])
    logger = rclpy.logging.get_logger(options.name)
    node = ForecastNode(
        predictor, topic=options.topic, kind=kind, **options.node_options(logger.warning)
    )
    report = node.node.get_logger().info
    report(f"listening to {node.topic}")
    try:
        options.forecast(node, report)
    finally:
        node.node.destroy_node()
        rclpy.try_shutdown()
