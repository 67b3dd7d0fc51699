"""Names in a ROS graph, and the address under which other nodes reach us."""

import dataclasses
import os
import re
import socket
from collections.abc import Callable, Iterable
from urllib.parse import urlsplit

from neurosym_jax.errors import InputError

__all__ = ["Topic", "global_name", "local_host", "master_uri", "names_of", "node_name"]


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic and the type of its messages; a subscriber takes "*" for any type."""

    name: str  # global: it begins with a slash
    type: str = "*"  # "package/Name"
    md5: str = "*"  # of the type's definition, as ROS computes it
    definition: str = ""  # text of the definition and of those that it uses, for recorders

    def header(self, caller: str, **more: str) -> dict[str, str]:
        """Fields of the header that begins a connection of the node `caller`."""
        fields = {"callerid": caller, "topic": self.name, "type": self.type, "md5sum": self.md5}
        return {**fields, "message_definition": self.definition, **more}


def global_name(name: str, namespace: str = "/") -> str:
    """`name` in `namespace`, unless it begins with a slash; InputError if it is no ROS name."""
    if not re.fullmatch(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", name, re.ASCII):
        raise InputError(f"not a ROS name: {name!r}")
    return re.sub("/+", "/", name if name.startswith("/") else f"/{namespace}/{name}")


def node_name(name: str) -> str:
    """The global name of a node, in `$ROS_NAMESPACE` if that is set."""
    return global_name(name, os.environ.get("ROS_NAMESPACE", ""))


def names_of(node: str, remaps: Iterable[str] = ()) -> Callable[[str], str]:
    """What gives a node's names their global ones, see https://wiki.ros.org/Names.

    Raises:
        InputError: for a remapping that is not "FROM:=TO".
    """
    namespace, new = node.rpartition("/")[0], {}
    for text in remaps:
        name, assigned, other = text.partition(":=")
        if not assigned:
            raise InputError(f"a remapping is FROM:=TO, not {text!r}")
        new[global_name(name, namespace)] = global_name(other, namespace)

    def name_of(name: str) -> str:
        found = global_name(name, namespace)
        return new.get(found, found)

    return name_of


def master_uri(given: str | None = None) -> str:
    """`given`, else `$ROS_MASTER_URI`, else the default; InputError unless http://HOST:PORT."""
    uri = given or os.environ.get("ROS_MASTER_URI") or "http://localhost:11311"
    if not re.fullmatch(r"http://([^\s/:]+|\[[0-9a-fA-F:]+\]):[0-9]{1,5}/?", uri):
        raise InputError(f"not a ROS master's URI (http://HOST:PORT): {uri!r}")
    return uri


def local_host(master: str) -> str:
    """Our host name: `$ROS_HOSTNAME`, `$ROS_IP`, else the address that faces `master`.

    With the master on this computer it is the computer's name, as with rospy, because other
    computers cannot reach the loopback address.
    """
    if named := os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP"):
        return named
    parts = urlsplit(master)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((parts.hostname, parts.port))  # Sends nothing.
            address = probe.getsockname()[0]
        if not address.startswith("127."):
            return address
        socket.gethostbyname(socket.gethostname())
    except (OSError, ValueError):
        return "localhost"
    return socket.gethostname()
