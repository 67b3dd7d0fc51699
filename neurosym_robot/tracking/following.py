"""Frames of people, and tracks of them."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks
from neurosym_jax.data.windows import resample
from neurosym_jax.errors import InputError

FAR = 3000.0  # metres; the original robot's filter puts lost people at (-3000, -3000)
# seconds: a stamp older by more means a clock set back, also if it comes alone
RESET = 5.0
MAX_SPEED = 5.0  # metres per second of a person between two observations
SLACK = 1.0  # metres of error of a tracker, both observations together
# people without ids followed at once; the others get new ids in every frame
CROWD = 512


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
    starts = np.flatnonzero(np.diff(tracks.stamp[order])) + 1
    for rows in np.split(order, starts) if len(order) else ():
        yield Frame(
            float(tracks.stamp[rows[0]]), tracks.id[rows], tracks.position[rows]
        )


def tracks_of_frames(frames: Iterator[Frame], recording: str = "") -> Tracks:
    """Tracks of a stream.

    Raises:
        InputError: without people, or for frames that `make_tracks` refuses.
    """
    populated = [frame for frame in frames if len(frame.ids)]
    if not populated:
        raise InputError(f"{recording}: nobody in it")
    return make_tracks(
        recording,
        np.repeat(
            [frame.stamp for frame in populated],
            [len(frame.ids) for frame in populated],
        ),
        np.concatenate([frame.ids for frame in populated]),
        np.concatenate([frame.xy for frame in populated]),
    )


def is_jump(moved: Any, gap: Any) -> Any:
    """Whether a person cannot have `moved` [...] metres in `gap` [...] seconds."""
    return moved > MAX_SPEED * gap + SLACK
