"""Forecasts of single scenes as they come, in the world's frame.

Used by `predict`, the online predictor and an evaluation's latency; `batched` forecasts batches.
"""

import functools
from typing import Any

import jax
import numpy as np

from neurosym_jax.configuration import Count, Seed, refuse
from neurosym_jax.data.batching import bucket_of
from neurosym_jax.forecasting.forecaster import Distribution, Forecaster
from neurosym_jax.forecasting.noise import scene_noise
from neurosym_jax.runtime.process import COMPILED_QUICKLY
from neurosym_jax.scene import Scene, pad_scene, to_world

__all__ = ["SceneForecaster", "forecast_scene"]


class SceneForecaster:
    """k futures of each scene it is called with, by one compiled program a bucket of sizes."""

    def __init__(self, forecaster: Forecaster, params: Any, *, samples: int, seed: int):
        """Move `params` to the device; nothing is compiled yet."""
        refuse(Count, {"samples": samples})
        refuse(Seed, {"seed": seed})
        self.forecaster = forecaster
        self.samples = forecaster.count(samples)
        self._params = jax.device_put(params)
        self._key = jax.random.key(seed)

    def __call__(self, scene: Scene) -> np.ndarray:
        """Futures [k, N, pred_len, 2], float64 metres in the world's frame."""
        return self.finish(self.start(scene), scene)[0]

    def start(self, scene: Scene) -> Distribution:
        """Begin the forecast of `scene`, of N slots, without waiting for it."""
        slots = int(bucket_of(len(scene.valid)))
        padded = self.forecaster.prepared(pad_scene(scene.bare(), slots))
        spec = self.forecaster.noise
        noise: Any = np.zeros((self.samples, 0), np.float32)
        if spec.dim:
            agents = slots if spec.per_agent else 1
            noise = _noise(spec, self._key, padded.identity, self.samples, agents)
        return forecast_scene(self.forecaster, self._params, padded, noise)

    @staticmethod
    def finish(started: Distribution, scene: Scene) -> tuple[np.ndarray, np.ndarray | None]:
        """Wait for the forecast that `start(scene)` began.

        Returns:
            Futures [k, N, pred_len, 2], float64 metres in the world's frame, and their
            probabilities [k]; None where all have the same.
        """
        futures, probability = started
        world = to_world(np.asarray(futures)[:, : len(scene.valid)], scene)
        return world, None if probability is None else np.asarray(probability, np.float64)


@functools.partial(jax.jit, static_argnums=0)
def forecast_scene(forecaster: Forecaster, params: Any, scene: Scene, noise: Any) -> Distribution:
    """`forecaster.distribution`, compiled; equal forecasters share the program."""
    return forecaster.distribution(params, scene, noise)


# Apart from the forecast, because threefry is slow to compile and this serves every bucket.
_noise = jax.jit(scene_noise, static_argnums=(0, 3, 4), compiler_options=COMPILED_QUICKLY)
