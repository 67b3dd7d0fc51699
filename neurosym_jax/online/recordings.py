"""Any recording of people as the frames of a live stream."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from neurosym_jax.data.formats import read_any
from neurosym_jax.data.reading import AS_IT_SAYS, ReadOptions
from neurosym_jax.data.tracks import Tracks, make_tracks, resample
from neurosym_jax.errors import InputError
from neurosym_jax.ros.bags import is_bag, read_people
from neurosym_jax.ros.messages import Frame

__all__ = ["frames_of_tracks", "read_frames", "tracks_of_frames"]


def read_frames(
    path: Path, topic: str | None = None, options: ReadOptions = AS_IT_SAYS
) -> Iterator[Frame]:
    """The frames of a bag or of a file of tracks, in its order.

    Args:
        path: a bag (see `ros.bags`), or any file that `data.formats.read_any` reads.
        topic: of the people in a bag.
        options: of a file of tracks, what it does not say itself.

    Raises:
        InputError: naming the file and the reason, possibly after some frames of a damaged bag.
    """
    path = Path(path)
    if is_bag(path):
        return read_people(path, topic)
    if topic is not None:
        raise InputError(f"{path}: only a bag has topics")
    if not path.is_file():
        raise InputError(f"{path}: " + ("not a bag" if path.exists() else "no such file"))
    recordings = read_any(path, options)
    if len(recordings) != 1:
        raise InputError(f"{path}: holds {len(recordings)} recordings, and a stream is one")
    return frames_of_tracks(recordings[0])


def frames_of_tracks(tracks: Tracks) -> Iterator[Frame]:
    """Everybody at each stamp; where agents have clocks of their own, they are put on one first."""
    frames = np.unique(tracks.stamp)
    steps = np.diff(tracks.stamp)[np.diff(tracks.id) == 0]
    if len(steps) and np.median(np.diff(frames)) < 0.5 * np.median(steps):
        tracks = resample(tracks, float(np.median(steps)))
    order = np.lexsort((tracks.id, tracks.stamp))
    stamp, id, position = tracks.stamp[order], tracks.id[order], tracks.position[order]
    starts = np.flatnonzero(np.diff(stamp, prepend=-np.inf))
    for first, last in zip(starts, [*starts[1:], len(stamp)]):
        yield Frame(float(stamp[first]), id[first:last], position[first:last])


def tracks_of_frames(frames: Iterator[Frame], recording: str = "") -> Tracks:
    """The track table of a stream whose frames are sound.

    Raises:
        InputError: for no people at all, or frames that `make_tracks` refuses.
    """
    kept = [frame for frame in frames if len(frame.ids)]
    if not kept:
        raise InputError(f"{recording}: nobody in it")
    return make_tracks(
        recording,
        np.repeat([frame.stamp for frame in kept], [len(frame.ids) for frame in kept]),
        np.concatenate([frame.ids for frame in kept]),
        np.concatenate([frame.xy for frame in kept]),
    )
