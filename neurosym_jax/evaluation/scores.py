"""Forecast batches of scenes and score them."""

import itertools
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.data.windows import Batch, Windows, bucket_of
from neurosym_jax.errors import InputError, refuse_masked
from neurosym_jax.evaluation.metrics import METRICS, Metric, metric_names
from neurosym_jax.models.forecast import (
    PART,
    batch_noise,
    draw_batch,
    forecast_batch,
    unpacked,
)
from neurosym_jax.models.forecaster import Forecaster, refuse_many
from neurosym_jax.models.place.mixture import Remembered
from neurosym_jax.models.place.samples import exchange_batch
from neurosym_jax.runtime.process import COMPILED_UNFUSED, cpu_cores
from neurosym_jax.runtime.programs import program
from neurosym_jax.scene import (
    Scene,
    make_scene,
    model_dtype,
    pad_scene,
    relative_positions,
)

__all__ = [
    "Evaluation",
    "Metrics",
    "Score",
    "Scores",
    "chosen",
    "score",
    "score_batch",
    "score_forecaster",
    "score_samples",
    "score_scenes",
    "without_neighbours",
]

DRAWS = 100
"""Independent draws by which the distribution of every forecaster is scored."""


class Score(NamedTuple):
    """What a metric gives for S scenes, float64."""

    total: np.ndarray
    """[S], or [S, T] for a metric with a value for each step: sum of weighted values."""
    count: np.ndarray
    """[S] sum of the weights: the number of agents, unless the metric says otherwise."""

    @property
    def mean(self) -> np.ndarray:
        """[] or [T] mean over all scenes; NaN where nothing was counted."""
        count = self.count.sum()
        if count:
            return self.total.sum(axis=0) / count
        return np.full(self.total.shape[1:], np.nan)

    def of_each_scene(self) -> "Score":
        """Return the mean of each scene with weight 1, in place of its sum."""
        counts = self.count > 0
        shares = np.where(counts, self.count, 1)
        means = (self.total.T / shares).T
        return Score(means, counts.astype(float))


Scores = dict[str, Score]
"""By the name of the metric."""
Metrics = tuple[tuple[str, Metric], ...]
"""(name, metric), hashable for `jax.jit`."""


class Evaluation(NamedTuple):
    """What a forecaster scores on the S scenes of a test set."""

    scores: Scores
    """Scene by scene, in the order of the windows."""
    agents: int
    samples: int
    """k; 1 for a deterministic forecaster."""
    draws: int
    """Draws by which metrics of the distribution are; the one forecast of a deterministic
    forecaster is each of them."""
    seconds: float

    def mean(self, metric: str) -> float:
        """Mean of a metric with one value."""
        return float(self.scores[metric].mean)


def chosen(names: Sequence[str] | None) -> Metrics:
    """The metrics of these names; by default those that are computed without being named."""
    if names is None:
        names = metric_names()
    return tuple((name, METRICS[name]) for name in names)


def score_forecaster(
    forecaster: Forecaster,
    params: Any,
    batches: Sequence[Batch],
    *,
    samples: int,
    seed: int,
    metrics: Sequence[str] | None = None,
    memories: Sequence[Remembered] | None = None,
) -> Evaluation:
    """Scores of `forecaster` on every scene of `batches`, see `make_batches`.

    With `memories` of the place, one for each batch, some samples are exchanged for draws
    of the distribution, of which these are a part; metrics of what neighbours change
    see the network's.
    """
    start = time.perf_counter()
    samples = forecaster.count(samples)
    cores = cpu_cores()
    largest = max(batch.scene.valid.size for batch in batches)
    slots = largest * min(cores, len(batches))
    selected = chosen(metrics)
    futures = samples
    if any(metric.drawn for _, metric in selected):
        futures += DRAWS
    refuse_many(forecaster, futures, slots, min(slots, PART * cores))

    def score_one(batch: Batch, memory: Remembered | None) -> Scores:
        return score_batch(
            forecaster, params, batch.scene, samples, seed, selected, memory
        )

    with ThreadPoolExecutor(cores) as pool:
        recalled = memories or itertools.repeat(None)
        parts = list(pool.map(score_one, batches, recalled))
    return _evaluation(parts, batches, samples, DRAWS, start)


