"""Grids in time: the phase of each piece of a recording, and interpolation of tracks onto it.

A recording may be annotated every 0.4 s and yet go on a fraction of that later after a
pause, so that no one grid fits all of it. Each piece therefore has a grid of its own,
and nothing crosses from one piece to the next.
"""

import dataclasses
import itertools

import numpy as np

from neurosym_jax.data.tracks import GAP, PERIOD, SNAP, Tracks, common
from neurosym_jax.errors import InputError

__all__ = ["on_grid", "resample"]

DENSE = 100  # largest ratio of grid points to source points; beyond, a mistyped period
NEAR = 2  # periods around a row in which most rows must share its phase to make it a majority
SHIFT = 0.05  # of a period: smaller changes of phase are a rounded or jittering clock


def resample(
    tracks: Tracks, period: float, max_gap: float = 1.0, start: float | None = None
) -> Tracks:
    """Interpolate every track linearly onto a grid of steps of `period`.

    With `start` the grid is `start + n * period`, n = 0, 1, ...; without, each piece of
    the recording has the phase that most of its rows have (see `phases`). A grid point
    within `SNAP` of a source point takes its position bit for bit. Any other lies
    between two source points of the agent at most `max_gap` apart; a longer gap splits
    a track in two under the same id. Extras are those of the last source point.

    An interpolated point depends on the later source point (its stamp is `known`).
    `foreseen` is extrapolated from the earlier ones alone, at their mean velocity over
    the last `period`; `windows` uses it where `known` lies after the observation.

    All times are in seconds.

    Raises:
        InputError: for a period, gap or start that does not suit the recording.
    """
    first = float(tracks.stamp.min()) if start is None else float(start)
    if not (np.isfinite([period, first]).all() and period > 2 * SNAP and max_gap >= 0):
        options = f"period {period}, start {first}, longest gap {max_gap} s"
        raise InputError(f"{tracks.recording}: no usable grid: {options}")
    stamp, position = tracks.stamp, tracks.position
    joined = np.append(np.diff(tracks.id) == 0, False)
    joined[:-1] &= np.diff(stamp) <= max_gap + 2 * SNAP
    if start is None:
        piece, origins = phases(stamp, joined, period)
        joined[:-1] &= np.diff(piece) == 0
    else:
        piece, origins = np.zeros(len(stamp), int), np.array([first])
    origin = origins[piece]
    # Steps of two pieces never follow each other: no window goes across.
    steps = np.floor(np.diff(origins) / period + SNAP) + 2
    base = np.append(0, np.cumsum(steps)).astype(np.int64)
    row, grid, exact = _grid_points(tracks, period, origin, joined)
    grid_stamp = origin[row] + grid * period
    after = np.where(exact, row, row + 1)
    since = grid_stamp - stamp[row]
    weight = np.clip(since / np.where(exact, 1.0, stamp[after] - stamp[row]), 0.0, 1.0)[
        :, None
    ]
    # In this form a standing person stays exactly still, which QTC's zero symbols need.
    between = position[row] + weight * (position[after] - position[row])
    ahead = position[row] + since[:, None] * _velocity(tracks, joined, period)[row]
    filled = int(np.sum(stamp[after] - stamp[row] > GAP * period))
    return dataclasses.replace(
        tracks.take(row),
        reading=tracks.reading and dataclasses.replace(tracks.reading, filled=filled),
        stamp=grid_stamp,
        position=np.where(exact[:, None], position[row], between),
        known=np.where(exact, grid_stamp, stamp[after]),
        foreseen=np.where(exact[:, None], position[row], ahead),
        period=period,
        step=base[piece[row]] + grid.astype(np.int64),
    )


