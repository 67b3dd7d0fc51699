"""Frames of people, and tracks of them."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from neurosym_jax.data.tracks import Tracks, make_tracks, resample
from neurosym_jax.errors import InputError
from neurosym_jax.models.tracking_errors import FASTEST

FAR = 3000.0  # metres; the original robot's filter puts lost people at (-3000, -3000)
# seconds: a stamp older by more means a clock set back, also if it comes alone
RESET = 5.0
MAX_SPEED = 5.0  # metres per second by which a velocity may change at once
SLACK = 1.0  # metres of error of a tracker, both observations together


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
    is_same = np.diff(tracks.id) == 0
    steps = np.diff(tracks.stamp)[is_same]
    if not len(steps):
        return tracks
    step = float(np.median(steps))
    frames = np.unique(tracks.stamp)
    if np.median(np.diff(frames)) < 0.5 * step:
        return resample(tracks, step)
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


def is_jump(moved: np.ndarray, velocity: np.ndarray, gap: np.ndarray) -> np.ndarray:
    """[N] whether people cannot have `moved` [N, 2] metres in `gap` [N] seconds.

    A cyclist goes on at 12 m/s as before; who stood cannot be there. `velocity` [N, 2]
    is the last one, NaN where none is known: then all up to `FASTEST` may be.
    """
    speed = np.where(np.isnan(velocity[:, 0]), FASTEST, MAX_SPEED)
    off = moved - np.nan_to_num(velocity) * np.where(np.isinf(gap), 0, gap)[:, None]
    return np.linalg.norm(off, axis=1) > speed * gap + SLACK
