"""Any recording of people, a bag or a file of tracks, as the frames of a live stream."""

from collections.abc import Iterator
from pathlib import Path

from neurosym_jax.data.formats import read_any
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.errors import InputError
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.recordings import frames_of_tracks
from neurosym_robot.ros.bag_names import is_bag
from neurosym_robot.ros.bags import read_people
from neurosym_robot.ros.source import Source

__all__ = ["read_frames"]


def read_frames(
    path: Path,
    options: ReadOptions = AS_IT_SAYS,
    source: Source | None = None,
) -> Iterator[Frame]:
    """The frames of a bag or of a file of tracks, in its order.

    Args:
        path: a bag (see `ros.bags`), or any file that `data.formats.read_any` reads.
        options: what it does not say itself: of a bag, the topic of the people.
        source: of a bag, which messages belong to the stream.

    Raises:
        InputError: naming the file and the reason, possibly after some frames of a damaged bag.
    """
    path = Path(path)
    if is_bag(path):
        return read_people(path, options.topic, source)
    if not path.is_file():
        raise InputError(f"{path}: " + ("not a bag" if path.exists() else "no such file"))
    recordings = read_any(path, options)
    if len(recordings) != 1:
        raise InputError(f"{path}: holds {len(recordings)} recordings, and a stream is one")
    return frames_of_tracks(recordings[0])
