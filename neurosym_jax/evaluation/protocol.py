"""Evaluate a forecaster over batches of scenes: errors scene by scene, seconds told apart."""

import dataclasses
import functools
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.environment import cpu_threads
from neurosym_jax.evaluation.metrics import (
    SceneErrors,
    collisions,
    join_errors,
    scene_errors,
)
from neurosym_jax.forecaster import Forecaster
from neurosym_jax.noise import NoiseSpec, draw_noise
from neurosym_jax.runtime import compile_seconds
from neurosym_jax.scene import Scene
from neurosym_jax.scene_forecaster import SceneForecaster

__all__ = ["Evaluation", "evaluate", "latency"]


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors scene by scene, and where the time went."""

    errors: SceneErrors
    """Of all scenes, in the order of the windows."""
    collision_rate: float | None
    """Share of forecast agents that collide with another of their sample; None if not asked."""
    samples: int
    """k; 1 for a deterministic forecaster, whatever was asked for."""
    compiling: float
    """Seconds of tracing and compiling, 0 where every program was there already."""
    evaluating: float
    """Seconds of everything else."""

    @property
    def agents(self) -> int:
        """Number of agent windows evaluated."""
        return int(self.errors.agents.sum())

    def mean(self, field: str) -> float:
        """A field of `SceneErrors` summed over scenes and divided by agents."""
        return float(getattr(self.errors, field).sum() / self.agents)

    @property
    def horizon(self) -> np.ndarray:
        """[pred_len] mean error in metres at each step of the jointly best samples."""
        return self.errors.horizon.sum(axis=0) / self.agents


def evaluate(
    forecaster: Forecaster,
    params: Any,
    batches: Sequence[Batch],
    *,
    samples: int,
    seed: int,
    with_collisions: bool = True,
) -> Evaluation:
    """Errors of `forecaster` on every scene of `batches`; the truth is in the scenes."""
    spec = forecaster.noise
    samples = samples if spec.dim else 1
    start, compiled = time.perf_counter(), compile_seconds()
    work = list(zip(batches, _noises(spec, batches, samples, seed)))
    shapes = [batch.scene.valid.shape for batch in batches]
    # One batch of every shape compiles what it needs; the others then keep all cores busy, which
    # one batch of small matrices does not. Batches do not depend on each other.
    leaders = [shapes.index(shape) for shape in dict.fromkeys(shapes)]
    one = functools.partial(_evaluate_batch, forecaster, params, with_collisions)
    results = {index: one(*work[index]) for index in leaders}
    with ThreadPoolExecutor(cpu_threads()) as pool:
        rest = [index for index in range(len(work)) if index not in results]
        results |= zip(rest, pool.map(lambda index: one(*work[index]), rest))
    seconds, compiled = time.perf_counter() - start, compile_seconds() - compiled

    errors, colliding = zip(*(results[index] for index in range(len(work))))
    index = np.concatenate([batch.index for batch in batches])
    joined = join_errors(errors, np.argsort(index[index >= 0]))
    rate = sum(colliding) / joined.agents.sum() if with_collisions else None
    return Evaluation(joined, rate, samples, compiled, seconds - compiled)


def _evaluate_batch(
    forecaster: Forecaster, params: Any, with_collisions: bool, batch: Batch, noise: np.ndarray
) -> tuple[SceneErrors, float]:
    """Errors of a batch, and how many of its agents collide (mean over samples)."""
    # The forecaster sees neither the truth nor the host's float64 origin.
    scenes = batch.scene.replace(future=None, origin=None)
    future = batch.scene.future[scenes.valid]
    sizes = scenes.valid.sum(axis=1)
    colliding = 0.0
    if with_collisions:
        forecast = forecaster.batch(params, scenes, noise)
        colliding = float(_colliding(forecast, scenes.valid))
        forecast = forecast[:, scenes.valid]
    else:
        forecast = forecaster.packed(params, scenes, noise)
    return scene_errors(forecast, future, sizes[sizes > 0]), colliding


def _noises(
    spec: NoiseSpec, batches: Sequence[Batch], samples: int, seed: int
) -> Iterator[np.ndarray]:
    """Noise of each batch, `[k, B, dim]` or `[k, B, N, dim]`."""
    if spec.per_agent:
        for batch in batches:
            scene = batch.scene
            yield draw_noise(spec, seed, scene.identity, samples, scene.valid.shape[1])
    else:
        # One number of scenes would be a program of its own, so all are drawn together.
        identity = np.concatenate([batch.scene.identity for batch in batches])
        ends = np.cumsum([len(batch.index) for batch in batches])
        yield from np.split(draw_noise(spec, seed, identity, samples, 1), ends[:-1], axis=1)


@jax.jit
def _colliding(forecast, valid):
    """Mean over samples of the number of agents that collide, all scenes together."""
    return jax.vmap(collisions, in_axes=(1, 0))(forecast, valid).sum() / len(forecast)


def latency(
    forecaster: Forecaster, params: Any, scene: Scene, *, samples: int, seed: int
) -> tuple[float, np.ndarray]:
    """Median seconds from one scene to its forecast `[k, N, pred_len, 2]`, world metres."""
    forecast = SceneForecaster(forecaster, params, samples=samples, seed=seed)
    futures, seconds = np.empty(0), []
    for _ in range(11):
        start = time.perf_counter()
        futures = forecast(scene)
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:])), futures
