"""Draws of scenes from each person's points, in numpy: `models.anchors.draws` without JAX.

The formulas are those of that module, and a test compares the draws. Pairs who cannot
meet, and do not walk together, are left out beforehand.
"""

from typing import Any, NamedTuple

import numpy as np

from neurosym_jax.models.anchors.pair_constants import (
    COHESION,
    COMPANY,
    DISTANCE,
    FAR,
    NEAREST,
    REPULSION,
    SWEEPS,
)
from neurosym_jax.models.tracking_errors import repair_tracks

SLACK = 0.05
"""Metres for errors of rounding, where pairs that cannot meet are left out."""
PART = 4
"""Pairs of people whose points are compared at once."""


class Term(NamedTuple):
    """What another person's point says about a person's."""

    other: int
    cost: np.ndarray
    """[P, P] nats by which each point of the other (first axis) makes each of the person's
    (second) less probable."""


def even_lots(seed: int, people: int, count: int) -> np.ndarray:
    """[1 + SWEEPS, people, count] numbers in [0, 1): one in each `count`-th part of it."""
    rng = np.random.default_rng(seed)
    shape = (1 + SWEEPS, people, count)
    part = rng.random(shape).argsort(axis=-1)
    within = rng.random(shape)
    lots = (part + within) / count
    return np.minimum(lots, 1 - 1e-6)


def draw_scenes(
    points: np.ndarray, observed: np.ndarray, lots: np.ndarray, period: float
) -> np.ndarray:
    """[n, N, T, 2] equally probable futures of a scene, by random numbers.

    Args:
        points: [P, N, T, 2] equally probable futures of each person alone, metres.
        observed: [N, obs_len, 2] metres.
        lots: [1 + SWEEPS, N, n] of `even_lots`.
        period: of a step, seconds.
    """
    first, *sweeps = lots
    chosen = (first.T * len(points)).astype(int)
    terms = pair_terms(points.astype(np.float32), observed, period)
    for sweep in sweeps:
        for person, others in terms.items():
            chosen[:, person] = _chosen_anew(chosen, others, sweep[person])
    people = np.arange(points.shape[1])
    return points[chosen, people]


def _chosen_anew(
    chosen: np.ndarray, others: list[Term], lots: np.ndarray
) -> np.ndarray:
    """[n] points of one person by `lots [n]`, given those `chosen [n, N]` of the others."""
    cost: Any = 0
    for term in others:
        points = chosen[:, term.other]
        cost = cost + term.cost[points]  # [n, P]
    least = cost.min(axis=1, keepdims=True)
    share = np.exp(least - cost)
    ends = share.cumsum(axis=1)
    place = lots[:, None] * ends[:, -1:]
    return (ends[:, :-1] <= place).sum(axis=1)


def pair_terms(
    points: np.ndarray, observed: np.ndarray, period: float
) -> dict[int, list[Term]]:
    """By person who depends on somebody, what the others' points say."""
    repair = repair_tracks(observed, period)
    near = nearest(points)
    together = np.where(near, companionship(repair.tracks, period), 0)
    total = np.maximum(together.sum(axis=1), 1)
    # Of a stream of people, all hold a person as one companion does.
    together /= np.maximum(total[:, None], total)
    may_act = can_meet(points) | (together > 0)
    related = near & may_act

    # Two who are related are compared once.
    either = related | related.T
    first, second = np.nonzero(np.triu(either, 1))
    overlap = overlaps(points, first, second)
    start = repair.offset + repair.tracks[:, -1]
    moved = points - start[:, None]
    parted = partings(moved, first, second) / FAR
    overlap_cost = REPULSION * overlap
    parting_cost = COHESION * np.minimum(parted, 1)

    terms: dict[int, list[Term]] = {}
    pairs = zip(first.tolist(), second.tolist())
    for pair, (one, other) in enumerate(pairs):
        for person, companion in ((one, other), (other, one)):
            if not related[person, companion]:
                continue
            hold = together[person, companion]
            cost = overlap_cost[pair] + hold * parting_cost[pair]
            if not cost.any():
                continue
            if person == other:
                cost = cost.T
            terms.setdefault(person, []).append(Term(companion, cost))
    return dict(sorted(terms.items()))


def nearest(points: np.ndarray) -> np.ndarray:
    """[N, N] bool, who is among the `NEAREST` others to the mean path of each person."""
    paths = points.mean(axis=0)
    offset = paths[:, None] - paths
    square = np.square(offset).sum(axis=-1)
    gap = square.min(axis=-1)
    np.fill_diagonal(gap, np.inf)
    order = np.argsort(gap, axis=1, kind="stable")[:, :NEAREST]
    near = np.zeros(gap.shape, bool)
    np.put_along_axis(near, order, True, axis=1)
    np.fill_diagonal(near, False)
    return near


