"""Bags read and written without ROS: ROS 1 `.bag`, ROS 2 sqlite3 and mcap.

rosbags is imported when a bag is opened. A bag that was cut short is refused by an error that names
the tool that mends it.
"""

import contextlib
import dataclasses
import os
import sqlite3
import warnings
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.formats import format_of, read_any
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import Reading, Tracks
from neurosym_jax.errors import InputError, InputWarning, printable
from neurosym_robot.ros.bag_limits import refuse_bombs
from neurosym_robot.ros.definitions import (
    PEOPLE_TOPICS,
    TF_TOPICS,
    TOOLS,
    blank,
    is_bag,
    shared_typestore,
)
from neurosym_robot.ros.people import KINDS, POSES, PeopleSource
from neurosym_robot.tracking.following import FAR, Frame, frames_of_tracks, tracks_of_frames


def read_frames(
    path: Path, options: ReadOptions = AS_IT_SAYS, source: PeopleSource | None = None
) -> Iterator[Frame]:
    """Frames of a bag, or of a file of tracks that `read_any` reads, in its order.

    `options` say what the file does not say itself, such as `format="bag,topic=/people"`; `source`
    says which messages of a bag belong to the stream.

    Raises:
        InputError: naming the file and the reason, possibly after some frames of a damaged bag.
    """
    path = Path(path)
    if is_bag(path):
        return read_people(path, getattr(format_of(path, options), "topic", None), source)
    if not os.path.isfile(path):
        raise InputError(f"{path}: " + ("not a bag" if os.path.exists(path) else "no such file"))
    recordings = read_any(path, options)
    if len(recordings) != 1:
        raise InputError(f"{path}: holds {len(recordings)} recordings, and a stream is one")
    return frames_of_tracks(recordings[0])


def read_bag(path: Path, topic: str | None = None) -> list[Tracks]:
    """Tracks of the people on one topic of a bag; default: the only one there is.

    Messages older than the one before, repeated ids in a message, and positions that are not finite
    or beyond `FAR` are left out, and counted in the warnings of `reading`.

    Raises:
        InputError: as `read_people`, or if no position is left.
    """
    said: list[str] = []
    frames = list(read_people(path, topic, PeopleSource(report=said.append)))
    kept: list[Frame] = []
    for stamp, ids, xy in frames:
        if not kept or stamp > kept[-1].stamp:
            near = np.flatnonzero((np.abs(xy) < FAR).all(axis=1))
            first = near[np.unique(ids[near], return_index=True)[1]]
            kept.append(Frame(stamp, ids[first], xy[first]))
    lost = sum(len(frame.ids) for frame in frames) - sum(len(frame.ids) for frame in kept)
    if lost:
        said.append(f"{lost} positions are left out: nowhere, far away, twice, or out of order")
    tracks = tracks_of_frames(iter(kept), printable(path.stem))
    how = Reading(tracks.recording, printable(str(path)), rows=len(tracks.id), warnings=tuple(said))
    return [dataclasses.replace(tracks, reading=how)]


def read_people(
    path: Path, topic: str | None = None, source: PeopleSource | None = None
) -> Iterator[Frame]:
    """Frames of people in a bag, in the order of recording.

    Without `topic`, one of `PEOPLE_TOPICS`, else the only one with people. Without `source`,
    messages of one publisher in one frame, with warnings about others.

    Raises:
        InputError: naming the file and the reason, for a topic or a damaged bag.
    """
    source = source or PeopleSource(
        report=lambda text: warnings.warn(f"{path}: {text}", InputWarning, 3)
    )
    more = TF_TOPICS if source.needs_transforms else ()
    rows = _read(path, lambda topics: [_choose(path, topics, topic), *more])
    for name, message, publisher, received in rows:
        if name in TF_TOPICS:
            source.transforms.hear(message, static=name == TF_TOPICS[1])
        elif message.__msgtype__ in KINDS:  # Two publishers may disagree about a topic's type.
            frame = source.take(message.__msgtype__, message, publisher, received)
            if frame is not None:
                yield frame


def read_messages(path: Path) -> Iterator[tuple[str, Any]]:
    """Topic and message, of all topics; InputError names the file and the reason."""
    return ((topic, message) for topic, message, *_ in _read(path, list))