def score_samples(
    samples: np.ndarray,
    probability: np.ndarray | None,
    windows: Windows,
    batches: Sequence[Batch],
    metrics: Sequence[str] | None = None,
) -> Evaluation:
    """Scores of forecasts that are there: `samples [k, A, T, 2]` world metres of all
    agents of `windows`, and `probability [k, S]` of its scenes, None where all are the
    same.

    Metrics of what neighbours change count nothing, for nobody was forecast without
    them.
    """
    start = time.perf_counter()
    k = len(samples)
    selected = chosen(metrics)
    computed = tuple((name, metric) for name, metric in selected if not metric.moves)

    def score_part(batch: Batch) -> Scores:
        scenes = batch.index[batch.index >= 0]
        origins = np.asarray(batch.scene.origin)[: len(scenes)]
        origin = np.repeat(origins, windows.sizes[scenes], axis=0)
        futures = samples[:, windows.rows(scenes)]
        offsets = relative_positions(futures, origin[:, None]).astype(model_dtype())
        places = unpacked(offsets, np.asarray(batch.scene.valid))
        likely = None
        if probability is not None:
            likely = np.full((k, len(batch.index)), 1 / k, model_dtype())
            likely[:, : len(scenes)] = probability[:, scenes]
        return score_scenes(computed, places, batch.scene, likely)

    with ThreadPoolExecutor(cpu_cores()) as pool:
        parts = list(pool.map(score_part, batches))
    evaluation = _evaluation(parts, batches, k, k, start)
    nothing = Score(*np.zeros((2, windows.scenes)))
    scores = {name: evaluation.scores.get(name, nothing) for name, _ in selected}
    return evaluation._replace(scores=scores)


def _evaluation(
    parts: Sequence[Scores],
    batches: Sequence[Batch],
    samples: int,
    draws: int,
    start: float,
) -> Evaluation:
    """The scores of all batches, in the order of the windows; `start` is of `time.perf_counter`."""
    index = np.concatenate([batch.index for batch in batches])
    order = np.argsort(index, kind="stable")
    order = order[(index < 0).sum() :]
    scores = {}
    for name in parts[0]:
        totals = np.concatenate([part[name].total for part in parts])
        counts = np.concatenate([part[name].count for part in parts])
        scores[name] = Score(totals[order], counts[order])
    agents = sum(int(batch.scene.valid.sum()) for batch in batches)
    seconds = time.perf_counter() - start
    return Evaluation(scores, agents, samples, draws, seconds)


def score_batch(
    forecaster: Forecaster,
    params: Any,
    scenes: Scene,
    samples: int,
    seed: int,
    metrics: Metrics,
    memory: Remembered | None = None,
) -> Scores:
    """Scores of `forecaster` on a batch of padded scenes, with what is remembered there."""
    valid = np.asarray(scenes.valid)
    moves = None
    noise = batch_noise(forecaster, scenes, samples, seed)
    futures, probability = forecast_batch(forecaster, params, scenes, noise)
    if any(metric.moves for _, metric in metrics):
        alone, _ = forecast_batch(
            forecaster, params, *without_neighbours(scenes, noise)
        )
        moves = unpacked(futures - alone, valid)
    places = unpacked(futures, valid)
    drawn = tuple(named for named in metrics if named[1].drawn)
    others = tuple(named for named in metrics if not named[1].drawn)
    scores: Scores = {}
    if drawn or memory is not None:
        draws = _draws(forecaster, params, scenes, seed, memory)
        scores |= score_scenes(drawn, draws, scenes)
        if memory is not None:
            places = exchange_batch(places, probability, draws, valid, memory)
    scores |= score_scenes(others, places, scenes, probability, moves)
    return {name: scores[name] for name, _ in metrics}


def _draws(
    forecaster: Forecaster,
    params: Any,
    scenes: Scene,
    seed: int,
    memory: Remembered | None,
) -> np.ndarray:
    """[n, B, N, T, 2] independent draws for a batch; n is `DRAWS`, or 1 without noise."""
    plain = forecaster.noise.dim and not forecaster.calibrated
    if memory is not None or not plain:
        return draw_batch(forecaster, params, scenes, seed, DRAWS, memory)
    # The same as `draw_batch`, of agents packed without padding.
    noise = batch_noise(forecaster, scenes, DRAWS, seed)
    futures, _ = forecast_batch(forecaster, params, scenes, noise)
    return unpacked(futures, np.asarray(scenes.valid))


def without_neighbours(scenes: Scene, noise: np.ndarray) -> tuple[Scene, np.ndarray]:
    """Each slot of a batch of B scenes as a scene of its own, and the noise of these B N scenes.

    Args:
        scenes: of N slots, with a leading axis B.
        noise: [k, B, dim] of the scenes, or [k, B, N, dim] of their slots.
    """
    slots = scenes.valid.shape[1]

    def of_slots(leaf: Any) -> np.ndarray:
        return np.asarray(leaf).reshape(-1, 1, *leaf.shape[2:])

    identity = np.repeat(np.asarray(scenes.identity), slots, axis=0)
    bare = scenes.bare().replace(identity=None)
    alone = jax.tree.map(of_slots, bare).replace(identity=identity)
    if noise.ndim == 3:
        return alone, np.repeat(noise, slots, axis=1)
    return alone, noise.reshape(len(noise), len(identity), 1, -1)


