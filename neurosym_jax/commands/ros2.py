"""Forecast in a ROS 2 graph."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer; where the linters run there is none.

import dataclasses
import functools
import sys

from neurosym_jax.commands._live_options import LiveOptions
from neurosym_jax.errors import InputError
from neurosym_jax.online.summary import format_summary
from neurosym_jax.ros.messages import PEOPLE_TOPICS
from neurosym_jax.ros.people import kind_named
from neurosym_jax.ros.ros2 import ForecastNode, message_type

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(LiveOptions):
    """Forecast the people of a ROS 2 graph until interrupted."""

    topic: str = PEOPLE_TOPICS[0]
    """Of the people."""
    message: str = "People"
    """Their type: People, Humans, TrackedPersons, Agents, Detection3DArray or PoseArray."""
    name: str = "neurosym_jax"
    """Of this node."""


def run(options: Options) -> None:
    """Forecast until interrupted.

    Raises:
        InputError: for a model that cannot be used, or where ROS 2 or a message is missing.
    """
    try:
        import rclpy
        from rclpy.executors import ExternalShutdownException
    except ImportError:
        raise InputError(
            "this needs rclpy in the same Python: set up a ROS 2 (Jazzy or later) first"
        ) from None
    message_type(kind_named(options.message))
    report = functools.partial(print, f"{options.name}:", file=sys.stderr, flush=True)
    predictor = options.predictor()
    rclpy.init(args=[])
    node = ForecastNode(
        predictor,
        topic=options.topic,
        kind=kind_named(options.message),
        source=options.stream.source(report),
        stitcher=options.stitcher(),
        name=options.name,
    )
    report(f"listening to {options.topic}")
    try:
        node.dashboard = options.view.open(predictor, options.name)
        if node.dashboard is not None:
            report(f"the page is at {node.dashboard.url}")
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
