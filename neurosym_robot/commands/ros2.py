"""Forecast in a ROS 2 graph."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer and is absent where the linters run.

import contextlib
import dataclasses
import shlex
from collections.abc import Sequence

from neurosym_jax.errors import InputError
from neurosym_robot.commands._live_options import (
    NAME,
    NodeOptions,
    as_options,
    value_of,
)
from neurosym_robot.input.kinds import KINDS, full_type, kinds_of
from neurosym_robot.ros.definitions import PEOPLE_TOPICS
from neurosym_robot.ros.ros2 import (
    ForecastNode,
    import_rclpy,
    message_type,
    node_parameters,
)


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
    message: str = "People"
    """Type of their messages: one of docs/robot.md, as NAME or PACKAGE/NAME; with --people any, as
    PACKAGE/NAME."""
    autostart: bool = True
    """Activate the node at once; without it, a lifecycle manager does."""
    ros_args: str = ""
    """What stands between --ros-args and -- on the command line of a launch file."""


def kind_named(name: str, is_free: bool) -> str:
    """The type that `--message` names; any type if `is_free`, as --people says how it is read.

    Of several that are named alike, the first whose package is installed.

    Raises:
        InputError: with the names of the types that are known.
    """
    if is_free and "/" in name:
        return full_type(name)
    kinds = kinds_of(name)
    if not kinds:
        known = ", ".join(kind.replace("/msg/", "/") for kind in KINDS)
        raise InputError(
            f"--message {name}: none of {known}; of another type, as PACKAGE/NAME, "
            "--people, --position and --id say where it holds people"
        )
    for kind in kinds:
        with contextlib.suppress(InputError):
            message_type(kind)
            return kind
    return kinds[0]


def run(options: Options) -> None:
    """Forecast until interrupted; InputError names what cannot be used or is missing."""
    rclpy = import_rclpy()
    kind = kind_named(options.message, bool(options.people))
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