def _read(
    path: Path, choose: Callable[[dict[str, str]], Collection[str]]
) -> Iterator[tuple[str, Any, str, float]]:
    """Topic, message, publisher's name (known in ROS 1 only), and time of recording [s]."""
    path = Path(path)
    if not os.path.exists(path):
        raise InputError(f"{path}: no such file or folder")
    store = shared_typestore(2)  # Recorders before ROS 2 Iron stored no definitions.
    there = [path] if path.is_file() else sorted(path.iterdir())
    files = [file for file in there if file.suffix in TOOLS]
    try:
        from rosbags.highlevel import AnyReader

        for file in files:
            if file.suffix == ".db3":  # rosbags would read a part of a damaged one.
                uri = f"{file.absolute().as_uri()}?mode=ro"
                with contextlib.closing(sqlite3.connect(uri, uri=True)) as base:
                    (found,) = base.execute("PRAGMA quick_check(1)").fetchone()
                if found != "ok":
                    raise ValueError(f"its database is damaged: {found}")
        whole = path.is_file() or (path / "metadata.yaml").is_file()
        paths = [path] if whole else files
        refuse_bombs(path, paths)
        with AnyReader(paths, default_typestore=store) as reader:
            chosen = choose({each.topic: each.msgtype for each in reader.connections})
            connections = [each for each in reader.connections if each.topic in chosen]
            # In ROS 1 another index finds the messages than counts them.
            chunks = [info for each in reader.readers for info in getattr(each, "chunk_infos", ())]
            said = sum(sum(info.connection_counts.values()) for info in chunks)
            missing = sum(each.msgcount for each in connections)
            missing += said - reader.message_count if chunks else 0
            for connection, at, data in reader.messages(connections=connections):
                missing -= 1
                message = reader.deserialize(data, connection.msgtype)
                publisher = getattr(connection.ext, "callerid", None) or ""
                yield connection.topic, message, publisher, 1e-9 * at
            if missing:
                raise ValueError(f"{missing} of its messages are missing")
    except InputError:
        raise
    except Exception as error:
        # A damaged file makes rosbags, its databases and its decompressors raise anything at all.
        reason = " ".join(str(error).split()) or type(error).__name__
        advice = f"; if it was cut short, `{TOOLS[files[0].suffix]}` may mend it" if files else ""
        raise InputError(f"{path}: cannot be read as a bag: {reason}{advice}") from None


def _choose(path: Path, topics: dict[str, str], asked: str | None) -> str:
    """The topic of the people."""
    usable = [name for name, kind in topics.items() if kind in KINDS]
    there = ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "none"
    # Poses may be of anything, such as a robot's hypotheses of its own pose.
    others = [name for name in usable if topics[name] != POSES] or usable
    wanted = PEOPLE_TOPICS if asked is None else (asked,)
    found = [name for name in wanted if name in usable][:1] or (others if asked is None else [])
    if not found:
        what = "none" if asked is None else f"{asked} is not there, or none that"
        raise InputError(f"{path}: {what} carries {' or '.join(KINDS)}; there are: {there}")
    if len(found) > 1:
        raise InputError(
            f"{path}: which topic has the people? There are: {there}; choose one with "
            "--format bag,topic=NAME"
        )
    return found[0]


class BagWriter(contextlib.AbstractContextManager):
    """Writes a new bag; `with BagWriter(path) as bag` closes it whatever happens."""

    def __init__(self, path: Path):
        """Open `NAME.bag` of ROS 1, or for `NAME.db3` or `NAME.mcap` a folder `NAME` of ROS 2.

        InputError for another ending, a bag that exists, or a folder that cannot be written.
        """
        path = Path(path)
        if path.suffix not in TOOLS:
            raise InputError(f"{path}: a bag's name ends in {', '.join(TOOLS)}")
        self.ros = 1 if path.suffix == ".bag" else 2
        self.path = path if self.ros == 1 else path.with_suffix("")
        if os.path.exists(self.path):
            raise InputError(f"{self.path}: already there, and nothing is overwritten")
        self._store = shared_typestore(self.ros)
        from rosbags import rosbag1, rosbag2

        storage = rosbag2.StoragePlugin
        plugin = storage.MCAP if path.suffix == ".mcap" else storage.SQLITE3
        self._writer: Any = (
            rosbag1.Writer(self.path)
            if self.ros == 1
            else rosbag2.Writer(self.path, version=8, storage_plugin=plugin)
        )
        self._connections: dict[str, Any] = {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer.open()
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror})") from None

    def new(self, kind: str) -> Any:
        """An empty message, by its type."""
        return blank(self._store, kind)

    def write(self, topic: str, stamp: float, message: Any) -> None:
        """Append a message, received at `stamp` seconds.

        Raises:
            InputError: for a time that ROS has no numbers for, before 1970 or after 2038.
        """
        if not 0 <= stamp < 2**31:
            raise InputError(f"{self.path}: the time {stamp} s does not fit into a bag")
        kind, store = message.__msgtype__, self._store
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=store)
        serialise = store.serialize_ros1 if self.ros == 1 else store.serialize_cdr
        self._writer.write(self._connections[topic], round(stamp * 1e9), serialise(message, kind))

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write index and metadata."""
        self._writer.close()
