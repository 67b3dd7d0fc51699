"""Neighbour effect: how far forecasts depend on who else is in the scene.

A pooling whose units are dead forecasts everybody in company as it does alone. The forecasts of
each agent with and without its neighbours, for the same noise, tell.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.scene import Scene

__all__ = ["MOVED", "NEAR", "without_neighbours"]

MOVED = 1e-3
"""Metres; a forecast that moves by no more in any sample and step is unchanged."""
NEAR = 2.0
"""Metres to the nearest neighbour, at the last observed step, within which it should matter."""


def without_neighbours(scenes: Scene, noise: np.ndarray) -> tuple[Scene, np.ndarray]:
    """Each slot of a batch of B scenes as a scene of its own, and the noise of these B N scenes.

    Args:
        scenes: of N slots, with a leading axis B.
        noise: [k, B, dim] of the scenes, or [k, B, N, dim] of their slots.
    """
    slots = scenes.valid.shape[1]

    def of_slots(leaf: Any) -> np.ndarray:
        return np.asarray(leaf).reshape(-1, 1, *leaf.shape[2:])

    identity = np.repeat(np.asarray(scenes.identity), slots, axis=0)
    alone = jax.tree.map(of_slots, scenes.bare().replace(identity=None)).replace(identity=identity)
    if noise.ndim == 3:
        return alone, np.repeat(noise, slots, axis=1)
    return alone, noise.reshape(len(noise), len(identity), 1, -1)


def share(moves: Array, scene: Scene) -> tuple[Array, Array]:
    """[N] bool, whether an agent's forecast moves by more than `MOVED`; `moves [k, N, T, 2]`."""
    return _lengths(moves).max(axis=(0, 2)) > MOVED, _in_company(scene)


def near(moves: Array, scene: Scene) -> tuple[Array, Array]:
    """[N] bool, `share` of the agents whose nearest neighbour is within `NEAR`."""
    last = jnp.asarray(scene.observed)[:, -1]
    others = jnp.asarray(scene.valid) & ~jnp.eye(len(last), dtype=bool)
    closest = jnp.where(others, _lengths(last[:, None] - last), jnp.inf).min(axis=1)
    changed, company = share(moves, scene)
    return changed, company & (closest <= NEAR)


def move(moves: Array, scene: Scene) -> tuple[Array, Array]:
    """[N] mean over samples of the move at the last step."""
    return _lengths(moves[:, :, -1]).mean(axis=0), _in_company(scene)


def _in_company(scene: Scene) -> Array:
    """[N] bool, agents of scenes of two or more."""
    valid = jnp.asarray(scene.valid)
    return valid & (valid.sum() > 1)


def _lengths(vectors: Array) -> Array:
    return jnp.sqrt(jnp.square(vectors).sum(axis=-1))
