"""The programs that an evaluation needs, each compiled once, ahead of its use and side by side.

Compiling waits for nothing but a core, so while one model is evaluated the programs of those that
follow are made. A program is had by running it on an empty batch; what there is then, is found in
jax's own cache.
"""

import time
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.scene_scores import chosen
from neurosym_jax.evaluation.scoring import score_group
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.scene import Scene, make_scene, pad_scene

__all__ = ["Programs"]


class Programs:
    """Compiles, as a context, for evaluations with so many samples by the same metrics."""

    def __init__(self, samples: int, metrics: Sequence[str] | None):
        """Nothing is compiled yet."""
        self._samples = samples
        self._metrics = metrics
        self._pool = ThreadPoolExecutor(cpu_cores())
        self._begun: dict[Hashable, Future] = {}

    def __enter__(self) -> "Programs":
        """As it is."""
        return self

    def __exit__(self, error: object, *_: object) -> None:
        """Begin nothing more, and wait for what was begun, unless there is an error to tell."""
        self._pool.shutdown(wait=error is None, cancel_futures=True)

    def of_batches(self, model: Model, batches: Sequence[Batch]) -> list[Future]:
        """Begin, where nobody has, what scores the model on `batches`."""
        forecaster = model.forecaster
        scenes = {batch.scene.valid.shape: batch.scene for batch in batches}
        futures: list[Future] = []
        for scene in scenes.values():
            # What all shapes share is compiled with the first one, so the others wait for it.
            after = futures[:1]

            def run(scene: Scene = scene, after: list[Future] = after) -> None:
                for future in after:
                    future.result()
                empty: Any = jax.tree.map(np.zeros_like, scene)
                empty.valid[0, 0] = True
                samples = self._samples if forecaster.noise.dim else 1
                metrics = chosen(self._metrics)
                score_group(forecaster, model.params, [empty], samples, 0, metrics)

            futures.append(self._begin((forecaster, _key(scene)), run))
        return futures

    def of_one_scene(self, model: Model, slots: int) -> Future:
        """Begin, where nobody has, what forecasts one scene of `slots` slots."""
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
    """What programs for scenes, or batches, such as `scene` depend on."""
    return scene.observed.shape, scene.observed.dtype
