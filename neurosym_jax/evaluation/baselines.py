"""Constant velocity, plain and sampled: the forecasts every model has to beat.

Schöller et al., "What the Constant Velocity Model Can Teach Us About Pedestrian Motion Prediction"
(RA-L 2020). Both have the signature of `forecast.GeneratorForecast` and need no parameters.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.forecast import scene_key
from neurosym_jax.scene import Scene

__all__ = ["HEADING_STD", "ConstantVelocity", "ConstantVelocitySampled"]

HEADING_STD = math.radians(25.0)
"""Standard deviation of the sampled heading, radians (Schöller et al.)."""


@dataclasses.dataclass(frozen=True)
class ConstantVelocity:
    """Everybody repeats the last observed step: one forecast, whatever `samples` says."""

    pred_len: int

    def __call__(self, params: Any, scene: Scene, key: Array, samples: int) -> Array:
        """`[1, N, pred_len, 2]` metres relative to the scene's origin."""
        del params, key, samples
        return _extrapolate(scene.observed[:, -1], scene.displacement[:, -1], self.pred_len)[None]


@dataclasses.dataclass(frozen=True)
class ConstantVelocitySampled:
    """Constant velocity, each agent's heading turned by its own Gaussian angle in each sample."""

    pred_len: int

    def __call__(self, params: Any, scene: Scene, key: Array, samples: int) -> Array:
        """`[samples, N, pred_len, 2]` metres relative to the scene's origin."""
        del params
        key = scene_key(key, scene.identity)
        fold = jax.vmap(jax.random.fold_in, in_axes=(None, 0))
        slots = jnp.arange(scene.valid.shape[0])
        keys = jax.vmap(fold, in_axes=(0, None))(fold(key, jnp.arange(samples)), slots)
        angle = HEADING_STD * jax.vmap(jax.vmap(jax.random.normal))(keys)
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        x, y = scene.displacement[:, -1, 0], scene.displacement[:, -1, 1]
        step = jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        return _extrapolate(scene.observed[:, -1], step, self.pred_len)


def _extrapolate(position: Array, step: Array, pred_len: int) -> Array:
    """`position [N, 2]` moved by 1 .. pred_len times `step [..., N, 2]`: [..., N, pred_len, 2]."""
    steps = jnp.arange(1, pred_len + 1, dtype=position.dtype)
    return position[:, None] + steps[:, None] * step[..., None, :]
