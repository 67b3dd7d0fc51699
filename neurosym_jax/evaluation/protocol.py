"""Evaluate a forecaster over batches of scenes: errors scene by scene, seconds told apart."""

import dataclasses
import functools
import time
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from neurosym_jax.data.batching import Batch
from neurosym_jax.evaluation.metrics import SceneErrors, scene_errors
from neurosym_jax.forecast import Forecaster
from neurosym_jax.noise import draw_noise
from neurosym_jax.runtime import compile_seconds
from neurosym_jax.scene import Scene

__all__ = ["Evaluation", "evaluate", "latency"]


@dataclasses.dataclass(frozen=True, eq=False)
class Evaluation:
    """Errors scene by scene, and where the time went."""

    errors: SceneErrors
    """Every field float64 with a leading axis of S scenes, in the order of the windows."""
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
        return np.asarray(self.errors.horizon).sum(axis=0) / self.agents


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
    outputs = []
    for batch in batches:
        # The forecaster sees neither the truth nor the host's float64 origin.
        scenes = batch.scene.replace(future=None, origin=None)
        noise = draw_noise(spec, seed, scenes.identity, samples, scenes.valid.shape[1])
        forecast = forecaster.batch(params, scenes, noise)
        outputs.append(_errors(forecast, batch.scene.future, scenes.valid, with_collisions))
    outputs = jax.device_get(outputs)
    seconds, compiled = time.perf_counter() - start, compile_seconds() - compiled

    index = np.concatenate([batch.index for batch in batches])
    order = np.argsort(index)[np.count_nonzero(index < 0) :]
    errors = jax.tree.map(lambda *part: np.concatenate(part).astype(np.float64)[order], *outputs)
    return Evaluation(errors, samples, compiled, seconds - compiled)


@functools.partial(jax.jit, static_argnums=3)
def _errors(forecast, future, valid, with_collisions):
    of_scene = functools.partial(scene_errors, with_collisions=with_collisions)
    return jax.vmap(of_scene, in_axes=(1, 0, 0))(forecast, future, valid)


def latency(
    forecaster: Forecaster, params: Any, scene: Scene, *, samples: int, seed: int
) -> tuple[float, np.ndarray]:
    """Median seconds from one scene and a seed to its forecast `[k, N, pred_len, 2]`."""
    spec = forecaster.noise
    samples = samples if spec.dim else 1
    scene = scene.replace(future=None, origin=None)
    forecast, seconds = np.empty(0), []
    for _ in range(11):
        start = time.perf_counter()
        noise = draw_noise(spec, seed, np.asarray(scene.identity)[None], samples, len(scene.valid))
        forecast = np.asarray(_one(forecaster, params, scene, noise[:, 0]))
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds[1:])), forecast


@functools.partial(jax.jit, static_argnums=0)
def _one(forecaster, params, scene, noise):
    return forecaster.one(params, scene, noise)
