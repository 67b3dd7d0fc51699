"""The agents of many padded scenes as one scene without padding, worked on in parts of one size.

Work that looks at no neighbour can take them so: nothing is computed for padding, and a single
compiled program serves scenes of every size.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.scene import Scene

__all__ = ["PART", "Map", "in_parts", "pack_agents", "unpacked"]

PART = 128
"""Agents decoded in one call: with 20 samples their states stay in the second-level cache."""

Map = Callable[..., Iterable[Any]]
"""`map`, or that of an executor, whose calls may then run at once."""


def pack_agents(scenes: Sequence[Scene], noises: Sequence[np.ndarray]) -> tuple[Scene, np.ndarray]:
    """The valid agents of some batches as one scene of A agents, and their noise `[k, A, dim]`.

    A noise is `[k, B, dim]` or, per agent, `[k, B, N, dim]` for its batch of B scenes of N slots.
    """
    masks = [np.asarray(batch.valid) for batch in scenes]
    without = [batch.replace(identity=None, origin=None, future=None) for batch in scenes]
    agents = jax.tree.map(
        lambda *leaves: np.concatenate([leaf[mask] for leaf, mask in zip(leaves, masks)]), *without
    )
    parts = [
        noise[:, mask] if noise.ndim == 4 else np.repeat(noise, mask.sum(axis=1), axis=1)
        for noise, mask in zip(noises, masks)
    ]
    return agents, np.concatenate(parts, axis=1)


def in_parts(
    forecast: Callable[[Any, Any], Array], agents: Any, noise: np.ndarray, run: Map = map
) -> np.ndarray:
    """`forecast(agents, noise)` in parts of `PART` agents: `[k, A, pred_len, 2]`.

    Args:
        forecast: from a part of `agents` and of `noise` to `[k, PART, pred_len, 2]`.
        agents: arrays with a leading axis of A agents, A >= 1.
        noise: [k, A, dim].
        run: applies a function to every part.
    """
    count = noise.shape[1]

    def of_part(at: int) -> np.ndarray:
        short = max(0, at + PART - count)

        def part(leaf: np.ndarray, axis: int) -> np.ndarray:
            taken = leaf[(slice(None),) * axis + (slice(at, at + PART),)]
            widths = [(0, short if dim == axis else 0) for dim in range(leaf.ndim)]
            return np.pad(taken, widths) if short else taken

        futures = forecast(jax.tree.map(lambda leaf: part(leaf, 0), agents), part(noise, 1))
        return np.asarray(futures)[:, : PART - short]

    return np.concatenate(list(run(of_part, range(0, count, PART))), axis=1)


def unpacked(futures: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """`futures [k, A, ...]` in their places `valid [B, N]`: `[k, B, N, ...]`, elsewhere zero."""
    places = np.zeros((len(futures), *valid.shape, *futures.shape[2:]), futures.dtype)
    places[:, valid] = futures
    return places
