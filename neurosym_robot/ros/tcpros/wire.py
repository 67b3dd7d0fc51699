"""Blocks of a TCPROS connection, with their length in front; the first is a header.

See https://wiki.ros.org/ROS/TCPROS and https://wiki.ros.org/ROS/Connection%20Header. The length of
what the other side sends is checked before it is read.
"""

import socket
import struct
from collections.abc import Mapping

__all__ = ["ProtocolError", "decode_header", "encode_block", "encode_header", "prepare"]
__all__ += ["read_block", "read_header"]

MAX_HEADER = 1 << 20  # bytes; a header carries the message's definition, a few kilobytes at most
MAX_MESSAGE = 4 << 20  # bytes; ten thousand people are about 1 MB


class ProtocolError(ConnectionError):
    """The other side does not speak TCPROS, or refuses."""


def encode_block(data: bytes) -> bytes:
    """`data` with its length in front."""
    return struct.pack("<I", len(data)) + data


def encode_header(fields: Mapping[str, str]) -> bytes:
    """A header as the block that begins a connection."""
    rows = (encode_block(f"{key}={value}".encode()) for key, value in fields.items())
    return encode_block(b"".join(rows))


def decode_header(data: bytes) -> dict[str, str]:
    """The fields of a header, given without its own length; ProtocolError if malformed."""
    fields, at = {}, 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "little")
        row, at = data[at + 4 : at + 4 + length], at + 4 + length
        key, equals, value = row.partition(b"=")
        if at > len(data) or not equals:
            raise ProtocolError("malformed header: a field is cut off or has no '='")
        fields[key.decode(errors="replace")] = value.decode(errors="replace")
    return fields


def read_header(connection: socket.socket) -> dict[str, str]:
    """The fields of the header that begins a connection; ProtocolError if malformed."""
    return decode_header(read_block(connection, MAX_HEADER))


def read_block(connection: socket.socket, limit: int = MAX_MESSAGE) -> bytes:
    """The next block, without its length; ProtocolError if longer than `limit` bytes."""
    (length,) = struct.unpack("<I", _read(connection, 4))
    if length > limit:
        raise ProtocolError(f"a block of {length} bytes was announced, more than {limit}")
    return bytes(_read(connection, length))


def prepare(connection: socket.socket) -> None:
    """Send at once; notice within half a minute when the other computer is gone."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 10), ("TCP_KEEPINTVL", 5), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, name):  # Not every system lets them be set.
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _read(connection: socket.socket, length: int) -> bytearray:
    data = bytearray()
    while len(data) < length:
        # Memory grows with what arrives, not with what was announced.
        part = connection.recv(min(length - len(data), 1 << 16))
        if not part:
            raise ConnectionError("closed by the other side")
        data += part
    return data
