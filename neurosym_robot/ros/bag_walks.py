"""The three containers of bags read record by record, as they were written, without their indexes.

Each walk yields rosbags' `Connection`s (topics), `Message`s of them, and what its chunks say of
themselves, and ends with EOFError where a record is not whole. Who asks for it is `ros.cut_bags`.
"""

import bz2
import contextlib
import importlib
import io
import sqlite3
import struct
import sys
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

from neurosym_robot.ros.bag_integrity import MAGIC

__all__ = [
    "BEGINS",
    "Counted",
    "Message",
    "ros1_record",
    "take",
    "walk_db3",
    "walk_mcap",
    "walk_ros1",
]

BEGINS = object()
"""A step: what follows is the content of a chunk."""


class Message(NamedTuple):
    """A step."""

    connection: int
    stamp: int
    """Nanoseconds at which it was recorded."""
    data: bytes


class Counted(NamedTuple):
    """A step: what an index says of the chunk before it."""

    connection: int
    count: int


def take(file: BinaryIO, size: int) -> bytes:
    """So many bytes.

    Raises:
        EOFError: where the file ends before.
    """
    data = file.read(size)
    if len(data) < size:
        raise EOFError
    return data


def walk_ros1(file: BinaryIO) -> Iterator[Any]:
    """ROS 1's bags (https://wiki.ros.org/Bags/Format/2.0).

    Raises:
        EOFError: where it ends within a record.
        ValueError: for what is no such record; also `KeyError` and `struct.error`.
    """
    if take(file, 13) != b"#ROSBAG V2.0\n":
        raise ValueError("it does not begin as ROS 1's bags do")
    yield from _ros1_records(file)


def _ros1_records(file: BinaryIO) -> Iterator[Any]:
    from rosbags.interfaces import ConnectionExtRosbag1
    from rosbags.typesys.msg import normalize_msgtype

    while start := file.read(1):
        fields, size = ros1_record(file, start)
        op = fields[b"op"][0]
        number = int.from_bytes(fields.get(b"conn", b""), "little")
        compression = fields.get(b"compression", b"none").decode()
        if op == 5:
            yield BEGINS
            # What is not compressed follows as if there was no chunk. The size is zero until a
            # recorder has finished it.
            if compression != "none":
                content = file.read(size or -1)
                raw = io.BytesIO(_decompressed(compression, content))
                yield from _inside(_ros1_records(raw), whole=0 < size == len(content))
            continue
        data = take(file, size)
        if op == 7:
            said = {name: value.decode() for name, value in _ros1_fields(data)}
            topic = fields[b"topic"].decode()
            topic = "/" * topic.startswith("/") + "/".join(filter(None, topic.split("/")))
            how = ConnectionExtRosbag1(said.get(b"callerid"), None)
            kind, form = normalize_msgtype(said[b"type"]), said[b"message_definition"]
            yield _connection(number, topic, kind, "ros2msg", form, how)
        elif op == 2:
            seconds, rest = struct.unpack("<LL", fields[b"time"])
            yield Message(number, 10**9 * seconds + rest, data)
        elif op == 4:
            yield Counted(number, int.from_bytes(fields[b"count"], "little"))
        elif op not in (3, 6):
            raise ValueError("a record is of no kind that there is")


def ros1_record(file: BinaryIO, start: bytes = b"") -> tuple[dict[bytes, bytes], int]:
    """The header of a record that begins with `start`, and the size of the data that follow.

    Raises:
        EOFError: where it ends before.
        ValueError: where there is no header.
    """
    size = int.from_bytes(start + take(file, 4 - len(start)), "little")
    fields = dict(_ros1_fields(take(file, size)))
    if not fields.get(b"op"):
        raise ValueError("what should be a record is none")
    return fields, *struct.unpack("<L", take(file, 4))


def _ros1_fields(header: bytes) -> Iterator[tuple[bytes, bytes]]:
    while header:
        end = 4 + int.from_bytes(header[:4], "little")
        name, equals, value = header[4:end].partition(b"=")
        if not equals or len(header) < end:
            raise ValueError("what should be a record's header is none")
        yield name, value
        header = header[end:]


def walk_mcap(file: BinaryIO) -> Iterator[Any]:
    """mcap (https://mcap.dev/spec).

    Raises:
        EOFError: where it ends within a record.
        ValueError: for what is no such record; also `KeyError` and `struct.error`.
    """
    if take(file, len(MAGIC)) != MAGIC:
        raise ValueError("it does not begin as mcap does")
    yield from _mcap_records(file, {0: ("__schemaless__", "", "")})


