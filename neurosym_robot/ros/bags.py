"""Bags read and written without ROS: ROS 1 `.bag`, ROS 2 sqlite3 and mcap.

Needs rosbags, which is imported when a bag is opened. What people's messages say is in
`ros.messages`; other recordings of people are read in `online.recordings`. Of a bag that was cut
short (`ros.cut_bags`) what is whole is read, with a warning.
"""

import contextlib
import tempfile
import time
import warnings
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from neurosym_jax.errors import InputError, InputWarning
from neurosym_robot.online.frame import Frame
from neurosym_robot.ros.bag_integrity import counted, refuse_damaged
from neurosym_robot.ros.bag_names import ACTIVE, SUFFIXES, files_of, tool_for
from neurosym_robot.ros.cut_bags import CutBag, is_cut
from neurosym_robot.ros.definitions import blank, typestore
from neurosym_robot.ros.messages import PEOPLE_TOPICS
from neurosym_robot.ros.people import KINDS, POSES
from neurosym_robot.ros.source import Source

__all__ = ["TF_TOPICS", "BagWriter", "frame_id_of", "read_messages", "read_people"]

TF_TOPICS = ("/tf", "/tf_static")
"""Where frames of coordinates lie, in messages of `ros.definitions.TRANSFORMS`."""
KEEP = 1.0
"""Seconds of recording that are lost at most where the one who writes is killed."""


def read_people(
    path: Path, topic: str | None = None, source: Source | None = None
) -> Iterator[Frame]:
    """The people of a bag, frame by frame in the order of recording.

    Args:
        path: file of ROS 1, or folder or file of ROS 2.
        topic: of the people; if None, one of `PEOPLE_TOPICS`, else the only one with people.
        source: which messages belong to the stream, and where they are taken to; by default those
            of one publisher in one frame of coordinates, and warnings of the others.

    Raises:
        InputError: at the first frame, or where the bag is damaged, naming the file and the reason.
    """
    source = source or Source(report=lambda text: warnings.warn(f"{path}: {text}", InputWarning, 3))

    def choose(topics: dict[str, str]) -> list[str]:
        return [_choose(path, topics, topic), *(TF_TOPICS if source.needs_transforms else ())]

    for name, message, publisher, received in _read(path, choose):
        if name in TF_TOPICS:
            source.transforms.hear(message, static=name == TF_TOPICS[1])
        # Two publishers may have disagreed about the type of one topic.
        elif message.__msgtype__ in KINDS:
            frame = source.take(message.__msgtype__, message, publisher, received)
            if frame is not None:
                yield frame


def frame_id_of(path: Path, topic: str | None = None) -> str:
    """The coordinates' frame in a bag's first message of people; `topic` as for `read_people`.

    Raises:
        InputError: as `read_people`.
    """
    for _, message in read_messages(path, lambda topics: [_choose(path, topics, topic)]):
        return message.header.frame_id.removeprefix("/")
    return ""


def read_messages(
    path: Path, choose: Callable[[dict[str, str]], Collection[str]] | None = None
) -> Iterator[tuple[str, Any]]:
    """Topic and message of those topics that `choose({topic: type})` names; of all if None.

    Raises:
        InputError: naming the file and the reason.
    """
    return ((topic, message) for topic, message, *_ in _read(path, choose))


def _read(
    path: Path, choose: Callable[[dict[str, str]], Collection[str]] | None
) -> Iterator[tuple[str, Any, str, float]]:
    """Topic, message, its publisher's name (known in ROS 1 only), and when it was recorded [s]."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    store = typestore(2)
    try:
        with _reader(path, store) as reader:
            topics = {each.topic: each.msgtype for each in reader.connections}
            chosen = list(topics) if choose is None else choose(topics)
            connections = [each for each in reader.connections if each.topic in chosen]
            for connection, at, data in counted(reader, connections):
                message = reader.deserialize(data, connection.msgtype)
                publisher = getattr(connection.ext, "callerid", None) or ""
                yield connection.topic, message, publisher, 1e-9 * at
    except InputError:
        raise
    except Exception as error:
        # A damaged file makes rosbags, its databases and its decompressors raise anything at all.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read as a bag: {reason}{_advice(path)}") from None


@contextlib.contextmanager
def _reader(path: Path, store: Any) -> Iterator[Any]:
    """rosbags' reader of a bag; where a file was cut short, `CutBag` is in the place of its own."""
    from rosbags.highlevel import AnyReader

    files = files_of(path)
    cut = [file for file in files if is_cut(file)]
    for file in files:
        if file not in cut:
            refuse_damaged(file)
    whole = not cut and (path.is_file() or (path / "metadata.yaml").is_file())
    with tempfile.TemporaryDirectory() as folder:
        ours = {file: CutBag(file, Path(folder)) for file in cut}
        # Recorders before ROS 2 Iron did not store what their types are.
        mixed = [_Unread(file) if file in ours else file for file in files]
        paths: Any = [path] if whole else mixed
        reader: Any = AnyReader(paths, default_typestore=store)
        if not whole:
            found = ", ".join(f"{bag.text} in {file.name}" for file, bag in ours.items())
            text = "was cut short, or never finished; what there is of it is read"
            warnings.warn(f"{path}: {text}{found and ': '}{found}", InputWarning, stacklevel=2)
            reader.readers = [ours.get(file, each) for file, each in zip(files, reader.readers)]
        with reader:
            yield reader


