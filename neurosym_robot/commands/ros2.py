"""Forecast in a ROS 2 graph."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer and is absent where the linters run.

import dataclasses
import shlex
from collections.abc import Sequence
from typing import Literal

from neurosym_robot.commands._live_options import (
    NAME,
    NodeOptions,
    as_options,
    value_of,
)
from neurosym_robot.input.kinds import KINDS
from neurosym_robot.ros.definitions import PEOPLE_TOPICS
from neurosym_robot.ros.ros2 import (
    ForecastNode,
    import_rclpy,
    message_type,
    node_parameters,
)

Message = Literal[
    "People", "Humans", "TrackedPersons", "Agents", "Detection3DArray", "PoseArray"
]


def prepare_arguments(arguments: Sequence[str]) -> list[str]:
    """The part between `--ros-args` and `--` as one option, and its parameters as options."""
    rest, ros_arguments = list(arguments), []
    while "--ros-args" in rest:
        begin = rest.index("--ros-args")
        end = rest.index("--", begin) if "--" in rest[begin:] else len(rest)
        ros_arguments += rest[begin + 1 : end]
        del rest[begin : end + 1]
    parameters = (
        node_parameters(ros_arguments, value_of(rest, "--name", NAME))
        if ros_arguments
        else {}
    )
    return [
        *as_options(parameters),
        *rest,
        *([f"--ros-args={shlex.join(ros_arguments)}"] if ros_arguments else []),
    ]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Options(NodeOptions):
    """Forecast the people of a ROS 2 graph until interrupted."""

    topic: str = PEOPLE_TOPICS[0]
    """Topic of the people."""
    message: Message = "People"
    """Type of their messages."""
    autostart: bool = True
    """Activate the node at once; without it, a lifecycle manager does."""
    ros_args: str = ""
    """What stands between --ros-args and -- on the command line of a launch file."""


def run(options: Options) -> None:
    """Forecast until interrupted; InputError names what cannot be used or is missing."""
    rclpy = import_rclpy()
    kind = next(kind for kind in KINDS if kind.endswith(f"/{options.message}"))
    message_type(kind)  # Refused before the models are loaded.
    predictor = options.predictor(options.max_gap)
    rclpy.init(args=["--ros-args", *shlex.split(options.ros_args)])
    warn = rclpy.logging.get_logger(options.name).warning
    node = ForecastNode(
        predictor,
        topic=options.topic,
        kind=kind,
        autostart=options.autostart,
        **options.node_options(warn),
    )
    options.forecast(node)
