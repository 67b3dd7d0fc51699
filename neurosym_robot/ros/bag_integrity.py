"""Whether a bag is whole, by its container's own checksums, databases' checks and counts.

What a container protects differs (docs/reliability.md): mcap may have checksums of everything,
sqlite checks its pages' structure, and all count their messages. Bags are read in `ros.bags`.
"""

import contextlib
import sqlite3
import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

__all__ = ["counted", "refuse_damaged"]

MAGIC = b"\x89MCAP0\r\n"
FOOTER, DATA_END = 0x02, 0x0F
"""Records of mcap (https://mcap.dev/spec) that hold checksums."""


def refuse_damaged(path: Path) -> None:
    """Check what can be checked of a bag's file before it is read.

    Raises:
        ValueError: saying what does not agree.
    """
    if path.suffix == ".mcap":
        with path.open("rb") as opened:
            _check_mcap(opened)
    elif path.suffix == ".db3":
        with contextlib.closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)
        ) as base:
            (found,) = base.execute("PRAGMA quick_check(1)").fetchone()
        if found != "ok":
            raise ValueError(f"its database is damaged: {found}")


def counted(reader: Any, connections: Sequence[Any]) -> Iterator[tuple[Any, int, Any]]:
    """The messages of some connections of rosbags' AnyReader, counted.

    Raises:
        ValueError: at the end, where there are not as many as the bag says.
    """
    found: Counter[tuple[int, str]] = Counter()
    for connection, stamp, data in reader.messages(connections=connections):
        found[connection.id, connection.topic] += 1
        yield connection, stamp, data
    said: Counter[tuple[int, str]] = Counter()
    for each in reader.readers:
        of_chunks: Counter[int] = Counter()  # ROS 1, where messages are found by another index.
        for info in getattr(each, "chunk_infos", ()):
            of_chunks.update(info.connection_counts)
        for connection in each.connections:
            is_ros1 = hasattr(each, "chunk_infos")
            count = of_chunks.pop(connection.id, 0) if is_ros1 else connection.msgcount
            said[connection.id, connection.topic] += count
        if of_chunks:
            raise ValueError(f"it has {of_chunks.total()} messages of no topic that it describes")
    for id, topic in {(each.id, each.topic) for each in connections} | set(found):
        if said[id, topic] != found[id, topic]:
            raise ValueError(
                f"{topic} has {found[id, topic]} messages where the bag says {said[id, topic]}"
            )


def _check_mcap(file: BinaryIO) -> None:
    """The checksums of the data section and of the summary, where they were written."""
    if file.read(len(MAGIC)) != MAGIC:
        raise ValueError("it does not begin as mcap does")
    crc = zlib.crc32(MAGIC)
    summary = None
    while head := file.read(9):
        if head == MAGIC + head[8:] or len(head) < 9:
            break
        kind, size = struct.unpack("<BQ", head)
        if kind == DATA_END:
            (said,) = struct.unpack("<I", _exactly(file, size)[:4])
            if said and said != crc:
                raise ValueError("its data do not have the checksum that they were written with")
            summary = 0
            continue
        if kind == FOOTER:
            content = _exactly(file, size)
            (said,) = struct.unpack("<I", content[16:20])
            if said and said != zlib.crc32(head + content[:16], summary or 0):
                raise ValueError("its index does not have the checksum that it was written with")
            return
        for part in (head, *_pieces(file, size)):
            crc = zlib.crc32(part, crc)
            summary = None if summary is None else zlib.crc32(part, summary)
    raise ValueError("it has no footer")


def _exactly(file: BinaryIO, size: int) -> bytes:
    if size > 1 << 16:
        raise ValueError("a record is longer than such records are")
    return b"".join(_pieces(file, size))


def _pieces(file: BinaryIO, size: int) -> Iterator[bytes]:
    while size:
        part = file.read(min(size, 1 << 20))
        if not part:
            raise ValueError("it ends within a record")
        size -= len(part)
        yield part
