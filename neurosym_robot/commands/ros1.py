"""Forecast in a ROS 1 graph."""

import dataclasses
import functools
import signal
import sys

from neurosym_robot.commands._live_options import LiveOptions
from neurosym_robot.commands._ros_arguments import ros1_arguments
from neurosym_robot.online.status import format_summary
from neurosym_robot.ros.ros1 import ForecastNode

__all__ = ["PREPARE", "Options", "run"]

PREPARE = ros1_arguments


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(LiveOptions):
    """Forecast the people of a ROS 1 graph until interrupted; needs no ROS here.

    With --stitch the people are published with their mended ids on
    /people_tracker/people_filtered.
    """

    topic: str | None = None
    """Topic of the people, of any message type that `ros2 --message` lists; by default
    /people_tracker/people_filtered or, with --stitch, /people_tracker/people."""
    master: str | None = None
    """URI of the master; by default $ROS_MASTER_URI, else http://localhost:11311."""
    name: str = "neurosym_jax"
    """Name of this node, in $ROS_NAMESPACE if that is set."""
    remap: tuple[str, ...] = ()
    """FROM:=TO, a name in the graph instead of one of ours; as roslaunch's <remap>."""
    status: float = 10.0
    """Seconds between status lines; 0 for none."""


def run(options: Options) -> None:
    """Forecast until the node is stopped.

    Raises:
        InputError: for a model, topic, name or URI that cannot be used.
    """
    report = functools.partial(print, file=sys.stderr, flush=True)
    node = ForecastNode(
        options.predictor(),
        topic=options.topic,
        source=options.stream.source(report),
        stitcher=options.stitcher(),
        master=options.master,
        name=options.name,
        remaps=options.remap,
        status=options.status,
        at_least=options.view.at_least,
        report=report,
    )
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: node.node.stopped.set())
        node.dashboard = options.view.open(node.predictor, node.node.name)
        if node.dashboard is not None:
            report(f"{node.node.name}: the page is at {node.dashboard.url}")
        node.run()
    finally:
        node.close()
    node.analytics.finish()
    print(format_summary(node.analytics.summary(), node.predictor.health))
