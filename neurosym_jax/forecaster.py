"""What a forecaster is: k futures of one scene, and where scenes gain their batch axis.

A forecaster is written for one scene, `one(params, scene, noise)`; `batch` maps it over padded
scenes. Equal forecasters are equal to `jax.jit`, so they share compiled programs. Which networks
there are to forecast with is not said here.
"""

import abc
import dataclasses
import functools
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.noise import NoiseSpec
from neurosym_jax.packing import in_parts, pack_agents
from neurosym_jax.scene import Scene

__all__ = ["AgentwiseForecaster", "Forecaster", "forecast_scene"]


@dataclasses.dataclass(frozen=True)
class Forecaster(abc.ABC):
    """A forecast of one scene, as a function of parameters, scene and noise."""

    pred_len: int

    @property
    def noise(self) -> NoiseSpec:
        """The noise it wants; the default is none, a deterministic forecast."""
        return NoiseSpec()

    @abc.abstractmethod
    def one(self, params: Any, scene: Scene, noise: Array) -> Array:
        """`[k, N, pred_len, 2]` metres relative to the scene's origin.

        `noise` is `[k, dim]`, or `[k, N, dim]` where the spec says per agent.
        """

    def packed(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """`[k, A, pred_len, 2]`: futures of the A valid agents of `scenes`, scene after scene.

        `scenes` has a leading axis of B scenes, `noise` is `[k, B, dim]` or `[k, B, N, dim]`.
        """
        futures = np.asarray(_over_scenes(self, params, scenes, noise))
        return futures[:, np.asarray(scenes.valid)]

    def batch(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """`packed` in its places, `[k, B, N, pred_len, 2]`; zero where a slot is not valid."""
        valid = np.asarray(scenes.valid)
        packed = self.packed(params, scenes, noise)
        futures = np.zeros((len(packed), *valid.shape, *packed.shape[2:]), packed.dtype)
        futures[:, valid] = packed
        return futures


class AgentwiseForecaster(Forecaster):
    """A forecaster in which agents do not look at each other.

    The agents of all scenes are then forecast as if they were one scene, without padding, in parts
    of one size: a single compiled program serves every bucket.
    """

    def packed(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """See `Forecaster.packed`."""
        return in_parts(
            lambda scene, noise: forecast_scene(self, params, scene, noise),
            *pack_agents(scenes, noise),
        )


@functools.partial(jax.jit, static_argnums=0)
def _over_scenes(forecaster: Forecaster, params, scenes, noise):
    return jax.vmap(forecaster.one, in_axes=(None, 0, 1), out_axes=1)(params, scenes, noise)


@functools.partial(jax.jit, static_argnums=0)
def forecast_scene(forecaster: Forecaster, params: Any, scene: Scene, noise: Any) -> Array:
    """`forecaster.one`, compiled; equal forecasters share the program."""
    return forecaster.one(params, scene, noise)
