"""Compilation of an evaluation's programs ahead of use, in threads.

While one model is evaluated, the programs of those that follow are compiled. A program is compiled
by running it on an empty batch; later calls hit JAX's cache.
"""

import time
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Self

import jax
import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.scoring import chosen, score_batch
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.scene import Scene, make_scene, pad_scene

__all__ = ["CompileAhead"]


class CompileAhead:
    """Compiles each program of an evaluation once, in a thread pool. Use as a context manager."""

    def __init__(self, samples: int, metrics: Sequence[str] | None):
        """Compile nothing yet; evaluations have `samples` forecasts and these `metrics`."""
        self._samples = samples
        self._metrics = metrics
        self._pool = ThreadPoolExecutor(cpu_cores())
        self._begun: dict[Hashable, Future] = {}

    def __enter__(self) -> Self:
        """Return self."""
        return self

    def __exit__(self, error: object, *_: object) -> None:
        """Start nothing more, and wait for what is compiling, unless there is an error."""
        self._pool.shutdown(wait=error is None, cancel_futures=True)

    def of_batches(self, model: Model, batches: Sequence[Batch]) -> list[Future]:
        """Start compiling the scoring program for each batch shape not compiled yet."""
        forecaster = model.forecaster
        scenes = {_key(batch.scene): batch.scene for batch in batches}
        futures: list[Future] = []
        for key, scene in scenes.items():
            # All shapes share a program, compiled with the first one, so the others wait for it.
            after = futures[:1]

            def run(scene: Scene = scene, after: list[Future] = after) -> None:
                for future in after:
                    future.result()
                empty: Any = jax.tree.map(np.zeros_like, scene)
                empty.valid[0, 0] = True
                samples = forecaster.count(self._samples)
                metrics = chosen(self._metrics)
                score_batch(forecaster, model.params, empty, samples, 0, metrics)

            futures.append(self._begin((forecaster, key), run))
        return futures

    def of_one_scene(self, model: Model, slots: int) -> Future:
        """Start compiling the forecast of one scene of `slots` slots, if not compiled yet."""
        scene = pad_scene(make_scene(np.zeros((1, model.config.obs_len, 2))), slots)

        def run() -> None:
            SceneForecaster(model.forecaster, model.params, samples=self._samples, seed=0)(scene)

        return self._begin((model.forecaster, _key(scene)), run)

    def _begin(self, key: Hashable, run: Callable[[], object]) -> Future:
        if key not in self._begun:
            self._begun[key] = self._pool.submit(run)
        return self._begun[key]

    @staticmethod
    def wait_for(futures: Sequence[Future]) -> float:
        """Seconds waited until all are done."""
        start = time.perf_counter()
        for future in futures:
            future.result()
        return time.perf_counter() - start


def _key(scene: Scene) -> Hashable:
    """What programs for this scene or batch depend on."""
    return scene.observed.shape, scene.observed.dtype