def _mcap_records(file: BinaryIO, schemas: dict[int, tuple[str, str, str]]) -> Iterator[Any]:
    from rosbags.interfaces import ConnectionExtRosbag2

    while kind := file.read(1):
        (size,) = struct.unpack("<Q", take(file, 8))
        if kind == b"\6":
            yield BEGINS
            *_, length, checksum = struct.unpack("<QQQL", take(file, 28))
            compression = _text(file)
            (packed,) = struct.unpack("<Q", take(file, 8))
            content = file.read(packed)
            raw, whole = _decompressed(compression, content), len(content) == packed
            if whole and (len(raw) != length or (checksum and zlib.crc32(raw) != checksum)):
                raise ValueError("a chunk does not have the checksum that it was written with")
            yield from _inside(_mcap_records(io.BytesIO(raw), schemas), whole)
            continue
        record = io.BytesIO(take(file, size))
        if kind == b"\3":
            (number,) = struct.unpack("<H", take(record, 2))
            schemas[number] = (_text(record), _text(record), _text(record))
        elif kind == b"\4":
            number, schema = struct.unpack("<HH", take(record, 4))
            topic, how = _text(record), ConnectionExtRosbag2(_text(record), [])
            yield _connection(number, topic, *schemas[schema], how)
        elif kind == b"\5":
            number, _, stamp, _ = struct.unpack("<HLQQ", take(record, 22))
            yield Message(number, stamp, record.read())
        elif kind == b"\7":
            number, entries = struct.unpack("<HL", take(record, 6))
            yield Counted(number, entries // 16)
        elif not b"\0" < kind < b"\x10":
            raise ValueError("a record is of no kind that there is")


def _text(file: BinaryIO) -> str:
    return take(file, *struct.unpack("<L", take(file, 4))).decode()


def walk_db3(base: sqlite3.Connection) -> Iterator[Any]:
    """ROS 2's database, of which the last pages may be missing.

    Raises:
        EOFError: where a page is missing.
        ValueError: where topics or their definitions are.
    """
    from rosbags.interfaces import ConnectionExtRosbag2

    try:
        rows = base.execute("SELECT id, name, type FROM topics").fetchall()
        forms: dict[str, tuple[str, str]] = {}
        names = "topic_type, encoding, encoded_message_definition"
        # Recorders before Iron had no such table.
        with contextlib.suppress(sqlite3.OperationalError):
            for kind, *form in base.execute(f"SELECT {names} FROM message_definitions").fetchall():
                forms[kind] = (form[0], form[1])
    except sqlite3.DatabaseError as error:
        raise ValueError(f"its database has no topics ({error})") from None
    for number, topic, kind in rows:
        how = ConnectionExtRosbag2("cdr", [])
        yield _connection(number, topic, kind, *forms.get(kind, ("", "")), how)
    try:
        query = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY id"
        yield from map(Message._make, base.execute(query))
    except sqlite3.DatabaseError:
        raise EOFError from None


def _connection(number: int, topic: str, kind: str, encoding: str, form: str, how: Any) -> Any:
    from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat

    formats = MessageDefinitionFormat
    of = {"ros2msg": formats.MSG, "": formats.NONE}.get(encoding, formats.IDL)
    return Connection(number, topic, kind, MessageDefinition(of, form), "", 0, how, None)


def _inside(steps: Iterator[Any], whole: bool) -> Iterator[Any]:
    """Of a chunk's content, which ends within a record only where it is not whole."""
    try:
        yield from steps
    except EOFError:
        if whole:
            raise ValueError("a chunk ends within a record") from None
        raise
    if not whole:
        raise EOFError


def _decompressed(kind: str, content: bytes) -> bytes:
    """As much as there is."""
    if kind == "":
        return content
    if kind == "bz2":
        return bz2.BZ2Decompressor().decompress(content)
    if kind == "lz4":
        return importlib.import_module("lz4.frame").LZ4FrameDecompressor().decompress(content)
    if kind == "zstd":
        # Where rosbags has it from.
        name = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
        return importlib.import_module(name).ZstdDecompressor().decompress(content)
    raise ValueError(f"its chunks are compressed in a way that is not known: {kind}")
