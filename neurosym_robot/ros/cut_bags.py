"""Bags that were cut short, read as far as they go: a recorder was killed, a disk was full.

Nothing before the cut is skipped: what is no record refuses the bag, and the messages of a chunk
are counted against its index, where that was still written. Whole bags are read by rosbags.
"""

import contextlib
import math
import os
import shutil
import sqlite3
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any

from neurosym_robot.ros.bag_integrity import MAGIC
from neurosym_robot.ros.bag_walks import (
    BEGINS,
    Counted,
    Message,
    ros1_record,
    take,
    walk_db3,
    walk_mcap,
    walk_ros1,
)

__all__ = ["CutBag", "is_cut"]

SIDECARS = ("-wal", "-journal")
"""Endings of what lies beside a database that is being written."""


def is_cut(path: Path) -> bool:
    """Whether a file of a bag ends before its end, or was not finished."""
    size = path.stat().st_size
    with path.open("rb") as file:
        if path.suffix == ".mcap":
            file.seek(max(size - len(MAGIC), 0))
            return size < 2 * len(MAGIC) or file.read() != MAGIC
        if path.suffix == ".db3":
            return size < max(100, math.prod(_pages(path))) or bool(_sidecars(path))
        try:
            file.seek(13)
            header, _ = ros1_record(file)
            names = (b"index_pos", b"conn_count", b"chunk_count")
            place, *wanted = (int.from_bytes(header[name], "little") for name in names)
            file.seek(place or size)
            for _ in range(sum(wanted)):
                take(file, ros1_record(file)[1])
        except EOFError:
            return True
        except (KeyError, OverflowError, ValueError):
            return False  # It is damaged in another way.
        return not place


class CutBag:
    """One file of a bag as far as it goes, in the place of a reader of rosbags."""

    def __init__(self, path: Path, folder: Path):
        """Walk through it once.

        Args:
            path: of the file.
            folder: for a copy of a database, until nothing is read any more.

        Raises:
            ValueError: saying what in it is not as it was written, or that there is nothing.
        """
        self.path, self._copy = path, folder / path.name
        self.connections: list[Any] = []
        counts: Counter[int] = Counter()
        stamps: list[int] = []
        for step in self._walk():
            if isinstance(step, Message):
                counts[step.connection] += 1
                stamps = [min(stamps[0], step.stamp), step.stamp] if stamps else [step.stamp] * 2
            else:
                self.connections.append(step)
        if not stamps:
            raise ValueError("there is no whole message in it")
        self.connections = [each._replace(msgcount=counts[each.id]) for each in self.connections]
        seconds = 1e-9 * (stamps[1] - stamps[0])
        self.text = f"{counts.total()} messages of {seconds:.1f} s"
        """How much it has."""

    def messages(
        self, connections: Collection[Any], start: object = None, stop: object = None
    ) -> Iterator[tuple[Any, int, bytes]]:
        """Connection, nanoseconds and data in the order of time, as rosbags gives them."""
        wanted = {each.id: each for each in connections}
        found = [
            (wanted[step.connection], step.stamp, step.data)
            for step in self._walk()
            if isinstance(step, Message) and step.connection in wanted
        ]
        yield from sorted(found, key=itemgetter(1))

    def __enter__(self) -> "CutBag":
        """As rosbags' readers."""
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is kept open."""

    def _walk(self) -> Iterator[Any]:
        """Topics and messages; each topic once, and before its messages."""
        known: dict[int, Any] = {}
        counts: Counter[int] = Counter()
        with contextlib.suppress(EOFError), contextlib.closing(self._open()) as opened:
            walk = {".mcap": walk_mcap, ".db3": walk_db3}.get(self.path.suffix, walk_ros1)
            for step in walk(opened):
                if step is BEGINS:
                    counts.clear()
                elif isinstance(step, Counted):
                    if counts[step.connection] != step.count:
                        raise ValueError("a chunk has not as many messages as its index says")
                elif isinstance(step, Message):
                    if step.connection not in known:
                        raise ValueError("a message is of no topic that is described before it")
                    counts[step.connection] += 1
                    yield step
                elif step.id not in known:
                    known[step.id] = step = step._replace(owner=self)
                    yield step
                elif known[step.id][:4] != step[:4]:
                    raise ValueError("two topics have one number")

    def _open(self) -> Any:
        """The file; of a database a copy, mended by its journal and ending with a whole page."""
        if self.path.suffix != ".db3":
            return self.path.open("rb")
        if not self._copy.exists():
            for each in (self.path, *_sidecars(self.path)):
                shutil.copy(each, self._copy.with_name(each.name))
            page, _ = _pages(self.path)
            os.truncate(self._copy, self._copy.stat().st_size // page * page)
        base = sqlite3.connect(self._copy)
        base.execute("PRAGMA writable_schema=ON")  # Else it is not opened without its last pages.
        return base


def _pages(path: Path) -> tuple[int, int]:
    """Bytes of a database's page, and how many pages it has when it is whole."""
    with path.open("rb") as file:
        head = file.read(100).ljust(100, b"\0")
    (page,), (pages,) = struct.unpack_from(">H", head, 16), struct.unpack_from(">L", head, 28)
    return (page if page > 1 else 1 << 16), pages


def _sidecars(path: Path) -> list[Path]:
    found = [path.with_name(path.name + ending) for ending in SIDECARS]
    return [each for each in found if path.suffix == ".db3" and _is_filled(each)]


def _is_filled(path: Path) -> bool:
    return path.is_file() and path.stat().st_size > 0
