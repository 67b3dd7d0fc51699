"""Bags read and written without ROS: ROS 1 `.bag`, ROS 2 sqlite3 and mcap.

rosbags is imported when a bag is opened. A bag that was cut short is refused by an
error that names the tool that mends it.
"""

import contextlib
import dataclasses
import math
import os
import sqlite3
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neurosym_jax.data.tables import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import Reading, Tracks
from neurosym_jax.errors import InputError, InputWarning, option, printable
from neurosym_robot.input.kinds import HRI, KINDS, POSES
from neurosym_robot.input.source import PeopleSource
from neurosym_robot.ros.bag_limits import refuse_bombs
from neurosym_robot.ros.definitions import (
    PEOPLE_TOPICS,
    TF_TOPICS,
    TF_TYPES,
    TOOLS,
    blank,
    is_bag,
    shared_typestore,
)
from neurosym_robot.tracking.following import (
    FAR,
    Frame,
    frames_of_tracks,
    tracks_of_frames,
)
from neurosym_robot.tracking.names import id_of_name


def read_frames(
    paths: Path | Sequence[Path],
    options: ReadOptions = AS_IT_SAYS,
    source: PeopleSource | None = None,
) -> Iterator[Frame]:
    """Frames of a bag, of one split into several, or of a file of tracks, in their order.

    `options` say what the file does not say itself, such as
    `format="bag,topic=/people"`; `source` says which messages of a bag belong to the
    stream.

    Raises:
        InputError: naming the file and the reason, possibly after some frames of a
            damaged bag.
    """
    path, *others = paths = [paths] if isinstance(paths, Path) else list(paths)
    if all(map(is_bag, paths)):
        topic = None if options == AS_IT_SAYS else _topic_of(path, options)
        return read_people(paths, topic, source)
    if others:
        raise InputError(
            f"{path}: with {others[0]}; several files must be parts of one bag"
        )
    if not os.path.isfile(path):
        raise InputError(
            f"{path}: " + ("not a bag" if os.path.exists(path) else "no such file")
        )
    # Only here: a node and a bag need no library of tables.
    from neurosym_jax.data.recordings import read_any

    recordings = read_any(path, options)
    if len(recordings) != 1:
        raise InputError(
            f"{path}: holds {len(recordings)} recordings, and a stream is one"
        )
    (tracks,) = recordings
    if tracks.names:
        ids = np.array([id_of_name(name) for name in tracks.names])
        tracks = tracks.with_ids(ids[tracks.id])
    return frames_of_tracks(tracks)


def _topic_of(path: Path, options: ReadOptions) -> str | None:
    """The topic that `options` name of a bag.

    Raises:
        InputError: for an option that a bag does not use, or another format.
    """
    from neurosym_jax.data.recordings import format_of, refuse_useless

    form = format_of(path, options)
    if not form.owns(path):
        raise InputError(f"{path}: is a bag, not {option('format', options.format)}")
    refuse_useless(path, form, options)
    frame = getattr(form, "fixed_frame", "")
    if frame:
        raise InputError(
            f"{path}: the frame of a stream is {option('fixed_frame', frame)}"
        )
    return getattr(form, "topic", None)


def read_bag(
    path: Path, topic: str | None = None, fixed_frame: str = ""
) -> list[Tracks]:
    """Tracks of the people on one topic of a bag; default: the only one there is.

    Messages older than the one before, repeated ids in a message, and positions that
    are not finite or beyond `FAR` are left out, and counted in the warnings of
    `reading`.

    Raises:
        InputError: as `read_people`, or if no position is left.
    """
    reports: list[str] = []
    source = PeopleSource(fixed_frame, reports.append, recorded=True)
    try:
        frames = list(read_people(path, topic, source))
    except InputError as error:
        advice = str(error).replace("--fixed-frame ", "--format bag,fixed_frame=")
        raise InputError(advice) from None
    ordered: list[Frame] = []
    for stamp, ids, xy in frames:
        if not ordered or stamp > ordered[-1].stamp:
            near = np.flatnonzero((np.abs(xy) < FAR).all(axis=1))
            first = near[np.unique(ids[near], return_index=True)[1]]
            ordered.append(Frame(stamp, ids[first], xy[first]))
    lost = sum(len(frame.ids) for frame in frames) - sum(
        len(frame.ids) for frame in ordered
    )
    if lost:
        reports.append(
            f"{lost} positions are left out: nowhere, far away, twice, or out of order"
        )
    tracks = tracks_of_frames(iter(ordered), printable(path.stem))
    reading = Reading(
        tracks.recording,
        printable(str(path)),
        rows=len(tracks.id),
        warnings=tuple(reports),
    )
    return [dataclasses.replace(tracks, reading=reading)]


