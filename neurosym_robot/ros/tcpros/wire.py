"""What goes over the wire: the blocks of a TCPROS connection, and the XML-RPC of ROS.

A block has its length in front, and the first is a header
(https://wiki.ros.org/ROS/TCPROS, https://wiki.ros.org/ROS/Connection%20Header). Masters
and nodes call each other as https://wiki.ros.org/ROS/Master_API and
https://wiki.ros.org/ROS/Slave_API say: each answer is `[code, message, value]`, and
code 1 means success. What the other side sends is bounded.
"""

import contextlib
import dataclasses
import http.client
import socket
import struct
import xmlrpc.client
from collections.abc import Callable, Mapping
from typing import Any
from urllib.parse import urlsplit
from xml.parsers.expat import ExpatError
from xmlrpc.server import SimpleXMLRPCDispatcher, SimpleXMLRPCRequestHandler

from neurosym_robot.server import BoundedServer, deadline

# bytes; a header carries the message's definition, a few kilobytes at most
MAX_HEADER = 1 << 20
MAX_MESSAGE = 4 << 20  # bytes; ten thousand people are about 1 MB
MAX_BODY = 4 << 20  # bytes; the state of a graph of thousands of topics stays below
TIMEOUT = 5.0  # seconds of a call
HANDSHAKE = 5.0  # seconds for each step until messages come

# What Python's parsers raise at an answer that is none.
NONSENSE = (
    *(
        http.client.HTTPException,
        xmlrpc.client.Error,
        ExpatError,
        ValueError,
        TypeError,
    ),
    *(LookupError, AttributeError, ArithmeticError),
)


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic and the type of its messages; a subscriber takes "*" for any type."""

    name: str  # global: it begins with a slash
    type: str = "*"  # "package/Name"
    md5: str = "*"  # of the type's definition, as ROS computes it
    # text of the definition and of those that it uses, for recorders
    definition: str = ""

    def header(self, caller: str, **fields: str) -> dict[str, str]:
        """Fields of the header that begins a connection of the node `caller`."""
        return {
            "callerid": caller,
            "topic": self.name,
            "type": self.type,
            "md5sum": self.md5,
            "message_definition": self.definition,
            **fields,
        }


class ProtocolError(ConnectionError):
    """The other side does not speak TCPROS, or refuses."""


def encode_block(data: bytes) -> bytes:
    """`data` with its length in front."""
    return struct.pack("<I", len(data)) + data


def encode_header(fields: Mapping[str, str]) -> bytes:
    """A header as the block that begins a connection."""
    return encode_block(
        b"".join(
            encode_block(f"{key}={value}".encode()) for key, value in fields.items()
        )
    )


def shake_hands(
    connection: socket.socket, fields: Mapping[str, str] | None = None
) -> dict:
    """Send a header if there is one, and return that of the other side.

    The connection sends at once, and notices within half a minute when the other
    computer is gone.
    """
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, name):  # Not every system lets them be set.
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
    with deadline(connection, HANDSHAKE):
        connection.sendall(encode_header(fields) if fields else b"")
        return read_header(connection)


def read_header(connection: socket.socket) -> dict[str, str]:
    """The fields of the header that begins a connection; ProtocolError if malformed."""
    data, fields, at = read_block(connection, MAX_HEADER), {}, 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "little")
        row, at = data[at + 4 : at + 4 + length], at + 4 + length
        key, equals, value = row.partition(b"=")
        if at > len(data) or not equals:
            raise ProtocolError("malformed header: a field is cut off or has no '='")
        fields[key.decode(errors="replace")] = value.decode(errors="replace")
    return fields


def read_block(connection: socket.socket, limit: int = MAX_MESSAGE) -> bytes:
    """The next block, without its length; ProtocolError if longer than `limit` bytes."""
    length = int.from_bytes(_read(connection, 4), "little")
    if length > limit:
        raise ProtocolError(
            f"a block of {length} bytes was announced, more than {limit}"
        )
    return bytes(_read(connection, length))


def _read(connection: socket.socket, length: int) -> bytearray:
    data = bytearray()
    while len(data) < length:
        # Memory grows with what arrives, not with what was announced.
        part = connection.recv(min(length - len(data), 1 << 16))
        if not part:
            raise ConnectionError("closed by the other side")
        data += part
    return data


class CallError(ConnectionError):
    """A call did not get through, or its answer is malformed."""


class Refused(CallError):
    """The call got through, and the answer was no."""


def call(uri: str, method: str, *arguments: Any, timeout: float = TIMEOUT) -> Any:
    """The answer of `method` of the node or master at `uri`.

    Raises:
        Refused: with the message, if the code is not 1.
        CallError: for no valid answer within `timeout` seconds.
    """
    said = xmlrpc.client.dumps(arguments, method).encode()
    try:
        at = urlsplit(uri)
        connection = http.client.HTTPConnection(
            at.hostname or "", at.port, timeout=timeout
        )
        with contextlib.closing(connection):
            connection.request(
                "POST", at.path or "/", said, {"Content-Type": "text/xml"}
            )
            body = connection.getresponse().read(MAX_BODY + 1)
        if len(body) > MAX_BODY:
            raise ValueError(f"the answer is longer than {MAX_BODY} bytes")
        ((code, message, value),) = xmlrpc.client.loads(body)[0]  # pyright: ignore
    except OSError as error:
        # A host name that is not known here is helped by ROS_IP where the node runs.
        raise CallError(f"{uri!s:.80}: {error.strerror or error}") from None
    except NONSENSE as error:
        raise CallError(f"no answer of ROS to {method} ({error!s:.80})") from None
    if code != 1:
        raise Refused(str(message))
    return value


class _Handler(SimpleXMLRPCRequestHandler):
    timeout = TIMEOUT

    def handle_one_request(self) -> None:
        # The deadline is for the whole request, not for each byte.
        with deadline(self.connection, TIMEOUT):
            super().handle_one_request()

    def do_POST(self) -> None:
        length = self.headers.get("Content-Length", "")
        if not (length.isdecimal() and int(length[:9]) <= MAX_BODY):
            self.send_error(413)
        elif "Content-Encoding" in self.headers:
            self.send_error(501)
        else:
            super().do_POST()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the graph asks often."""


class SlaveServer(BoundedServer, SimpleXMLRPCDispatcher):
    """Answers the calls in `methods`, which return values; code and message are added here."""

    # What the handler expects of its server.
    _send_traceback_header = logRequests = False

    def __init__(self, host: str, methods: Mapping[str, Callable[..., Any]]):
        """Bind to any free port of `host` and start."""
        SimpleXMLRPCDispatcher.__init__(self, allow_none=False, encoding="utf-8")
        BoundedServer.__init__(self, (host, 0), _Handler)
        self.methods = methods
        self.start()

    def _dispatch(self, method: str, params: Any) -> list[Any]:
        try:
            return [1, "", self.methods[method](*params)]
        except CallError as error:
            return [0, str(error), 0]
        except (KeyError, TypeError, ValueError):
            return [-1, f"no method or not the arguments of {method!s:.80}", 0]
