"""Forecast in a ROS 1 graph."""

import dataclasses
import functools
import sys

from neurosym_robot.commands._live_options import NodeOptions
from neurosym_robot.commands._ros_arguments import ros1_arguments
from neurosym_robot.ros.ros1 import ForecastNode

__all__ = ["PREPARE", "Options", "run"]

PREPARE = ros1_arguments


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(NodeOptions):
    """Forecast the people of a ROS 1 graph until interrupted; needs no ROS here.

    With --stitch the people are published with their mended ids on
    /people_tracker/people_filtered.
    """

    topic: str | None = None
    """Topic of the people, of any message type that `ros2 --message` lists; by default
    /people_tracker/people_filtered or, with --stitch, /people_tracker/people."""
    master: str | None = None
    """URI of the master; by default $ROS_MASTER_URI, else http://localhost:11311."""
    remap: tuple[str, ...] = ()
    """FROM:=TO, a name in the graph instead of one of ours; as roslaunch's <remap>."""


def run(options: Options) -> None:
    """Forecast until the node is stopped; InputError names what cannot be used."""
    report = functools.partial(print, file=sys.stderr, flush=True)
    node = ForecastNode(
        options.predictor(),
        topic=options.topic,
        master=options.master,
        remaps=options.remap,
        report=report,
        **options.node_options(report),
    )
    try:
        options.forecast(node, report)
    finally:
        node.close()