def read_people(
    paths: Path | Sequence[Path],
    topic: str | None = None,
    source: PeopleSource | None = None,
) -> Iterator[Frame]:
    """Frames of people in a bag, or in the parts of a split one, in the order of recording.

    Without `topic`, one of `PEOPLE_TOPICS`, else the only one with people. Without
    `source`, messages of one publisher in one frame, with warnings about others.

    Raises:
        InputError: naming the file and the reason, for a topic or a damaged bag.
    """
    path = paths if isinstance(paths, Path) else paths[0]
    source = source or PeopleSource(
        report=lambda text: warnings.warn(f"{path}: {text}", InputWarning, 3),
        recorded=True,
    )
    kinds = KINDS if source.form is None else None

    def choose(topics: dict[str, str]) -> list[str]:
        return [_choose(path, topics, topic, kinds), *_tf_topics(topics)]

    taken = False
    for name, message, publisher, received in _read(paths, choose):
        if message.__msgtype__ in TF_TYPES:
            is_static = name.endswith("tf_static")
            source.transforms.hear(message, is_static, received)
            frames = source.release(received) if source.waiting else []
        elif (
            kinds is None or message.__msgtype__ in kinds
        ):  # Publishers may disagree about it.
            try:
                frames = source.take(message.__msgtype__, message, publisher, received)
            except InputError as error:
                raise InputError(f"{path}: {error}") from None
        else:
            continue
        taken |= bool(frames)
        yield from frames
    last = source.release(math.inf)
    yield from last
    malformed = source.refused["malformed"]
    if malformed and not (taken or last):
        reasons = "; ".join(source.reports)
        raise InputError(
            f"{path}: none of {malformed} messages could be read: {reasons}"
        )


def _tf_topics(topics: dict[str, str]) -> list[str]:
    """Topics of /tf and /tf_static; of a namespace, as /robot/tf, if there are no others."""
    names = [name for name, kind in topics.items() if kind in TF_TYPES]
    return [name for name in names if name in TF_TOPICS] or names


def read_messages(path: Path) -> Iterator[tuple[str, Any]]:
    """Topic and message, of all topics; InputError names the file and the reason."""
    return ((topic, message) for topic, message, *_ in _read(path, list))


def _read(
    paths: Path | Sequence[Path], choose: Callable[[dict[str, str]], Collection[str]]
) -> Iterator[tuple[str, Any, str, float]]:
    """Topic, message, publisher's name (known in ROS 1 only), and time of recording [s]."""
    paths = [paths] if isinstance(paths, Path) else paths
    files: list[Path] = []
    for path in paths:
        if not os.path.exists(path):
            raise InputError(f"{path}: no such file or folder")
        inside = [path] if path.is_file() else sorted(path.iterdir())
        files += [file for file in inside if file.suffix in TOOLS]
    path = paths[0]
    store = shared_typestore(2)  # Recorders before ROS 2 Iron stored no types.
    try:
        from rosbags.highlevel import AnyReader

        for file in files:
            _check_database(file)
        is_whole = all(
            path.is_file() or (path / "metadata.yaml").is_file() for path in paths
        )
        parts = list(paths) if is_whole else files
        refuse_bombs(path, parts)
        with AnyReader(parts, default_typestore=store) as reader:
            chosen = choose({row.topic: row.msgtype for row in reader.connections})
            connections = [row for row in reader.connections if row.topic in chosen]
            missing = sum(row.msgcount for row in connections) + _unlisted(reader)
            for connection, stamp, data in reader.messages(connections=connections):
                missing -= 1
                message = reader.deserialize(data, connection.msgtype)
                publisher = getattr(connection.ext, "callerid", None) or ""
                yield connection.topic, message, publisher, 1e-9 * stamp
            if missing:
                raise ValueError(f"{missing} of its messages are missing")
    except InputError:
        raise
    except Exception as error:
        # A damaged file makes rosbags, its databases and its decompressors raise
        # anything at all.
        reason = " ".join(str(error).split()) or type(error).__name__
        advice = ""
        if files:
            advice = f"; if it was cut short, `{TOOLS[files[0].suffix]}` may mend it"
        raise InputError(f"{path}: cannot be read as a bag: {reason}{advice}") from None


