"""Collisions between people in forecasts and in the truth.

Few of a crowd's pairs come near each other, and which ones depends on the numbers; so this works on
the host, where pairs whose bounding boxes lie apart are dropped before anything else is computed.
"""

import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.scene import Scene

__all__ = ["COLLISION_DISTANCE", "collisions"]

COLLISION_DISTANCE = 0.2
"""Distance between two people's centres below which they collide, metres."""
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
    low, high = paths.min(axis=0), paths.max(axis=0) + REACH
    sizes = valid.sum(axis=1)
    pairs = [np.triu_indices(size, 1) for size in sizes]
    starts = np.repeat(np.cumsum(sizes) - sizes, [len(one) for one, _ in pairs])
    one, other = np.concatenate(pairs, axis=1) + starts
    # First the boxes around all samples of a pair, then those of each.
    near = _meet(low.min(axis=-1), high.max(axis=-1), one, other)
    one, other = one[near], other[near]
    pair, sample = np.nonzero(_meet(low, high, one, other))
    ends = np.stack([one[pair], other[pair]]) * len(forecast) + sample
    flat = paths.reshape(*paths.shape[:2], -1)
    close = _collide(flat.take(ends[0], axis=2) - flat.take(ends[1], axis=2))
    hit = np.zeros((paths.shape[2], len(forecast)), bool)
    hit.reshape(-1)[ends[:, close]] = True
    found = np.zeros(forecast.shape[:3], bool)
    found[:, valid] = hit.T
    return found


def _meet(low: np.ndarray, high: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """[P, ...] whether boxes from `low [2, A, ...]` to `high` overlap."""
    meet = (low[:, one] < high[:, other]) & (low[:, other] < high[:, one])
    return meet[0] & meet[1]


def _collide(offset: np.ndarray) -> np.ndarray:
    """[C] whether paths whose offset is `offset [T, 2, C]` come too close."""
    end = np.square(offset[-1]).sum(axis=0)
    # The offset moves along a segment; its nearest point to zero is at `t` in [0, 1].
    x, y = offset[:-1].swapaxes(0, 1)
    dx, dy = (offset[1:] - offset[:-1]).swapaxes(0, 1)
    # The smallest positive number, for an offset that stays.
    length = np.maximum(dx**2 + dy**2, np.finfo(offset.dtype).tiny)
    t = np.clip(-(x * dx + y * dy) / length, 0, 1)
    nearest = ((x + t * dx) ** 2 + (y + t * dy) ** 2).min(axis=0, initial=np.inf)
    return np.minimum(end, nearest) < COLLISION_DISTANCE**2


def rate(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] share of samples in which an agent collides; `forecast [k, B, N, T, 2]`."""
    return _of_batch(forecast, np.asarray(scene.valid)).mean(axis=0)


def truth_rate(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] whether an agent collides in the truth; `forecast [k, B, N, T, 2]`."""
    return rate(np.asarray(scene.known_future)[None], scene)


def excess(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] `rate` less `truth_rate`; `forecast [k, B, N, T, 2]`."""
    return rate(forecast, scene) - truth_rate(forecast, scene)