def companionship(observed: np.ndarray, period: float) -> np.ndarray:
    """[N, N] how much people `observed [N, obs_len, 2]` walk together, 0 to 1."""
    last = observed[:, -1]
    velocity = (last - observed[:, -4]) / (3 * period)
    distance, difference = COMPANY
    offset = (last[:, None] - last) / distance
    change = (velocity[:, None] - velocity) / difference
    square = np.square(offset).sum(axis=-1) + np.square(change).sum(axis=-1)
    together = np.exp(-square)
    return np.where(together > 0.02, together, 0)


def can_meet(points: np.ndarray) -> np.ndarray:
    """[N, N] bool, whether boxes around the ways of two people come within `DISTANCE`."""
    low, high = points.min(axis=0), points.max(axis=0)  # [N, T, 2]
    # A box holds the way from the step before, too.
    earlier_low = low[:, :-1].copy()
    earlier_high = high[:, :-1].copy()
    low[:, 1:] = np.minimum(low[:, 1:], earlier_low)
    high[:, 1:] = np.maximum(high[:, 1:], earlier_high)
    gap = np.maximum(low[:, None] - high, low - high[:, None])
    gap = np.maximum(gap, 0)
    square = np.square(gap).sum(axis=-1)
    return (square < DISTANCE**2).any(axis=-1)


def partings(moved: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[L, P, P] metres by which the offset of two people changes, root mean square over steps.

    Of each point of the `second [L]` (second axis) and the `first [L]`; `moved [P, N, T,
    2]` are from the last position.
    """
    count, people, steps, _ = moved.shape
    ways = moved.swapaxes(0, 1).reshape(people, count, -1)
    square = np.square(ways).sum(axis=-1)
    gap = _square_gaps(ways[second], ways[first], square[second], square[first])
    return np.sqrt(np.maximum(gap, 0) / steps)


def overlaps(points: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[L, P, P] how far each point of the `second [L]` (second axis) and the `first` overlap.

    `points` are [P, N, T, 2] metres. Between two steps, offsets change along a straight
    line.
    """
    ways = points.transpose(1, 2, 0, 3)  # [N, T, P, 2]
    square = np.square(ways).sum(axis=-1)
    hops = np.linalg.norm(np.diff(ways, axis=1), axis=-1)
    hop = hops.max(axis=1, initial=0.0)  # [N, P] the longest of a point
    steps = points.transpose(3, 2, 1, 0)  # [2, T, N, P]
    count = len(points)
    overlap = np.zeros((len(first), count, count), points.dtype)
    # In parts that stay in the cache.
    for begin in range(0, len(first), PART):
        part = slice(begin, begin + PART)
        left, right = first[part], second[part]
        gap = _square_gaps(ways[right], ways[left], square[right], square[left])
        least_gap = gap.min(axis=1)
        # Between two steps they come no nearer than by half of what both go.
        both = hop[right][:, :, None] + hop[left][:, None]
        reach = DISTANCE + both / 2 + SLACK
        pair, row, column = np.nonzero(least_gap < np.square(reach))
        own = steps[:, :, left[pair], column]
        others = steps[:, :, right[pair], row]
        x, y = own - others
        distance = np.sqrt(_least_square(x, y))
        share = 1 - distance / DISTANCE
        overlap[begin + pair, row, column] = np.maximum(share, 0)
    return overlap


def _square_gaps(
    one: np.ndarray, other: np.ndarray, one_square: np.ndarray, other_square: np.ndarray
) -> np.ndarray:
    """[..., P, Q] square distances of points `one [..., P, D]` and `other [..., Q, D]`.

    `one_square [..., P]` and `other_square [..., Q]` are their square lengths.
    """
    product = one @ other.swapaxes(-1, -2)
    squares = one_square[..., None] + other_square[..., None, :]
    return squares - 2 * product


def _least_square(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """[C] least square of offsets `x [T, C]`, `y [T, C]` that change along straight lines.

    Steps come first, because numpy is slow over short last axes.
    """
    start = np.square(x[0]) + np.square(y[0])
    dx = x[:-1] - x[1:]
    dy = y[:-1] - y[1:]
    x, y = x[1:], y[1:]
    # The share of the way back to the step before at which they are nearest.
    along = x * dx + y * dy
    length = dx * dx + dy * dy + 1e-12
    back = np.clip(-along / length, 0, 1)
    closest = np.square(x + back * dx) + np.square(y + back * dy)
    least = closest.min(axis=0, initial=np.inf)
    return np.minimum(least, start)
