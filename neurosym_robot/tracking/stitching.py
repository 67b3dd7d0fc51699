"""Stitching of a recording: tracks joined across occlusions, swapped ids corrected, gaps filled.

`live.OnlineStitcher` does it frame by frame. Tracks whose ids were decided by hand are not joined.
"""

import dataclasses
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from neurosym_jax.data.tracks import SNAP, Tracks
from neurosym_jax.errors import InputError
from neurosym_robot.tracking.following import Follower, Track
from neurosym_robot.tracking.linking import LinkOptions, TrackEnds, assign, link_costs, velocity
from neurosym_robot.tracking.live import NOBODY

__all__ = ["LOOKING_BACK", "Join", "Stitched", "inside", "stitch", "stitched_ids"]

# A ghost can be told from a person later than live, where everybody waits.
LOOKING_BACK = LinkOptions(least=1.0)


class Join(NamedTuple):
    """The track `new` continues the track `old` after `gap` seconds."""

    old: int
    new: int
    gap: float  # seconds


@dataclasses.dataclass(frozen=True, eq=False)
class Stitched:
    """A stitched recording and what was done to it."""

    tracks: Tracks
    before: int  # ids before
    joins: list[Join]
    outside: int  # rows outside the map, dropped
    ghosts: int  # rows of tracks shorter than `least`, or far away, dropped
    filled: int  # rows added, by interpolation


def stitch(
    tracks: Tracks,
    options: LinkOptions = LOOKING_BACK,
    *,
    fill: float = 2.0,
    polygon: ArrayLike | None = None,
    ids: Mapping[int, int] | None = None,
) -> Stitched:
    """Mend a recording.

    Args:
        tracks: of the recording.
        options: when two tracks are joined.
        fill: gaps up to this many seconds are filled linearly, at the recording's own rate.
        polygon: [P, 2] metres, corners of the map; rows outside are dropped first.
        ids: new id of an old one, decided by hand.

    Raises:
        InputError: if no row is inside the map, for an invalid polygon, or if `ids` gives two
            people the same id at one time.
    """
    if not fill >= 0:
        raise InputError(f"fill must not be negative, not {fill}")
    before, rows = len(np.unique(tracks.id)), len(tracks.id)
    if polygon is not None:
        keep = inside(tracks.position, polygon)
        if not keep.any():
            raise InputError(f"{tracks.recording}: nobody is inside the map")
        tracks = tracks.take(keep)
    outside = rows - len(tracks.id)
    pinned: set[int] = set()
    if ids:
        pinned = {ids[old] for old in set(tracks.id.tolist()) if old in ids}
        tracks = tracks.with_ids(np.array([ids.get(id, id) for id in tracks.id.tolist()]))
    label, joins = stitched_ids(tracks, options, pinned)
    there = label != NOBODY
    if not there.any():
        raise InputError(
            f"{tracks.recording}: nobody is seen for {options.least} s (--links.least)"
        )
    tracks = tracks.take(there).with_ids(label[there])
    mended = _fill(tracks, fill)
    ghosts = int((~there).sum())
    return Stitched(mended, before, joins, outside, ghosts, len(mended.id) - len(tracks.id))


def stitched_ids(
    tracks: Tracks, options: LinkOptions = LOOKING_BACK, pinned: Collection[int] = ()
) -> tuple[np.ndarray, list[Join]]:
    """Mended ids [R] of the rows, `NOBODY` for ghosts, and the joins; `pinned` ids stay."""
    label = _follow(tracks, options, pinned)
    order = np.lexsort((tracks.stamp, label))
    label, stamp, position = label[order], tracks.stamp[order], tracks.position[order]
    ids, first, count = np.unique(label, return_index=True, return_counts=True)
    last = first + count - 1
    short = (stamp[last] - stamp[first] < options.least - SNAP) | (ids == NOBODY)
    ghost = short & ~np.isin(ids, list(pinned))
    free = np.flatnonzero(~short & ~np.isin(ids, list(pinned)))
    motion = np.zeros((2, len(free), 2))
    for n, (head, tail) in enumerate(zip(first[free], last[free])):
        at, xy = stamp[head : tail + 1], position[head : tail + 1]
        for side, end in enumerate((at[-1], at[0])):
            near = np.abs(at - end) <= options.memory + SNAP
            motion[side, n] = velocity(at[near], xy[near])
    ends = TrackEnds(stamp[last[free]], position[last[free]], motion[0])
    starts = TrackEnds(stamp[first[free]], position[first[free]], motion[1])
    links = [
        (free[end], free[start]) for end, start in zip(*assign(link_costs(ends, starts, options)))
    ]
    joins = [
        Join(int(ids[end]), int(ids[start]), float(stamp[first[start]] - stamp[last[end]]))
        # In order of time, so that the track gone on has its final name already.
        for end, start in sorted(links, key=lambda link: stamp[first[link[1]]])
    ]
    name = {int(id): NOBODY if gone else int(id) for id, gone in zip(ids, ghost)}
    for join in joins:
        name[join.new] = name[join.old]
    mended = np.empty_like(label)
    mended[order] = [name[id] for id in label.tolist()]
    return mended, joins


def _follow(tracks: Tracks, options: LinkOptions, pinned: Collection[int]) -> np.ndarray:
    """[R] an id for each unbroken track: the tracker's, or a new one if that is taken."""
    label, used = tracks.id.copy(), set(tracks.id.tolist())
    follower = Follower(options.max_gap, len(label))
    names: dict[Track, int] = {}
    taken: set[int] = set()
    rows = np.flatnonzero(~np.isin(tracks.id, list(pinned)))
    rows = rows[np.lexsort((tracks.id[rows], tracks.stamp[rows]))]
    for here in np.split(rows, np.flatnonzero(np.diff(tracks.stamp[rows])) + 1):
        if not len(here):
            continue
        ids = tracks.id[here].tolist()
        found = follower.push(float(tracks.stamp[here[0]]), ids, tracks.position[here])
        for row, id, track in zip(here, ids, found):
            if track is None:
                label[row] = NOBODY
                continue
            if track not in names:
                names[track] = id if id not in taken else max(used) + 1
                used.add(names[track])
                taken.add(names[track])
            label[row] = names[track]
    return label


def _fill(tracks: Tracks, fill: float) -> Tracks:
    """Fill gaps of up to `fill` seconds at the times of the recording's frames."""
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
    # Snap to existing stamps, so that rounding does not make two frames of one.
    nearest = np.clip(np.searchsorted(frames, stamp), 1, len(frames) - 1)
    nearest -= stamp - frames[nearest - 1] < frames[nearest] - stamp
    stamp = np.where(np.abs(frames[nearest] - stamp) <= step / 4, frames[nearest], stamp)
    weight = ((stamp - tracks.stamp[row]) / gap[row])[:, None]
    position = tracks.position[row] + weight * (tracks.position[row + 1] - tracks.position[row])
    known = tracks.known
    # An added row has the extras of the row before the gap.
    both = dataclasses.replace(
        tracks.take(np.append(np.arange(len(tracks.id)), row)),
        stamp=np.append(tracks.stamp, stamp),
        position=np.append(tracks.position, position, axis=0),
        known=None if known is None else np.append(known, known[row + 1]),
    )
    return both.with_ids(both.id)


def inside(position: np.ndarray, polygon: ArrayLike) -> np.ndarray:
    """[R] bool: which of `position [R, 2]` lie inside the polygon with corners `[P, 2]`."""
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
