"""Bags as a format of recordings: whatever reads tracks, such as `read_any`, reads bags.

`plugin.py` registers it. A live stream out of a bag is `ros.recordings`, which keeps its frames.
"""

import dataclasses
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from neurosym_jax.data.provenance import Reading
from neurosym_jax.data.reading import ReadOptions
from neurosym_jax.data.tracks import Tracks
from neurosym_jax.errors import InputWarning, printable
from neurosym_robot.online.frame import Frame
from neurosym_robot.online.recordings import tracks_of_frames
from neurosym_robot.ros.bags import read_people
from neurosym_robot.tracking.motion import FAR

__all__ = ["read_bag"]


def read_bag(path: Path, options: ReadOptions, period: float) -> list[Tracks]:
    """The people of one topic of a bag; `options.topic` chooses it.

    Messages that are older than the one before, people named twice in one, and positions that are
    nowhere or `FAR` are left out.

    Raises:
        InputError: as `bags.read_people` does, or where nobody is left.

    What was left out, and where the bag was cut short, stands in the warnings of `reading`.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", InputWarning)
        frames = [frame for frame in read_people(path, options.topic) if np.isfinite(frame.stamp)]
    said = [str(each.message).removeprefix(f"{path}: ") for each in caught]
    kept = list(_sound(frames))
    lost = sum(len(frame.ids) for frame in frames) - sum(len(frame.ids) for frame in kept)
    if lost:
        said.append(f"{lost} positions are left out: nowhere, far away, twice, or out of order")
    tracks = tracks_of_frames(iter(kept), printable(path.stem))
    where = printable(str(path))
    how = Reading(tracks.recording, where, rows=len(tracks.id), warnings=tuple(said))
    return [dataclasses.replace(tracks, reading=how)]


def _sound(frames: list[Frame]) -> Iterator[Frame]:
    newest = -np.inf
    for stamp, ids, xy in frames:
        if stamp <= newest:
            continue
        newest = stamp
        here = np.flatnonzero((np.abs(xy) < FAR).all(axis=1))
        first = here[np.unique(ids[here], return_index=True)[1]]
        yield Frame(stamp, ids[first], xy[first])