def score(
    forecast: ArrayLike,
    future: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    observed: ArrayLike | None = None,
    metrics: Sequence[str] | None = None,
    probability: ArrayLike | None = None,
) -> Scores:
    """Scores of one scene, S = 1.

    Args:
        forecast: [k, N, T, 2] metres in any frame.
        future: [N, T, 2] metres in the same frame, the truth.
        valid: [N] bool, agents that count, one at least; positions of the others are
            ignored.
        observed: [N, obs_len, 2] metres in the same frame, for metrics of symbols.
        metrics: names; by default those that are computed without being named.
        probability: [k] of the samples; default: all have the same.
    """
    refuse_masked(
        {"forecast": forecast, "future": future, "valid": valid, "observed": observed}
    )
    future = np.asarray(future, np.float64)
    if valid is None:
        valid = np.ones(len(future), bool)
    present = np.asarray(valid)
    seen = future[:, :1] if observed is None else np.asarray(observed)
    scene = make_scene(seen[present], future[present])
    samples = np.asarray(forecast)[:, present]
    samples = relative_positions(samples, np.asarray(scene.origin))
    # A program for each bucket, not for each number of people.
    padded = pad_scene(scene, int(bucket_of(len(present))))
    batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], padded)
    places = unpacked(samples.astype(model_dtype()), batch.valid)
    likely = None
    if probability is not None:
        likely = np.asarray(probability, model_dtype())[:, None]
    return score_scenes(chosen(metrics), places, batch, likely)


def score_scenes(
    metrics: Metrics,
    samples: np.ndarray,
    scenes: Scene,
    probability: np.ndarray | None = None,
    moves: np.ndarray | None = None,
) -> Scores:
    """Scores of a batch of B padded scenes by `samples [k, B, N, T, 2]`, metres from each's origin.

    `probability [k, B]` is None where all samples have the same; `moves [k, B, N, T,
    2]` are those of `Metric.moves`.

    Raises:
        InputError: for a metric that fails, gives something else, or lacks `moves`.
    """
    scenes = scenes.replace(origin=None, identity=None)
    arguments = (samples, moves, scenes, probability)
    traced = tuple(named for named in metrics if not named[1].on_host)
    sums = _traced(traced, *arguments)
    for name, metric in metrics:
        if metric.on_host:
            values, weights = map(np.asarray, _computed(name, metric, *arguments))
            sums[name] = _summed(name, values, weights, scenes, np)
    scores = {}
    for name, _ in metrics:
        total, count = sums[name]
        scores[name] = Score(np.asarray(total, float), np.asarray(count, float))
    return scores


@program((0,), compiler_options=COMPILED_UNFUSED)
def _traced(
    metrics: Metrics, samples: Any, moves: Any, scenes: Scene, probability: Any
) -> Any:
    """(total [B] or [B, T], count [B]) of each of `metrics` by name, see `score_scenes`."""

    def score_one_scene(*arguments: Any) -> dict[str, Any]:
        computed = {}
        for name, metric in metrics:
            computed[name] = _computed(name, metric, *arguments)
        return jax.tree.map(jnp.asarray, computed)

    score_each_scene = jax.vmap(score_one_scene, in_axes=(1, 1, 0, 1))
    parts = score_each_scene(samples, moves, scenes, probability)
    sums = {}
    for name, (values, weights) in parts.items():
        sums[name] = _summed(name, values, weights, scenes, jnp)
    return sums


def _computed(
    name: str, metric: Metric, samples: Any, moves: Any, scene: Scene, probability: Any
) -> tuple[Any, Any]:
    """The metric's values and weights; without weights, those of `Metric.compute`."""
    if metric.moves and moves is None:
        raise InputError(f"metric {name}: needs forecasts without neighbours, too")
    optional = (probability,) if metric.weighted else ()
    try:
        values = metric.compute(moves if metric.moves else samples, scene, *optional)
        if isinstance(values, tuple):
            values, weights = values
            return values, weights
        weights: Any = scene.valid
        if np.ndim(values) < np.ndim(weights):
            weights = weights.sum(axis=-1)
        return values, weights
    except Exception as error:  # A plugin's code can fail in any way.
        raise InputError(f"metric {name}: {type(error).__name__}: {error}") from error


def _summed(
    name: str, values: Any, weights: Any, scenes: Scene, xp: Any
) -> tuple[Any, Any]:
    """(total [B] or [B, T], count [B]) of a batch's values and weights."""
    shape = scenes.known_future.shape[:3]
    _, slots, steps = shape
    fits = values.shape in (shape[:1], shape[:2], shape)
    if not fits or weights.shape != values.shape[:2]:
        raise InputError(
            f"metric {name}: values [], [{slots}] or [{slots}, {steps}] of a scene are wanted and "
            f"weights [] or [{slots}] alike, not {list(values.shape[1:])} and "
            f"{list(weights.shape[1:])}"
        )
    if values.ndim == 1:
        return xp.where(weights > 0, values * weights, 0), weights
    weights = xp.where(scenes.valid, weights, 0)
    shares = weights[..., None] if values.ndim == 3 else weights
    products = xp.where(shares > 0, values * shares, 0)
    return products.sum(axis=1), weights.sum(axis=1)
