"""The agents of many padded scenes as one scene without padding, worked on in parts of one size.

Work that looks at no neighbour can take them so: nothing is computed for padding, and a single
compiled program serves scenes of every size.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.scene import Scene

__all__ = ["PART", "in_parts", "pack_agents"]

PART = 256
"""Agents decoded in one call: with 20 samples their states stay in the second-level cache."""


def pack_agents(scenes: Scene, noise: np.ndarray) -> tuple[Scene, np.ndarray]:
    """The valid agents of a batch as one scene of A agents, and their noise `[k, A, dim]`."""
    valid = np.asarray(scenes.valid)
    if noise.ndim == 3:
        noise = np.broadcast_to(
            noise[:, :, None], (*noise.shape[:2], valid.shape[1], noise.shape[2])
        )
    agents = jax.tree.map(lambda leaf: np.asarray(leaf)[valid], scenes.replace(identity=None))
    return agents, noise[:, valid]


def in_parts(forecast: Callable[[Any, Any], Array], agents: Any, noise: np.ndarray) -> np.ndarray:
    """`forecast(agents, noise)` in parts of `PART` agents: `[k, A, pred_len, 2]`.

    `agents` are arrays with a leading axis of A agents, `noise` is `[k, A, dim]`.
    """
    count = noise.shape[1]
    parts = []
    for at in range(0, max(count, 1), PART):
        short = max(0, at + PART - count)

        def part(leaf: np.ndarray, axis: int, at: int = at, short: int = short) -> np.ndarray:
            index = (slice(None),) * axis + (slice(at, at + PART),)
            widths = [(0, short if dim == axis else 0) for dim in range(leaf.ndim)]
            return np.pad(leaf[index], widths) if short else leaf[index]

        futures = forecast(jax.tree.map(lambda leaf: part(leaf, 0), agents), part(noise, 1))
        parts.append(np.asarray(futures)[:, : PART - short])
    return np.concatenate(parts, axis=1)
