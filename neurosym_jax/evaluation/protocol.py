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
from neurosym_jax.evaluation.metrics import (
    SceneErrors,
    collisions,
    scene_errors,
)
from neurosym_jax.evaluation.programs import compile_ahead, wait_for
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.noise import NoiseSpec, draw_noise
from neurosym_jax.forecasting.packing import Map, unpacked
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.runtime.environment import cpu_cores
from neurosym_jax.runtime.memory import refuse_beyond_memory
from neurosym_jax.runtime.processes import share, sum_over_processes
from neurosym_jax.scene import Scene

__all__ = ["Evaluation", "evaluate", "latency"]

GROUP = 2**17
"""Samples of agent slots that are forecast before their errors are taken, some 25 MB; and what one
of several processes takes at a time."""


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
    """Seconds of waiting for programs, 0 where all were there already."""
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
    """Errors of `forecaster` on every scene of `batches`; the truth is in the scenes.

    Raises:
        InputError: for a seed out of range, or more samples than there is memory for.
    """
    samples = samples if forecaster.noise.dim else 1
    groups = list(_groups(batches, samples))
    slots = max(sum(batch.scene.valid.size for batch in group) for group in groups)
    refuse_beyond_memory(
        f"evaluating {slots} people at once with {samples} samples",
        # Futures, a copy in their places, offsets from the truth; and the noise.
        4.0 * samples * slots * (6 * forecaster.pred_len + 2 * forecaster.noise.dim),
        "ask for fewer samples",
    )
    start = time.perf_counter()
    errors_of = functools.partial(
        _evaluate_group, forecaster, params, samples, seed, with_collisions
    )
    with ThreadPoolExecutor(cpu_cores()) as pool:
        mine = [batch for _, group in share(groups) for batch in group]
        compiling = wait_for(compile_ahead(pool, forecaster, params, mine, samples))
        done = {number: errors_of(part, pool.map) for number, part in share(groups)}
    # Every process fills in its scenes; those of the others are zero here.
    table = np.zeros((sum((batch.index >= 0).sum() for batch in batches), 5 + forecaster.pred_len))
    colliding = np.zeros(len(groups))
    for number, (errors, count) in done.items():
        index = np.concatenate([batch.index for batch in groups[number]])
        table[index[index >= 0]] = errors.table()
        colliding[number] = count
    joined = SceneErrors.of_table(sum_over_processes(table))
    rate = sum_over_processes(colliding).sum() / joined.agents.sum() if with_collisions else None
    seconds = time.perf_counter() - start
    return Evaluation(joined, rate, samples, compiling, seconds - compiling)


def _groups(batches: Sequence[Batch], samples: int) -> Iterator[list[Batch]]:
    """`batches` in pieces whose futures fit into memory, however many windows there are."""
    group: list[Batch] = []
    for batch in batches:
        group.append(batch)
        if sum(each.scene.valid.size for each in group) * samples >= GROUP:
            yield group
            group = []
    if group:
        yield group


def _evaluate_group(
    forecaster: Forecaster,
    params: Any,
    samples: int,
    seed: int,
    with_collisions: bool,
    batches: Sequence[Batch],
    run: Map,
) -> tuple[SceneErrors, float]:
    """Errors of some batches, and how many of their agents collide (mean over samples)."""
    scenes = [batch.scene for batch in batches]
    noises = list(_noises(forecaster.noise, scenes, samples, seed))
    forecast = forecaster.packed(params, scenes, noises, run)
    masks = [scene.valid for scene in scenes]
    future = np.concatenate([scene.future[scene.valid] for scene in scenes])
    sizes = np.concatenate([mask.sum(axis=1) for mask in masks])
    colliding = 0.0
    if with_collisions:
        ends = np.cumsum([mask.sum() for mask in masks])
        pieces = np.split(forecast, ends[:-1], axis=1)
        places = (unpacked(piece, mask) for piece, mask in zip(pieces, masks))
        colliding = sum(float(each) for each in run(_colliding, places, masks))
    return scene_errors(forecast, future, sizes[sizes > 0]), colliding


def _noises(
    spec: NoiseSpec, scenes: Sequence[Scene], samples: int, seed: int
) -> Iterator[np.ndarray]:
    """Noise of each batch, `[k, B, dim]` or `[k, B, N, dim]`."""
    if spec.per_agent:
        for scene in scenes:
            yield draw_noise(spec, seed, scene.identity, samples, scene.valid.shape[1])
    else:
        # Drawn together, because each draw is of a fixed number of scenes or more.
        ends = np.cumsum([len(scene.identity) for scene in scenes])
        identity = np.concatenate([scene.identity for scene in scenes])
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
