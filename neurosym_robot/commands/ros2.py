"""Forecast in a ROS 2 graph."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer; where the linters run there is none.

import dataclasses
import shlex

from neurosym_robot.commands._live_options import LiveOptions
from neurosym_robot.commands._ros_arguments import ros2_arguments
from neurosym_robot.online.status import format_summary
from neurosym_robot.ros.messages import PEOPLE_TOPICS
from neurosym_robot.ros.people import kind_named
from neurosym_robot.ros.ros2 import ForecastNode, import_rclpy, message_type

__all__ = ["PREPARE", "Options", "run"]

PREPARE = ros2_arguments


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(LiveOptions):
    """Forecast the people of a ROS 2 graph until interrupted."""

    topic: str = PEOPLE_TOPICS[0]
    """Topic of the people."""
    message: str = "People"
    """Type of their messages: People, Humans, TrackedPersons, Agents, Detection3DArray or
    PoseArray."""
    name: str = "neurosym_jax"
    """Name of this node."""
    status: float = 10.0
    """Seconds between status lines; 0 for none."""
    ros_args: str = ""
    """What stands between --ros-args and -- on the command line of a launch file."""


def run(options: Options) -> None:
    """Forecast until interrupted.

    Raises:
        InputError: for a model that cannot be used, or where ROS 2 or a message is missing.
    """
    rclpy = import_rclpy()
    from rclpy.executors import ExternalShutdownException

    message_type(kind_named(options.message))
    kind, predictor = kind_named(options.message), options.predictor()
    rclpy.init(args=["--ros-args", *shlex.split(options.ros_args)])
    logger = rclpy.logging.get_logger(options.name)
    node = ForecastNode(
        predictor,
        topic=options.topic,
        kind=kind,
        source=options.stream.source(logger.warning),
        stitcher=options.stitcher(),
        name=options.name,
        status=options.status,
        at_least=options.view.at_least,
    )
    logger = node.node.get_logger()
    logger.info(f"listening to {node.topic}")
    try:
        node.dashboard = options.view.open(predictor, options.name)
        if node.dashboard is not None:
            logger.info(f"the page is at {node.dashboard.url}")
        rclpy.spin(node.node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if node.dashboard is not None:
            node.dashboard.close()
        node.node.destroy_node()
        rclpy.try_shutdown()
    node.analytics.finish()
    print(format_summary(node.analytics.summary(), predictor.health))
