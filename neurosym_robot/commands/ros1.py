"""Forecast in a ROS 1 graph."""

import dataclasses
from collections.abc import Sequence

from neurosym_jax.errors import InputError
from neurosym_robot.commands._live_options import (
    NAME,
    NodeOptions,
    as_options,
    say,
    value_of,
)
from neurosym_robot.ros.ros1 import ForecastNode
from neurosym_robot.ros.tcpros import CallError, Refused, call, master_uri, node_name


def prepare_arguments(arguments: Sequence[str]) -> list[str]:
    """`a:=b` as `--remap a:=b`, `__name:=` as `--name`, and the master's parameters as options.

    Raises:
        InputError: if a node that roslaunch started cannot get its parameters from the
            master.
    """
    if {"-h", "--help", "--help-all"} & set(arguments):
        return list(arguments)
    assigned = [text for text in arguments if ":=" in text and not text.startswith("-")]
    names = [
        text.removeprefix("__name:=")
        for text in assigned
        if text.startswith("__name:=")
    ]
    rest = [text for text in arguments if text not in assigned]
    rest += [f"--name={name}" for name in names]
    # Others that begin so, such as `__log`, are for other clients.
    remaps = [text for text in assigned if not text.startswith("_")]
    node = node_name(value_of(rest, "--name", NAME))
    master, parameters = master_uri(value_of(rest, "--master", "")), {}
    try:
        parameters = call(master, "getParam", node, node)
    except CallError as error:
        # An answer that refuses says that the node has no parameters.
        if names and not isinstance(error, Refused):
            raise InputError(
                f"the master at {master} tells no parameters: {error}"
            ) from None
    return [*as_options(parameters), *rest, *(["--remap", *remaps] if remaps else [])]


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
    node = ForecastNode(
        options.predictor(options.max_gap),
        topic=options.topic,
        master=options.master,
        remaps=options.remap,
        report=say,
        **options.node_options(say),
    )
    options.forecast(node)
