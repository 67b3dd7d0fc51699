"""Names in a ROS graph: topics with their types, and under which address others reach us."""

import dataclasses
import os
import re
import socket
from urllib.parse import urlsplit

from neurosym_jax.errors import InputError

__all__ = ["Topic", "global_name", "local_host", "master_uri"]


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic and the type of its messages."""

    name: str
    """Global: it begins with a slash."""
    type: str = "*"
    """"package/Name"; a subscriber takes "*" for any."""
    md5: str = "*"
    """Of the type's definition, as ROS computes it; a subscriber takes "*" for any."""
    definition: str = ""
    """Text of the definition and of those that it uses; recorders ask for it."""


def global_name(name: str) -> str:
    """`name` with a slash in front.

    Raises:
        InputError: if it is not a ROS name.
    """
    if not re.fullmatch(r"/?[A-Za-z]\w*(/[A-Za-z]\w*)*", name, re.ASCII):
        raise InputError(f"not a ROS name: {name!r}")
    return "/" + name.removeprefix("/")


def master_uri(given: str | None = None) -> str:
    """`given`, else `$ROS_MASTER_URI`, else the usual one on this computer.

    Raises:
        InputError: if it is not http://HOST:PORT.
    """
    uri = given or os.environ.get("ROS_MASTER_URI") or "http://localhost:11311"
    try:
        parts = urlsplit(uri)
        fine = parts.scheme == "http" and parts.hostname and parts.port
    except ValueError:
        fine = False
    if not fine:
        raise InputError(f"not a ROS master's URI (http://HOST:PORT): {uri!r}")
    return uri


def local_host(master: str) -> str:
    """What others are told: `$ROS_HOSTNAME`, `$ROS_IP`, else the address that faces `master`.

    With the master on this computer that would be the loopback, which other computers cannot
    reach; then it is the computer's name, as with rospy.
    """
    named = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP")
    if named:
        return named
    parts = urlsplit(master)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((parts.hostname, parts.port))  # Sends nothing.
            address = probe.getsockname()[0]
        if not address.startswith("127."):
            return address
        socket.gethostbyname(socket.gethostname())
    except OSError:
        return "localhost"
    return socket.gethostname()