def _check_database(file: Path) -> None:
    """ValueError for a damaged `.db3`, of which rosbags would read a part."""
    if file.suffix != ".db3":
        return
    uri = f"{file.absolute().as_uri()}?mode=ro"
    with contextlib.closing(sqlite3.connect(uri, uri=True)) as base:
        (state,) = base.execute("PRAGMA quick_check(1)").fetchone()
    if state != "ok":
        raise ValueError(f"its database is damaged: {state}")


def _unlisted(reader: Any) -> int:
    """Messages that are counted but not found: in ROS 1 by two indices."""
    counted, has_chunks = 0, False
    for part in reader.readers:
        for info in getattr(part, "chunk_infos", ()):
            has_chunks = True
            counted += sum(info.connection_counts.values())
    return counted - reader.message_count if has_chunks else 0


def _choose(
    path: Path,
    topics: dict[str, str],
    name_wanted: str | None,
    kinds: Collection[str] | None,
) -> str:
    """The topic of the people, whose type is one of `kinds`; None is any."""
    usable = [name for name, kind in topics.items() if kinds is None or kind in kinds]
    usable = [name for name in usable if topics[name] not in TF_TYPES]
    listed = (
        ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "none"
    )
    # Poses may be of anything, such as a robot's hypotheses of its own pose; ids of
    # ROS4HRI also of faces and voices.
    people = [
        name
        for name in usable
        if topics[name] != POSES and (topics[name] != HRI or "bodies" in name)
    ]
    names = PEOPLE_TOPICS if name_wanted is None else (name_wanted,)
    candidates = [name for name in names if name in usable][:1]
    if not candidates and name_wanted is None:
        candidates = people or usable
    if not candidates and name_wanted is not None and name_wanted not in topics:
        raise InputError(f"{path}: {name_wanted} is not there; there are: {listed}")
    if not candidates:
        subject = "no topic is" if name_wanted is None else f"{name_wanted} is not"
        raise InputError(
            f"{path}: {subject} of a type of docs/robot.md; there are: {listed}; "
            "--people, --position and --id say where messages of another type hold people"
        )
    if len(candidates) > 1:
        raise InputError(
            f"{path}: which topic has the people? There are: {listed}; choose one with "
            "--format bag,topic=NAME"
        )
    return candidates[0]


class BagWriter(contextlib.AbstractContextManager):
    """Writes a new bag; `with BagWriter(path) as bag` closes it whatever happens."""

    def __init__(self, path: Path, compress: bool = False):
        """Open `NAME.bag` of ROS 1, or for `NAME.db3` or `NAME.mcap` a folder `NAME` of ROS 2.

        InputError for another ending, a bag that exists, or a folder that cannot be
        written.
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

        if self.ros == 1:
            self._writer: Any = rosbag1.Writer(self.path)
            compression: Any = (rosbag1.Writer.CompressionFormat.LZ4,)
        else:
            storage, mode = (
                rosbag2.StoragePlugin.SQLITE3,
                rosbag2.CompressionMode.MESSAGE,
            )
            if path.suffix == ".mcap":
                storage, mode = (
                    rosbag2.StoragePlugin.MCAP,
                    rosbag2.CompressionMode.STORAGE,
                )
            self._writer = rosbag2.Writer(self.path, version=8, storage_plugin=storage)
            compression = mode, rosbag2.CompressionFormat.ZSTD
        if compress:
            self._writer.set_compression(*compression)
        self._connections: dict[str, Any] = {}
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer.open()
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be written ({error.strerror})"
            ) from None

    def new(self, kind: str) -> Any:
        """An empty message, by its type."""
        return blank(self._store, kind)

    def write(self, topic: str, stamp: float, message: Any) -> None:
        """Append a message, received at `stamp` seconds.

        Raises:
            InputError: for a time that ROS has no numbers for, before 1970 or after
                2038.
        """
        if not 0 <= stamp < 2**31:
            raise InputError(f"{self.path}: the time {stamp} s does not fit into a bag")
        kind, store = message.__msgtype__, self._store
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=store
            )
        serialise = store.serialize_ros1 if self.ros == 1 else store.serialize_cdr
        self._writer.write(
            self._connections[topic], round(stamp * 1e9), serialise(message, kind)
        )

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write index and metadata."""
        self._writer.close()
