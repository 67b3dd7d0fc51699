"""What a forecaster is: k futures of one scene, and where scenes gain their batch axis.

A forecaster is written for one scene, `one(params, scene, noise)`; `packed` maps it over batches of
padded scenes. Equal forecasters are equal to `jax.jit`, so they share compiled programs. Which
networks there are to forecast with is not said here.
"""

import abc
import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jax import Array

from neurosym_jax.forecasting.noise import NoiseSpec
from neurosym_jax.forecasting.packing import Map, in_parts, pack_agents, unpacked
from neurosym_jax.scene import Scene

__all__ = ["AgentwiseForecaster", "Forecaster", "bare", "forecast_scene"]


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

    def scene_bytes(self, samples: int, slots: int) -> float:
        """About what forecasting one scene takes in memory: futures, and states of its agents."""
        return 4.0 * samples * slots * (8 * self.pred_len + 256)

    def packed(
        self,
        params: Any,
        scenes: Sequence[Scene],
        noises: Sequence[np.ndarray],
        run: Map = map,
    ) -> np.ndarray:
        """Futures of all valid agents of some batches, batch after batch, scene after scene.

        Args:
            params: of the forecaster.
            scenes: batches, each with a leading axis of B scenes.
            noises: for each batch, `[k, B, dim]` or `[k, B, N, dim]`.
            run: applies a function to pieces of the work that do not depend on each other.

        Returns:
            [k, A, pred_len, 2] metres relative to each scene's origin.
        """

        def of_batch(batch: Scene, noise: np.ndarray) -> np.ndarray:
            return np.asarray(_over_scenes(self, params, batch, noise))[:, np.asarray(batch.valid)]

        return np.concatenate(list(run(of_batch, map(bare, scenes), noises)), axis=1)

    def batch(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """`packed` of one batch in its places, `[k, B, N, pred_len, 2]`; zero where not valid."""
        return unpacked(self.packed(params, [scenes], [noise]), np.asarray(scenes.valid))


class AgentwiseForecaster(Forecaster):
    """A forecaster in which agents do not look at each other.

    The agents of all scenes are then forecast as if they were one scene, without padding, in parts
    of one size: a single compiled program serves every bucket.
    """

    def packed(
        self,
        params: Any,
        scenes: Sequence[Scene],
        noises: Sequence[np.ndarray],
        run: Map = map,
    ) -> np.ndarray:
        """See `Forecaster.packed`."""
        agents, noise = pack_agents(scenes, noises)
        return in_parts(
            lambda scene, noise: forecast_scene(self, params, scene, noise), agents, noise, run
        )


def bare(scene: Scene) -> Scene:
    """Without the truth and the host's float64 origin, which no forecaster sees."""
    return scene.replace(future=None, origin=None)


@functools.partial(jax.jit, static_argnums=0)
def _over_scenes(forecaster: Forecaster, params, scenes, noise):
    return jax.vmap(forecaster.one, in_axes=(None, 0, 1), out_axes=1)(params, scenes, noise)


@functools.partial(jax.jit, static_argnums=0)
def forecast_scene(forecaster: Forecaster, params: Any, scene: Scene, noise: Any) -> Array:
    """`forecaster.one`, compiled; equal forecasters share the program."""
    return forecaster.one(params, scene, noise)