def phases(
    stamp: np.ndarray, joined: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pieces of a recording that one grid of steps of `period` seconds fits, and their grids.

    A piece ends in a pause, in which no track goes on, and where the phase of most rows
    changes. Its phase is that of most rows; where none has a majority, as at 25 frames
    a second, the first that is common, or the last piece's. Rows without a neighbour in
    time have no vote.

    Args:
        stamp: [R] seconds of rows sorted by (agent, stamp).
        joined: [R] bool: the next row continues this one's track.
        period: seconds.

    Returns: [R] number of each row's piece, in order of time, and [P] seconds: a point
        of each grid, at or before the first row of the piece.
    """
    votes = joined | np.append(False, joined[:-1])
    votes = np.flatnonzero(votes) if votes.any() else np.arange(len(stamp))
    votes = votes[np.argsort(stamp[votes], kind="stable")]
    moment = stamp[votes]
    residue, label = _residues(moment, period)
    major = _is_majority(moment, label, period)
    # A pause: no track lasts from before it to after it.
    end = np.where(joined[votes], stamp[np.minimum(votes + 1, len(stamp) - 1)], moment)
    pause = moment[1:] > np.maximum.accumulate(end)[:-1] + SNAP
    rows = np.flatnonzero(major)
    jump = np.abs(np.diff(residue[label[rows]])) / period
    jumps = [
        at
        for at in rows[1:][np.minimum(jump, 1 - jump) > SHIFT]
        if _jumps(stamp, joined, float(moment[at]), period)
    ]
    cuts = np.unique(np.array([0, *(np.flatnonzero(pause) + 1), *jumps, len(votes)]))
    begins, origins = list[float](), list[float]()
    previous = -1
    for low, high in itertools.pairwise(cuts):
        ballot = label[low:high][major[low:high]]
        if 2 * len(ballot) > high - low:
            choice = int(common(ballot))
        else:
            kinds, first, counts = np.unique(
                label[low:high], return_index=True, return_counts=True
            )
            frequent = counts >= counts.max() / 4
            choice = int(kinds[frequent][np.argmin(first[frequent])])
            choice = previous if previous in kinds else choice
        if choice == previous:
            continue
        previous, start = choice, stamp.min() if low == 0 else moment[low]
        example = moment[low:high][label[low:high] == choice][0]
        origins.append(
            float(example - np.ceil((example - start) / period - SNAP) * period)
        )
        begins.append(float(start))
    return np.searchsorted(begins, stamp + SNAP, side="right") - 1, np.array(origins)


def _jumps(stamp: np.ndarray, joined: np.ndarray, moment: float, period: float) -> bool:
    """Whether most of the tracks that go on at a moment change phase there, and not before."""
    over = np.flatnonzero(joined & (stamp < moment))
    over = over[stamp[over + 1] >= moment]
    change, earlier = (
        np.mod((stamp[over + lag] - stamp[over + lag - 1]) / period + SHIFT, 1)
        > 2 * SHIFT
        for lag in (1, 0)
    )
    return bool(np.mean(change & ~earlier) > 0.5) if len(over) else False


def _residues(stamp: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """[K] phases in seconds, each more than `SNAP` from the next, and [R] the number of each
    stamp's; the last may be the first again."""
    residue = np.mod(stamp, period)
    order = np.argsort(residue, kind="stable")
    new = np.diff(residue[order], prepend=-1.0) > 2 * SNAP
    label = np.empty(len(stamp), np.int64)
    label[order] = np.cumsum(new) - 1
    kinds = residue[order][new]
    if kinds[0] + period - residue.max() <= 2 * SNAP:
        label[label == len(kinds) - 1] = 0
    return kinds, label


def _is_majority(stamp: np.ndarray, label: np.ndarray, period: float) -> np.ndarray:
    """[R] bool: whether most of the rows within `NEAR` periods have the phase of a row, and one of
    them at another moment. `stamp` ascends."""
    tick = np.rint((stamp - stamp[0]) / period * 100).astype(np.int64)
    reach = (
        NEAR * 100 - 1
    )  # Else of two phases that alternate, each has 5 of 9 rows around one.
    total = np.searchsorted(tick, tick + reach, "right") - np.searchsorted(
        tick, tick - reach
    )
    key = label * (tick[-1] + 4 * reach) + tick
    ordered = np.sort(key)
    same_phase, now = (
        np.searchsorted(ordered, key + width, "right")
        - np.searchsorted(ordered, key - width)
        for width in (reach, 1)
    )
    return (2 * same_phase > total) & (same_phase > now)


def _grid_points(
    tracks: Tracks, period: float, origin: np.ndarray, joined: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of G grid points its source row, its number n, and whether it lies on that row.

    The grid of a row is `origin [R] + n * period`, n >= 0. A row serves the grid points
    before the next row's or, if it is not `joined` [R] to that, the point that it lies
    on.
    """
    stamp = tracks.stamp
    nearest = np.rint((stamp - origin) / period)
    snaps = np.abs(stamp - (origin + nearest * period)) <= SNAP
    place = np.where(snaps, nearest, (stamp - origin) / period)
    first = np.ceil(place)
    last = np.where(joined, np.append(first[1:], 0.0), np.floor(place) + 1)
    first, last = np.maximum(first, 0), np.maximum(last, 0)
    total = float(np.sum(last - first))
    if not 0 < total <= DENSE * len(stamp):
        points = f"{total:,.0f} points of {len(stamp):,}"
        raise InputError(f"{tracks.recording}: a period of {period:g} s makes {points}")
    count = (last - first).astype(np.int64)
    row = np.repeat(np.arange(len(stamp)), count)
    before = np.cumsum(count) - count
    grid = first[row] + (np.arange(len(row)) - before[row])
    return row, grid, grid == place[row]


def on_grid(tracks: Tracks, period: float = PERIOD, max_gap: float = 1.0) -> Tracks:
    """`tracks` unchanged if they lie on one grid of `period` seconds without a gap, else resampled.

    Raises:
        InputError: for a period or gap that is not a usable number, see `resample`.
    """
    if not 0 < period < np.inf:
        raise InputError(
            f"{tracks.recording}: the period must be positive, not {period}"
        )
    place = (tracks.stamp - tracks.stamp.min()) / period
    steps = np.diff(np.rint(place))[np.diff(tracks.id) == 0]
    if np.all(steps == 1) and np.all(np.abs(place - np.rint(place)) <= SNAP / period):
        return dataclasses.replace(tracks, period=period)
    return resample(tracks, period, max_gap)


def _velocity(tracks: Tracks, joined: np.ndarray, period: float) -> np.ndarray:
    """[R, 2] m/s: mean velocity over the last `period` seconds before each row, since the last gap
    (`joined [R]`: the next row continues this one); zero at the first row."""
    step = np.where(joined[:-1], np.diff(tracks.stamp), 2 * period)
    clock = np.concatenate([[0.0], np.cumsum(step)])  # ascending over all agents
    first = np.maximum.accumulate(
        np.where(np.append(True, ~joined[:-1]), np.arange(len(clock)), 0)
    )
    since = np.searchsorted(clock, clock - period + SNAP, side="right") - 1
    since = np.maximum(since, first)
    span = (tracks.stamp - tracks.stamp[since])[:, None]
    moved = tracks.position - tracks.position[since]
    return np.divide(moved, span, out=np.zeros_like(moved), where=span > 0)
