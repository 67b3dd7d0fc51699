"""Collisions between people in forecasts and in the truth.

Few of a crowd's pairs come near each other, and which ones depends on the numbers; so this works on
the host, where pairs whose bounding boxes lie apart are dropped before anything else is computed.
"""

import functools
from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.scene import Scene

__all__ = ["COLLISION_DISTANCE", "collisions"]

COLLISION_DISTANCE = 0.2
"""Distance between two people's centres below which they collide, metres."""

PAIRS, PATHS = 2**14, 2**12
"""Pairs, and pairs in one sample, processed together: their arrays stay in the caches."""

REACH = COLLISION_DISTANCE + 1e-3
"""Distance between boxes, m, beyond which no collision is possible, rounding included."""


def collisions(forecast: ArrayLike, valid: ArrayLike) -> np.ndarray:
    """Find agents that come closer than `COLLISION_DISTANCE` to another in the same sample.

    Between time steps agents move in straight lines, so that fast crossings count.

    Args:
        forecast: [k, N, T, 2] metres.
        valid: [N] bool.

    Returns:
        [k, N] bool.
    """
    return _of_batch(np.asanyarray(forecast)[:, None], np.asarray(valid)[None])[:, 0]


def _of_batch(forecast: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """[k, B, N] bool; `forecast [k, B, N, T, 2]`, `valid [B, N]`."""
    # Samples last, so that a pair is a contiguous row.
    paths = forecast[:, valid].transpose(2, 3, 1, 0).copy()  # [T, 2, A, k]
    hit = np.zeros((paths.shape[2], len(forecast)), bool)
    if hit.size:
        low, high = paths.min(axis=0), paths.max(axis=0)  # [2, A, k]
        widest = low.min(axis=-1), high.max(axis=-1)
        flat = paths.reshape(*paths.shape[:2], -1)
        pairs = _pairs(valid.sum(axis=1).tolist())
        for at in range(0, pairs.shape[1], PAIRS):
            # First the boxes around all samples of a pair, then those of each.
            one, other = some = pairs[:, at : at + PAIRS]
            one, other = some[:, _meet(*widest, one, other)]
            pair, sample = np.nonzero(_meet(low, high, one, other))
            ends = np.stack([one[pair], other[pair]]) * hit.shape[1] + sample
            for begin in range(0, ends.shape[1], PATHS):
                near = ends[:, begin : begin + PATHS]
                hit.reshape(-1)[near[:, _collide(flat, *near)]] = True
    found = np.zeros(forecast.shape[:3], bool)
    found[:, valid] = hit.T
    return found


def _pairs(sizes: Sequence[int]) -> np.ndarray:
    """[2, P] agents of each unordered pair, for scenes of these sizes one after the other."""
    starts = np.cumsum([0, *sizes[:-1]])
    return np.concatenate([_of_scene(size) + at for size, at in zip(sizes, starts)], axis=1)


@functools.lru_cache(maxsize=256)
def _of_scene(size: int) -> np.ndarray:
    return np.stack(np.triu_indices(size, 1))


def _meet(low: np.ndarray, high: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """[P, ...] whether boxes from `low [2, A, ...]` to `high` come within `REACH`."""
    high = high + REACH
    x, y = (
        (low[axis][one] < high[axis][other]) & (low[axis][other] < high[axis][one])
        for axis in (0, 1)
    )
    return x & y


def _collide(paths: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """[C] whether two of `paths [T, 2, P]` come too close."""
    offset = paths.take(one, axis=2)
    offset -= paths.take(other, axis=2)
    end = np.square(offset[-1]).sum(axis=0)
    # The offset moves along a segment; its nearest point to zero is at `t` in [0, 1].
    (x, y), (dx, dy) = (part.swapaxes(0, 1) for part in (offset[:-1], offset[1:] - offset[:-1]))
    # The smallest positive number, for an offset that stays.
    length = np.maximum(dx**2 + dy**2, np.finfo(paths.dtype).tiny)
    t = x * dx
    t += y * dy
    t /= -length
    np.clip(t, 0, 1, out=t)
    dx *= t
    dx += x
    dy *= t
    dy += y
    nearest = (dx**2 + dy**2).min(axis=0, initial=np.inf)
    return np.minimum(end, nearest) < COLLISION_DISTANCE**2


def rate(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] share of samples in which an agent collides."""
    return _of_batch(forecast, np.asarray(scene.valid)).mean(axis=0)


def truth_rate(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] whether an agent collides in the truth."""
    return rate(np.asarray(scene.known_future)[None], scene)


def excess(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] `rate` less `truth_rate`."""
    return rate(forecast, scene) - truth_rate(forecast, scene)
