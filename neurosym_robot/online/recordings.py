"""Between a table of tracks and the frames of a stream."""

from collections.abc import Iterator

import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks, resample
from neurosym_jax.errors import InputError
from neurosym_robot.online.frame import Frame

__all__ = ["frames_of_tracks", "tracks_of_frames"]


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
