"""Frames of a stream of people, and the way between them and a table of tracks."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks, resample
from neurosym_jax.errors import InputError

__all__ = ["Frame", "frames_of_tracks", "synchronous", "tracks_of_frames"]


class Frame(NamedTuple):
    """Everybody seen at one moment, as `Predictor.push` takes it."""

    stamp: float
    """Seconds, of the message's header."""
    ids: np.ndarray
    """[N] int64."""
    xy: np.ndarray
    """[N, 2] float64 world metres."""


def synchronous(tracks: Tracks) -> Tracks:
    """The tracks, resampled to one clock if agents have clocks of their own."""
    frames = np.unique(tracks.stamp)
    steps = np.diff(tracks.stamp)[np.diff(tracks.id) == 0]
    if len(steps) and np.median(np.diff(frames)) < 0.5 * np.median(steps):
        return resample(tracks, float(np.median(steps)))
    return tracks


def frames_of_tracks(tracks: Tracks) -> Iterator[Frame]:
    """Everybody at each stamp, of `synchronous` tracks."""
    tracks = synchronous(tracks)
    order = np.lexsort((tracks.id, tracks.stamp))
    stamp, id, position = tracks.stamp[order], tracks.id[order], tracks.position[order]
    starts = np.flatnonzero(np.diff(stamp, prepend=-np.inf))
    for first, last in zip(starts, [*starts[1:], len(stamp)]):
        yield Frame(float(stamp[first]), id[first:last], position[first:last])


def tracks_of_frames(frames: Iterator[Frame], recording: str = "") -> Tracks:
    """Tracks of a stream.

    Raises:
        InputError: without people, or for frames that `make_tracks` refuses.
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
