"""Broken tracks mended: ids of one person joined across occlusions, short gaps filled.

`stitch` works over a recording, `OnlineStitcher` frame by frame. What a person has said about ids
(a map from old to new) stands: those tracks are renamed, and not joined by themselves.
"""

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import SNAP, Tracks, make_tracks
from neurosym_jax.errors import InputError
from neurosym_jax.tracking.linking import LinkOptions, Loose, assign, velocity

__all__ = ["Join", "Stitched", "inside", "join_ids", "stitch"]

NO_LINKS = LinkOptions()


class Join(NamedTuple):
    """The track `new` was found to go on as `old`."""

    old: int
    new: int
    gap: float
    """Seconds."""


@dataclasses.dataclass(frozen=True, eq=False)
class Stitched:
    """A mended recording and what was done to it."""

    tracks: Tracks
    before: int
    """Ids before."""
    joins: list[Join]
    outside: int
    """Rows dropped because they lie outside the map."""
    filled: int
    """Rows added, marked as imputed."""


def stitch(
    tracks: Tracks,
    options: LinkOptions = NO_LINKS,
    *,
    fill: float = 2.0,
    polygon: ArrayLike | None = None,
    ids: Mapping[int, int] | None = None,
) -> Stitched:
    """Mend a recording.

    Args:
        tracks: R rows.
        options: when two tracks may be one person's.
        fill: seconds; gaps up to this long are filled linearly, at the recording's own rate.
        polygon: [P, 2] metres, corners of the map; rows outside are dropped first.
        ids: new id of an old one, decided by hand.

    Raises:
        InputError: for no row inside the map, a polygon that is none, or a map of ids that gives
            two people of one moment the same id.
    """
    if not fill >= 0:
        raise InputError(f"fill must not be negative, not {fill}")
    before, rows = len(np.unique(tracks.id)), len(tracks.id)
    if polygon is not None:
        keep = inside(tracks.position, polygon)
        if not keep.any():
            raise InputError(f"{tracks.recording}: nobody is inside the map")
        tracks = _rows(tracks, tracks.id, keep)
    outside = rows - len(tracks.id)
    pinned = np.zeros(0, np.int64)
    if ids:
        taken = set(tracks.id.tolist())
        pinned = np.array(sorted({ids[old] for old in taken if old in ids}), np.int64)
        tracks = _rows(tracks, np.array([ids.get(id, id) for id in tracks.id.tolist()]))
    label, joins = _join(tracks, options, pinned)
    tracks = _rows(tracks, label)
    mended = _fill(tracks, fill)
    return Stitched(mended, before, joins, outside, len(mended.id) - len(tracks.id))


def join_ids(tracks: Tracks, options: LinkOptions = NO_LINKS) -> np.ndarray:
    """[R] ids of the rows of `tracks`: those of one person are the first that the person had."""
    return _join(tracks, options, np.zeros(0, np.int64))[0]


def _join(
    tracks: Tracks, options: LinkOptions, pinned: np.ndarray
) -> tuple[np.ndarray, list[Join]]:
    ids, first, count = np.unique(tracks.id, return_index=True, return_counts=True)
    last = first + count - 1
    free = ~np.isin(ids, pinned)
    ids, first, last = ids[free], first[free], last[free]
    motion = np.zeros((2, len(ids), 2))
    for n, (head, tail) in enumerate(zip(first, last)):
        stamp, position = tracks.stamp[head : tail + 1], tracks.position[head : tail + 1]
        for side, at in enumerate((stamp[-1], stamp[0])):
            near = np.abs(stamp - at) <= options.memory + SNAP
            motion[side, n] = velocity(stamp[near], position[near])
    ends = Loose(tracks.stamp[last], tracks.position[last], motion[0])
    starts = Loose(tracks.stamp[first], tracks.position[first], motion[1])
    joins = [
        Join(int(ids[end]), int(ids[start]), float(starts.stamp[start] - ends.stamp[end]))
        for end, start in zip(*assign(ends, starts, options))
    ]
    joins.sort(key=lambda join: (tracks.stamp[first[np.searchsorted(ids, join.new)]], join.new))
    # In order of time, so that the track gone on has its final name already.
    name = {int(id): int(id) for id in np.unique(tracks.id)}
    for join in joins:
        name[join.new] = name[join.old]
    return np.array([name[id] for id in tracks.id.tolist()], np.int64), joins


def _fill(tracks: Tracks, fill: float) -> Tracks:
    """Points in gaps up to `fill` seconds, where frames of the recording are or would be."""
    frames = np.unique(tracks.stamp)
    if len(frames) < 2:
        return tracks
    step = float(np.median(np.diff(frames)))
    gap = np.diff(tracks.stamp)
    lost = (np.diff(tracks.id) == 0) & (gap > 1.5 * step) & (gap <= fill + SNAP)
    row = np.flatnonzero(lost)
    pieces = np.rint(gap[row] / step).astype(int)
    row, pieces = np.repeat(row, pieces - 1), np.repeat(pieces, pieces - 1)
    nth = np.arange(len(row)) - np.searchsorted(row, row) + 1
    weight = nth / pieces
    stamp = tracks.stamp[row] + weight * gap[row]
    # The stamps of others, where there are any: a frame must not become two by rounding.
    nearest = np.clip(np.searchsorted(frames, stamp), 1, len(frames) - 1)
    nearest -= stamp - frames[nearest - 1] < frames[nearest] - stamp
    stamp = np.where(np.abs(frames[nearest] - stamp) <= step / 4, frames[nearest], stamp)
    weight = ((stamp - tracks.stamp[row]) / gap[row])[:, None]
    position = tracks.position[row] + weight * (tracks.position[row + 1] - tracks.position[row])
    return make_tracks(
        tracks.recording,
        np.concatenate([tracks.stamp, stamp]),
        np.concatenate([tracks.id, tracks.id[row]]),
        np.concatenate([tracks.position, position]),
        np.concatenate([tracks.imputed, np.ones(len(row), bool)]),
    )


def _rows(tracks: Tracks, ids: np.ndarray, keep: np.ndarray | slice = slice(None)) -> Tracks:
    """The rows `keep`, under new ids."""
    return make_tracks(
        tracks.recording,
        tracks.stamp[keep],
        ids[keep],
        tracks.position[keep],
        tracks.imputed[keep],
    )


def inside(position: np.ndarray, polygon: ArrayLike) -> np.ndarray:
    """[R] bool, which of `position [R, 2]` lie inside the polygon with corners `[P, 2]`.

    Raises:
        InputError: where the polygon is not at least three finite corners.
    """
    corners = np.asarray(polygon, np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
        raise InputError(f"a polygon is at least three corners [P, 2], not {list(corners.shape)}")
    if not np.isfinite(corners).all():
        raise InputError("a polygon's corners must be finite")
    odd = np.zeros(len(position), bool)
    x, y = position.T
    # A ray to the right crosses the outline an odd number of times.
    for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0)):
        if y0 != y1:
            odd ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return odd
