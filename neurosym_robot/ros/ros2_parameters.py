"""The parameters that a launch file gives a node of ROS 2, as rclpy finds them."""

# pyright: reportMissingImports=false
# ROS 2 has its own installer; where the linters run there is none.

from collections.abc import Sequence
from typing import Any

from neurosym_jax.errors import InputError

__all__ = ["node_parameters"]

EVERYBODYS = ("use_sim_time", "start_type_description_service", "qos_overrides")
"""Parameters that every node has."""


def node_parameters(arguments: Sequence[str], name: str) -> dict[str, Any]:
    """The parameters by name, of files with their wildcards and of `-p`.

    Args:
        arguments: what stands after `--ros-args`.
        name: of the node, where the arguments name none.

    Raises:
        InputError: for arguments that ROS 2 refuses, or where it is missing.
    """
    try:
        import rclpy
        from rclpy.context import Context
    except ImportError:
        raise InputError(
            "this needs rclpy in the same Python: set up a ROS 2 (Jazzy or later) first"
        ) from None
    context = Context()
    try:
        rclpy.init(args=["--ros-args", *arguments], context=context)
        node = rclpy.create_node(
            name, context=context, automatically_declare_parameters_from_overrides=True
        )
        found = {key: value.value for key, value in node.get_parameters_by_prefix("").items()}
        node.destroy_node()
    except Exception as error:  # rclpy raises what its C library says, of several kinds.
        raise InputError(f"--ros-args: {' '.join(str(error).split())}") from None
    finally:
        rclpy.try_shutdown(context=context)
    return {key: value for key, value in found.items() if key.split(".")[0] not in EVERYBODYS}
