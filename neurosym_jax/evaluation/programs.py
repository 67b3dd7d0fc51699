"""The programs that evaluations need, each compiled once, ahead of its use and side by side.

Compiling waits for nothing but a core, so while one model is evaluated the programs of those that
follow are made. A program is had by running it on an empty batch; what there is then, is found in
jax's own cache.
"""

import time
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Executor, Future
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.scoring import chosen, score_group
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.scene import Scene, make_scene, pad_scene

__all__ = ["compile_ahead", "compile_single_ahead", "wait_for"]

_begun: dict[Hashable, Future] = {}
"""By what a program depends on. It is the process's, as the cache that it speaks of."""


def compile_ahead(
    pool: Executor,
    forecaster: Forecaster,
    params: Any,
    batches: Sequence[Batch],
    samples: int,
    metrics: Sequence[str] | None,
) -> list[Future]:
    """Begin to compile what `score_forecaster` of the same arguments will run."""
    samples = samples if forecaster.noise.dim else 1
    scenes = {batch.scene.valid.shape: batch.scene for batch in batches}
    futures: list[Future] = []
    for scene in scenes.values():
        # What all shapes share is compiled with the first one, so the others wait for it.
        after = futures[:1]

        def run(scene: Scene = scene, after: list[Future] = after) -> None:
            for future in after:
                future.result()
            _run_empty(forecaster, params, scene, samples, metrics)

        futures.append(_begin(pool, _key(forecaster, scene, samples), run))
    return futures


def compile_single_ahead(
    pool: Executor, forecaster: Forecaster, params: Any, slots: int, obs_len: int, samples: int
) -> Future:
    """Begin to compile, where nobody has begun, what forecasts one scene of `slots` slots."""
    scene = pad_scene(make_scene(np.zeros((1, obs_len, 2))), slots)

    def run() -> None:
        SceneForecaster(forecaster, params, samples=samples, seed=0)(scene)

    return _begin(pool, _key(forecaster, scene, samples), run)


def _key(forecaster: Forecaster, scene: Scene, samples: int) -> Hashable:
    """What the programs of `forecaster` for scenes, or batches, such as `scene` depend on."""
    return forecaster, samples, scene.observed.shape, scene.observed.dtype


def _begin(pool: Executor, key: Hashable, run: Callable[[], object]) -> Future:
    """`run` in `pool`, unless something of the same `key` was begun before."""
    if key not in _begun or _begun[key].cancelled():
        _begun[key] = pool.submit(run)
    return _begun[key]


def wait_for(futures: Sequence[Future]) -> float:
    """Seconds waited until all are done, 0 where they were."""
    if all(future.done() for future in futures):
        return 0.0
    start = time.perf_counter()
    for future in futures:
        future.result()
    return time.perf_counter() - start


def _run_empty(
    forecaster: Forecaster,
    params: Any,
    scene: Scene,
    samples: int,
    metrics: Sequence[str] | None,
) -> None:
    """`forecaster` on a batch like `scene`, in which a single slot is valid."""
    scene = jax.tree.map(np.zeros_like, scene)
    scene.valid[0, 0] = True
    score_group(forecaster, params, [scene], samples, 0, chosen(metrics))
