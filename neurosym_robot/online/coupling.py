"""Draws of scenes from each person's points, in numpy: `models.anchors.draws` without JAX.

The formulas are those of that module, and a test compares the draws. Pairs who cannot
meet, and do not walk together, are left out beforehand.
"""

from typing import NamedTuple

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
    return np.minimum((part + rng.random(shape)) / count, 1 - 1e-6)


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
    chosen = (lots[0].T * len(points)).astype(int)
    terms = pair_terms(points.astype(np.float32), observed, period)
    for sweep in lots[1:]:
        for person, others in terms.items():
            costs = [term.cost[chosen[:, term.other]] for term in others]
            cost = np.sum(costs, axis=0)  # [n, P]
            share = np.exp(cost.min(axis=1, keepdims=True) - cost).cumsum(axis=1)
            place = sweep[person][:, None] * share[:, -1:]
            chosen[:, person] = (share[:, :-1] <= place).sum(axis=1)
    return points[chosen, np.arange(points.shape[1])]


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
    related = near & (can_meet(points) | (together > 0))

    first, second = np.nonzero(np.triu(related | related.T, 1))
    overlap = REPULSION * overlaps(points, first, second)
    moved = points - (repair.offset + repair.tracks[:, -1])[:, None]
    parting = COHESION * np.minimum(partings(moved, first, second) / FAR, 1)
    terms: dict[int, list[Term]] = {}
    for pair, people in enumerate(zip(first.tolist(), second.tolist())):
        for person, companion in (people, people[::-1]):
            if not related[person, companion]:
                continue
            cost = overlap[pair] + together[person, companion] * parting[pair]
            if not cost.any():
                continue
            if person > companion:  # The second of the pair.
                cost = cost.T
            terms.setdefault(person, []).append(Term(companion, cost))
    return dict(sorted(terms.items()))


def nearest(points: np.ndarray) -> np.ndarray:
    """[N, N] bool, who is among the `NEAREST` others to the mean path of each person."""
    paths = points.mean(axis=0)
    gap = np.square(paths[:, None] - paths).sum(axis=-1).min(axis=-1)
    np.fill_diagonal(gap, np.inf)
    order = np.argsort(gap, axis=1, kind="stable")[:, :NEAREST]
    near = np.zeros(gap.shape, bool)
    np.put_along_axis(near, order, True, axis=1)
    np.fill_diagonal(near, False)
    return near


def companionship(observed: np.ndarray, period: float) -> np.ndarray:
    """[N, N] how much people `observed [N, obs_len, 2]` walk together, 0 to 1."""
    velocity = (observed[:, -1] - observed[:, -4]) / (3 * period)
    square = np.zeros(2 * observed.shape[:1])
    for value, scale in zip((observed[:, -1], velocity), COMPANY):
        square += np.square((value[:, None] - value) / scale).sum(axis=-1)
    together = np.exp(-square)
    return np.where(together > 0.02, together, 0)


def can_meet(points: np.ndarray) -> np.ndarray:
    """[N, N] bool, whether boxes around the ways of two people come within `DISTANCE`."""
    low, high = points.min(axis=0), points.max(axis=0)  # [N, T, 2]
    # From each step to the next.
    low[:, 1:] = np.minimum(low[:, 1:], points.min(axis=0)[:, :-1])
    high[:, 1:] = np.maximum(high[:, 1:], points.max(axis=0)[:, :-1])
    gap = np.maximum(low[:, None] - high, low - high[:, None])
    square = np.square(np.maximum(gap, 0)).sum(axis=-1)
    return (square < DISTANCE**2).any(axis=-1)


def partings(moved: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[L, P, P] metres by which the offset of two people changes, root mean square over steps.

    Of each point of the `second [L]` (second axis) and the `first [L]`; `moved [P, N, T,
    2]` are from the last position.
    """
    count, people, steps, _ = moved.shape
    ways = moved.swapaxes(0, 1).reshape(people, count, -1)
    square = np.square(ways).sum(axis=-1)
    product = ways[second] @ ways[first].swapaxes(1, 2)
    gap = square[second][:, :, None] + square[first][:, None] - 2 * product
    return np.sqrt(np.maximum(gap, 0) / steps)


def overlaps(points: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[L, P, P] how far each point of the `second [L]` (second axis) and the `first` overlap.

    `points` are [P, N, T, 2] metres. Between two steps, offsets change along a straight
    line.
    """
    ways = points.transpose(1, 2, 0, 3)  # [N, T, P, 2]
    square = np.square(ways).sum(axis=-1)
    hop = np.linalg.norm(np.diff(ways, axis=1), axis=-1).max(axis=1, initial=0.0)
    steps = points.transpose(3, 2, 1, 0)  # [2, T, N, P]
    overlap = np.zeros((len(first), len(points), len(points)), points.dtype)
    # In parts that stay in the cache.
    for begin in range(0, len(first), PART):
        part = slice(begin, begin + PART)
        left, right = first[part], second[part]
        product = ways[right] @ ways[left].swapaxes(-1, -2)
        gap = square[right][..., None] + square[left][:, :, None] - 2 * product
        # Between two steps they come no nearer than by half of what both go.
        reach = hop[right][:, :, None] + hop[left][:, None]
        reach = DISTANCE + reach / 2 + SLACK
        pair, row, column = np.nonzero(gap.min(axis=1) < np.square(reach))
        offset = steps[:, :, left[pair], column] - steps[:, :, right[pair], row]
        share = 1 - np.sqrt(_least_square(*offset)) / DISTANCE
        overlap[begin + pair, row, column] = np.maximum(share, 0)
    return overlap


def _least_square(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """[C] least square of offsets `x [T, C]`, `y [T, C]` that change along straight lines.

    Steps come first, because numpy is slow over short last axes.
    """
    dx, dy = x[:-1] - x[1:], y[:-1] - y[1:]
    back = -(x[1:] * dx + y[1:] * dy) / (dx * dx + dy * dy + 1e-12)
    back = np.clip(back, 0, 1)
    closest = np.square(x[1:] + back * dx) + np.square(y[1:] + back * dy)
    start = np.square(x[0]) + np.square(y[0])
    return np.minimum(closest.min(axis=0, initial=np.inf), start)
