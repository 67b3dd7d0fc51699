"""Arguments of roslaunch, rosrun and `ros2 run`, turned into options of our own.

Each option is also a parameter: `samples: 4` is `--samples 4`, a list is several values, and
`links: {max_gap: 3}` is `--links.max-gap 3`. An option on the command line overrides a parameter.
"""

import os
import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from neurosym_jax.errors import InputError

__all__ = ["ros1_arguments", "ros2_arguments"]

# Environment variables with the meaning of ROS 1's special arguments.
VARIABLES = {"__ns": "ROS_NAMESPACE", "__ip": "ROS_IP", "__hostname": "ROS_HOSTNAME"}
# Options with the meaning of special arguments; others, such as `__log`, are ignored.
OPTIONS = {"__name": "--name", "__master": "--master"}


def ros1_arguments(arguments: Sequence[str]) -> list[str]:
    """`a:=b` as `--remap a:=b`, `_parameter:=value` and the master's parameters as options.

    Raises:
        InputError: if a node that roslaunch started cannot get its parameters from the master.
    """
    import yaml

    special: dict[str, str] = {}
    private: dict[str, Any] = {}
    remaps, rest = [], []
    for argument in arguments:
        name, assigned, value = argument.partition(":=")
        if not assigned or name.startswith("-"):
            rest.append(argument)
        elif name.startswith("__"):
            special[name] = value
        elif name.startswith("_"):
            private[name[1:]] = yaml.safe_load(value)
        else:
            remaps.append(argument)
    if "-h" in rest or "--help" in rest:
        return rest
    for name in VARIABLES.keys() & special.keys():
        os.environ[VARIABLES[name]] = special[name]
    ours = [f"{OPTIONS[name]}={special[name]}" for name in OPTIONS.keys() & special.keys()]
    asked = _parameters_of_master([*rest, *ours], must="__name" in special)
    mapped = ["--remap", *remaps] if remaps else []
    return [*_options({**asked, **private}), *rest, *ours, *mapped]


def ros2_arguments(arguments: Sequence[str]) -> list[str]:
    """The part between `--ros-args` and `--` as one option, and its parameters as options."""
    rest, told = list(arguments), []
    while "--ros-args" in rest:
        begin = rest.index("--ros-args")
        end = rest.index("--", begin) if "--" in rest[begin:] else len(rest)
        told += rest[begin + 1 : end]
        del rest[begin : end + 1]
    if not told:
        return rest
    from neurosym_robot.ros.ros2 import node_parameters

    return [
        *_options(node_parameters(told, _named(rest))),
        *rest,
        f"--ros-args={shlex.join(told)}",
    ]


def _named(
    arguments: Sequence[str], option: str = "--name", otherwise: str = "neurosym_jax"
) -> str:
    """The value of an option before options are read."""
    for place, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == option:
            otherwise = value if equals else " ".join(arguments[place + 1 : place + 2])
    return otherwise


def _parameters_of_master(arguments: Sequence[str], must: bool) -> dict[str, Any]:
    """The node's private parameters; none if no master answers, unless it `must`."""
    from neurosym_robot.ros.tcpros import node_name
    from neurosym_robot.ros.tcpros.names import master_uri
    from neurosym_robot.ros.tcpros.xmlrpc import CallError, Refused, call

    node, master = node_name(_named(arguments)), master_uri(_named(arguments, "--master", ""))
    try:
        found = call(master, "getParam", node, node)
    except Refused:
        return {}  # It has none.
    except CallError as error:
        if must:
            raise InputError(f"the master at {master} tells no parameters: {error}") from None
        return {}
    return found if isinstance(found, dict) else {}


def _options(parameters: Mapping[str, Any], within: str = "") -> Iterator[str]:
    for key, value in parameters.items():
        option = within + key.replace("_", "-")
        if isinstance(value, Mapping):
            yield from _options(value, f"{option}.")
        elif isinstance(value, bool):
            yield f"--{option}" if value else f"--no-{option}"
        elif isinstance(value, str | int | float):
            yield f"--{option}={value}"
        elif value:  # A list; an empty one is an option that is not given.
            yield from (f"--{option}", *map(str, value))
