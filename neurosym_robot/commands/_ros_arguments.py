"""Arguments of roslaunch, rosrun and `ros2 run`, turned into options of our own.

Each option is also a parameter: `samples: 4` is `--samples 4`, a list is several values, and
`links: {max_gap: 3}` is `--links.max-gap 3`. An option on the command line overrides a parameter.
"""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from neurosym_jax.errors import InputError

__all__ = ["ros1_arguments", "ros2_arguments"]


def ros1_arguments(arguments: Sequence[str]) -> list[str]:
    """`a:=b` as `--remap a:=b`, `__name:=` as `--name`, and the master's parameters as options.

    Raises:
        InputError: if a node that roslaunch started cannot get its parameters from the master.
    """
    if {"-h", "--help", "--help-all"} & set(arguments):
        return list(arguments)
    launched, remaps, rest = False, [], []
    for argument in arguments:
        name, assigned, value = argument.partition(":=")
        if not assigned or name.startswith("-"):
            rest.append(argument)
        elif name == "__name":
            launched = True
            rest.append(f"--name={value}")
        elif not name.startswith("_"):  # Others, such as `__log`, are for other clients.
            remaps.append(argument)
    from neurosym_robot.ros.tcpros import node_name
    from neurosym_robot.ros.tcpros.names import master_uri
    from neurosym_robot.ros.tcpros.xmlrpc import CallError, Refused, call

    node, master = node_name(_value(rest, "--name")), master_uri(_value(rest, "--master", ""))
    try:
        found = call(master, "getParam", node, node)
    except Refused:
        found = {}  # It has no parameters.
    except CallError as error:
        if launched:
            raise InputError(f"the master at {master} tells no parameters: {error}") from None
        found = {}
    return [*_options(found), *rest, *(["--remap", *remaps] if remaps else [])]


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

    options = _options(node_parameters(told, _value(rest, "--name")))
    return [*options, *rest, f"--ros-args={shlex.join(told)}"]


def _value(arguments: Sequence[str], option: str, otherwise: str = "neurosym_jax") -> str:
    """The value of an option before options are read."""
    for place, argument in enumerate(arguments):
        name, equals, value = argument.partition("=")
        if name == option:
            otherwise = value if equals else " ".join(arguments[place + 1 : place + 2])
    return otherwise


def _options(parameters: Any, within: str = "") -> Iterator[str]:
    for key, value in parameters.items() if isinstance(parameters, Mapping) else ():
        option = within + key.replace("_", "-")
        if isinstance(value, Mapping):
            yield from _options(value, f"{option}.")
        elif isinstance(value, bool):
            yield f"--{option}" if value else f"--no-{option}"
        elif isinstance(value, str | int | float):
            yield f"--{option}={value}"
        elif value:  # A list; an empty one is an option that is not given.
            yield from (f"--{option}", *map(str, value))