class _Unread:
    """What rosbags asks a path for before it opens it."""

    def __init__(self, path: Path):
        self.suffix = ".bag" if path.name.endswith(ACTIVE) else path.suffix

    def exists(self) -> bool:
        return True

    def is_dir(self) -> bool:
        return False


def _advice(path: Path) -> str:
    """What may help where a recorder was interrupted."""
    tools = [tool_for(file) for file in files_of(path)]
    return f"; if it was cut short, `{tools[0]}` may mend it" if tools else ""


def _choose(path: Path, topics: dict[str, str], asked: str | None) -> str:
    """The topic of the people."""
    usable = [name for name, kind in topics.items() if kind in KINDS]
    there = ", ".join(f"{name} ({kind})" for name, kind in sorted(topics.items())) or "none"
    if asked is not None:
        if asked not in topics:
            raise InputError(f"{path}: no topic {asked}; there are: {there}")
        if asked not in usable:
            raise InputError(f"{path}: {asked} carries {topics[asked]}, not {' or '.join(KINDS)}")
        return asked
    for name in PEOPLE_TOPICS:
        if name in usable:
            return name
    # Poses may be of anything, such as a robot's guesses where it is.
    usable = [name for name in usable if topics[name] != POSES] or usable
    if len(usable) != 1:
        wanted = "choose one with --topic" if usable else f"none carries {' or '.join(KINDS)}"
        raise InputError(f"{path}: which topic has the people? There are: {there}; {wanted}")
    return usable[0]


class BagWriter:
    """Writes a new bag; `with BagWriter(path) as bag`, which closes it whatever happens.

    Until it is finished it can be told, and read, as one that was cut short: a file of ROS 1 is
    called `NAME.bag.active`, a folder has no `metadata.yaml`.
    """

    def __init__(self, path: Path):
        """Open for writing.

        Args:
            path: `NAME.bag` is a ROS 1 file; `NAME.db3` and `NAME.mcap` are ROS 2 bags, folders
                `NAME` as ROS 2 has them, in sqlite3 and mcap.

        Raises:
            InputError: for another ending, a bag that is there already, a folder that is not.
        """
        path = Path(path)
        if path.suffix not in SUFFIXES:
            raise InputError(f"{path}: a bag's name ends in {', '.join(SUFFIXES)}")
        self.ros = 1 if path.suffix == ".bag" else 2
        self.path = path if self.ros == 1 else path.with_suffix("")
        self._store = typestore(self.ros)
        self.types = self._store.types
        """Classes of the messages by name."""
        from rosbags import rosbag1, rosbag2

        if self.path.exists():
            raise InputError(f"{self.path}: already there, and nothing is overwritten")
        self._writer: Any
        if self.ros == 1:
            active = self.path.with_name(self.path.stem + ACTIVE)
            if active.exists():
                raise InputError(f"{active}: already there, and nothing is overwritten")
            self._writer = rosbag1.Writer(active)
        else:
            plugin = rosbag2.StoragePlugin
            storage = plugin.MCAP if path.suffix == ".mcap" else plugin.SQLITE3
            self._writer = rosbag2.Writer(self.path, version=8, storage_plugin=storage)
        self._connections: dict[str, Any] = {}
        self._kept = time.monotonic()
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
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store
            )
        store = self._store
        serialise = store.serialize_ros1 if self.ros == 1 else store.serialize_cdr
        self._writer.write(self._connections[topic], round(stamp * 1e9), serialise(message, kind))
        if time.monotonic() - self._kept > KEEP:
            self._kept = time.monotonic()
            self._keep()

    def _keep(self) -> None:
        """Give the disk what was written so far, which rosbags keeps in memory for long."""
        if self.ros == 1:
            self._writer.write_chunk(self._writer.chunks[-1])
            self._writer.bio.flush()
        elif hasattr(self._writer.storage, "conn"):
            self._writer.storage.conn.commit()
        else:
            self._writer.storage.close_chunk()
            self._writer.storage.bio.flush()

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Write index and metadata, so that what was written before an interruption is there."""
        self._writer.close()
        if self.ros == 1:
            self._writer.path.rename(self.path)
