"""Baselines to beat: constant velocity, plain and with sampled headings.

Schöller et al., "What the Constant Velocity Model Can Teach Us About Pedestrian Motion
Prediction" (RA-L 2020).
"""

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from neurosym_jax.models.forecaster import NoiseSpec, TwoStageForecaster
from neurosym_jax.scene import AnyArray, Scene

__all__ = ["HEADING_STD", "ConstantVelocity", "ConstantVelocitySampled"]

HEADING_STD = math.radians(25.0)
"""Standard deviation of the sampled heading, radians (Schöller et al.)."""


@dataclasses.dataclass(frozen=True)
class ConstantVelocity(TwoStageForecaster):
    """Every agent repeats its last observed step: one forecast."""

    @property
    def title(self) -> str:
        """What tables call it."""
        return "constant velocity"

    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """`[k, N, pred_len, 2]`, the same for every sample; `params` and `context` are empty."""
        step = jnp.broadcast_to(
            scene.displacement[:, -1], (len(noise), *scene.valid.shape, 2)
        )
        return _extrapolate(scene.observed[:, -1], step, self.pred_len)


@dataclasses.dataclass(frozen=True)
class ConstantVelocitySampled(TwoStageForecaster):
    """Constant velocity, each agent's heading turned by its own Gaussian angle in each sample."""

    @property
    def title(self) -> str:
        """What tables call it."""
        return "constant velocity, sampled"

    @property
    def noise(self) -> NoiseSpec:
        """One standard normal number for each agent."""
        return NoiseSpec(dim=1, per_agent=True)

    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """`[k, N, pred_len, 2]`; `params` and `context` are empty."""
        angle = HEADING_STD * noise[..., 0]
        cos = jnp.cos(angle)
        sin = jnp.sin(angle)
        x, y = scene.displacement[:, -1, 0], scene.displacement[:, -1, 1]
        step = jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        return _extrapolate(scene.observed[:, -1], step, self.pred_len)


def _extrapolate(position: AnyArray, step: Array, pred_len: int) -> Array:
    """`position [N, 2]` moved by 1 .. pred_len times `step [k, N, 2]`: [k, N, pred_len, 2]."""
    steps = jnp.arange(1, pred_len + 1, dtype=position.dtype)
    return jnp.asarray(position)[:, None] + steps[:, None] * step[..., None, :]
