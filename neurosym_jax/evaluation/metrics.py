"""Metrics: formulas of one scene's errors, scores of symbols, and the table that plugins
extend.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.plugins import Registry
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.events import EVENTS
from neurosym_jax.symbolic.forecast import SymbolSettings, event_steps, state_steps
from neurosym_jax.symbolic.qtc import all_states, other_pairs

__all__ = [
    "COLLISION_DISTANCE",
    "METRICS",
    "MISSED",
    "MOVED",
    "NEAR",
    "SETTINGS",
    "SYMBOLS",
    "Metric",
    "collisions",
    "energy_score",
    "event_log",
    "known_metric",
    "metric_names",
    "person_energy",
    "register_metric",
    "state_log",
]


# The formulas of metrics: distances to the truth, collisions, and what neighbours
# change.
#
# Joint best-of-k takes one sample for the whole scene (SGAN's protocol); marginal
# best-of-k takes each agent's own best, which is what most later papers report. The two
# are not comparable, so both are always computed. The minima of ADE and of FDE are taken
# independently, as SGAN does.
#
# The energy score and the CRPS are proper: in expectation nothing scores better than the
# distribution that the truth comes from (Gneiting and Raftery, JASA 2007). k samples
# without probabilities are taken for independent draws: the mean distance of two of them
# is that of the k (k - 1) pairs, which is unbiased, so that scores of different k are
# comparable (Ferro, "Fair scores for ensemble forecasts", QJRMS 2014). k samples that
# have probabilities are taken for all that can happen: their mean distance is weighted
# by both probabilities, and nothing is estimated. A single forecast scores its error.
#
# Few of a crowd's pairs come near each other, and which ones depends on the numbers; so
# collisions are found on the host, where pairs whose bounding boxes lie apart are dropped
# first.
#
# A pooling whose units are dead forecasts everybody in company as it does alone: the
# forecasts of each agent with and without its neighbours, for the same noise, tell.

Weighted = tuple[Array, Array]
"""Values of a scene and their weights, see `Metric.compute`."""
MISSED = 2.0
"""Metres from the last position of an agent's best sample to the true one that are a miss."""
COLLISION_DISTANCE = 0.2
"""Distance between two people's centres below which they collide, metres."""
REACH = COLLISION_DISTANCE + 1e-3
"""Distance between boxes, m, beyond which no collision is possible, rounding included."""
MOVED = 1e-3
"""Metres; a forecast that moves by no more in any sample and step is unchanged."""
NEAR = 2.0
"""Metres to the nearest neighbour, at the last observed step, within which it should matter."""


@jax.jit  # So that several metrics trace it once.
def _distances(forecast: Array, scene: Scene) -> Array:
    """[k, N, T] metres from the forecast to the truth, zero for agents that are not valid."""
    distance = _length(forecast - scene.known_future)
    return jnp.where(scene.valid[:, None], distance, 0)


def _length(offset: Array) -> Array:
    """[...] metres of `offset [..., 2]`."""
    square = jnp.square(offset)
    return jnp.sqrt(square[..., 0] + square[..., 1])


def joint_ade(forecast: Array, scene: Scene) -> Array:
    """[N] mean errors over steps, in the sample that is best for the whole scene."""
    return _best(_distances(forecast, scene).mean(axis=-1))


def joint_fde(forecast: Array, scene: Scene) -> Array:
    """[N] errors at the last step, in the sample that is best for the whole scene."""
    return _best(_distances(forecast, scene)[..., -1])


def _best(errors: Array) -> Array:
    best = errors.sum(axis=-1).argmin()
    return errors[best]


def marginal_ade(forecast: Array, scene: Scene) -> Array:
    """[N] mean errors over steps, of each agent's own best sample."""
    errors = _distances(forecast, scene).mean(axis=-1)
    return errors.min(axis=0)


def marginal_fde(forecast: Array, scene: Scene) -> Array:
    """[N] errors at the last step, of each agent's own best sample."""
    return _distances(forecast, scene)[..., -1].min(axis=0)


def joint_fde_same(forecast: Array, scene: Scene) -> Array:
    """[N] errors at the last step, in the sample of best joint ADE."""
    return horizon(forecast, scene)[:, -1]


def marginal_fde_same(forecast: Array, scene: Scene) -> Array:
    """[N] errors at the last step, of each agent's sample with its least ADE."""
    distance = _distances(forecast, scene)
    best = distance.mean(axis=-1).argmin(axis=0)
    return distance[best, jnp.arange(distance.shape[1]), -1]


def missed(forecast: Array, scene: Scene) -> Array:
    """[N] whether even the best sample ends `MISSED` off (Chang et al., "Argoverse", CVPR 2019)."""
    return marginal_fde(forecast, scene) > MISSED


def horizon(forecast: Array, scene: Scene) -> Array:
    """[N, T] error at each step, in the sample of best joint ADE."""
    distance = _distances(forecast, scene)
    errors = distance.mean(axis=-1)
    best = errors.sum(axis=-1).argmin()
    return distance[best]


def energy_score(forecast: Array, scene: Scene, probability: Array | None) -> Array:
    """[] score of the whole scene's joint forecast, one vector of all agents, steps, coordinates.

    Divided by the root of agents times steps, so that a single forecast has its root
    mean square displacement error. Gneiting and Raftery, section 4.3.
    """
    present = scene.valid[:, None, None]
    offset = jnp.where(present, forecast - scene.known_future, 0)
    agents = jnp.maximum(scene.valid.sum(), 1)
    scale = jnp.sqrt(agents * forecast.shape[2])
    return _energy(offset, probability) / scale


def person_energy(forecast: Array, scene: Scene, probability: Array | None) -> Array:
    """[N] energy score of each agent by itself, `forecast [k, N, T, 2]`, as `energy_score`."""
    offset = forecast - scene.known_future
    scores = jax.vmap(_energy, in_axes=(1, None))(offset, probability)
    return scores / jnp.sqrt(forecast.shape[2])


@full_precision
def _energy(offset: Array, probability: Array | None) -> Array:
    """[] energy score of k vectors by their offsets `[k, ...]` from the truth."""
    offset = offset.reshape(len(offset), -1)
    weight = _numbers(offset, probability) / len(offset)
    error = jnp.sqrt(jnp.square(offset).sum(axis=1))
    # Products of offsets from the mean, which lose nothing where samples lie close
    # together.
    offset = offset - offset.mean(axis=0)
    product = offset @ offset.T
    square = jnp.diag(product)
    square_gap = square[:, None] + square - 2 * product
    distance = jnp.sqrt(jnp.maximum(square_gap, 0))
    spread = weight @ distance @ weight * _pairs(offset, probability)
    return weight @ error - spread / 2


@full_precision
def crps(forecast: Array, scene: Scene, probability: Array | None) -> Array:
    """[N] CRPS of each coordinate by itself, mean over steps and both. The same, section 4.2."""
    weight = _numbers(forecast, probability) / len(forecast)
    apart = _apart(forecast, weight, jnp.abs)
    spread = jnp.tensordot(weight, apart, 1) * _pairs(forecast, probability)
    offset = forecast - scene.known_future
    error = jnp.tensordot(weight, jnp.abs(offset), 1)
    scores = error - spread / 2
    return scores.mean(axis=(1, 2))


LEAST_LOG_DENSITY = -20.0
"""What a truth counts that the draws leave out altogether, as Trajectron++ takes it."""
FLAT = 1e-6
"""Least determinant of a covariance, of the product of its variances, that has a density."""


def kde_nll(
    forecast: Array, scene: Scene, probability: Array | None = None
) -> Weighted:
    """Negative log density of the truth by a Gaussian kernel density of the draws, mean over steps.

    Ivanovic and Pavone, The Trajectron (ICCV 2019), with the bandwidth by Scott's rule
    and the bound of Trajectron++ for a density of nothing. Draws at one spot or on one
    line have no density, and count as that bound.

    Args:
        forecast: [k, N, T, 2] metres, k draws.
        scene: the truth.
        probability: [k] of the draws; None where all have the same.

    Returns:
        [N] in nats, for densities a square metre, and [N] bool, the agents that count:
        none for a single draw.
    """
    k = len(forecast)
    weight = jnp.full(k, 1 / k) if probability is None else probability
    weight = weight[:, None, None]
    effective = 1 / jnp.square(weight).sum()
    offset = forecast - jnp.asarray(scene.known_future)
    mean = (weight[..., None] * offset).sum(0)
    x, y = jnp.moveaxis(offset - mean, -1, 0)
    # Bessel's correction; of draws of which one has all the probability there is none.
    share = weight / jnp.where(effective > 1, 1 - 1 / effective, 1.0)
    xx = (share * x * x).sum(0)
    xy = (share * x * y).sum(0)
    yy = (share * y * y).sum(0)
    determinant = xx * yy - xy * xy
    is_flat = determinant <= FLAT * jnp.maximum(xx * yy, FLAT**2)
    determinant = jnp.where(is_flat, 1.0, determinant)
    scott = effective ** (-1 / 3)
    x, y = jnp.moveaxis(offset, -1, 0)
    distance = yy * x * x - 2 * xy * x * y + xx * y * y
    distance = distance / (determinant * scott)
    height = jnp.log(2 * jnp.pi * scott) + 0.5 * jnp.log(determinant)
    logs = jax.nn.logsumexp(-distance / 2, axis=0, b=weight)
    logs = jnp.where(is_flat, LEAST_LOG_DENSITY, logs - height)
    logs = jnp.maximum(logs, LEAST_LOG_DENSITY)
    return -logs.mean(axis=-1), jnp.asarray(scene.valid) & (k > 1)


@full_precision
def coverage(
    level: float, forecast: Array, scene: Scene, probability: Array | None
) -> Weighted:
    """[N] share of steps at which the truth lies in the region that holds `level` of a forecast.

    The region of k samples contains the positions whose mean distance to the samples is
    least. Of k + 1 exchangeable points, the samples and the truth, each has each rank
    in that order equally often; the truth is covered where its rank is among the first
    `level`, in part at the boundary and among equals. So a forecast that is right
    covers exactly `level`, whatever k is. The rank is that of a multivariate rank
    histogram (Gneiting et al., TEST 2008). One sample has no region. A sample of
    probability p counts as k p samples, in mean distances and in ranks.
    """
    k = len(forecast)
    if k == 1:
        nothing = jnp.zeros(forecast.shape[1])
        return nothing, nothing
    number = _numbers(forecast, probability)
    to_truth = _length(forecast - scene.known_future)
    samples = _apart(forecast, number) + to_truth
    truth = jnp.tensordot(number, to_truth, 1)
    is_nearer = (samples < truth).astype(number.dtype)
    is_equal = (samples == truth).astype(number.dtype)
    nearer = jnp.tensordot(number, is_nearer, 1)
    equal = 1 + jnp.tensordot(number, is_equal, 1)
    share = (level * (k + 1) - nearer) / equal
    covered = jnp.clip(share, 0, 1)
    return covered.mean(axis=-1), jnp.asarray(scene.valid)


def central_ade(forecast: Array, scene: Scene, probability: Array | None) -> Array:
    """[N] mean errors over steps of the central forecast."""
    return _central(forecast, scene, probability).mean(axis=-1)


def central_fde(forecast: Array, scene: Scene, probability: Array | None) -> Array:
    """[N] errors at the last step of the central forecast."""
    return _central(forecast, scene, probability)[:, -1]


def _central(forecast: Array, scene: Scene, probability: Array | None) -> Array:
    """[N, T] errors of the most probable sample of the scene, of equally probable ones that with
    the least mean distance to the others."""
    errors = _distances(forecast, scene)
    if probability is not None:
        return errors[probability.argmax()]
    distances = _apart(forecast, _numbers(forecast, None))
    distances = jnp.where(scene.valid[:, None], distances, 0)
    spread = distances.sum(axis=(1, 2))
    return errors[spread.argmin()]


@functools.partial(jax.jit, static_argnums=2)  # So that several metrics trace it once.
def _apart(
    forecast: Array, number: Array, length: Callable[[Array], Array] = _length
) -> Array:
    """For each sample the sum of its distances to all others; one counts `number [k]` times.

    [k, N, T] metres or, where `length` has one for each coordinate, [k, N, T, 2].
    """

    def add(total: Array, weighted_sample: tuple[Array, Array]) -> tuple[Array, None]:
        sample, times = weighted_sample
        return total + times * length(forecast - sample), None

    nothing = jnp.zeros_like(length(forecast))
    total, _ = jax.lax.scan(add, nothing, (forecast, number))
    return total


def _numbers(forecast: Array, probability: Array | None) -> Array:
    """[k] how many samples each one counts for."""
    k = len(forecast)
    if probability is None:
        return jnp.ones(k, forecast.dtype)
    return k * probability


def _pairs(forecast: Array, probability: Array | None) -> float:
    """Number of all pairs of k samples over that of different ones, 1 where these are known."""
    k = len(forecast)
    if k == 1 or probability is not None:
        return 1.0
    return k / (k - 1)


def collisions(forecast: ArrayLike, valid: ArrayLike) -> np.ndarray:
    """Find agents that come closer than `COLLISION_DISTANCE` to another in the same sample.

    Between time steps agents move in straight lines, so that fast crossings count.

    Args:
        forecast: [k, N, T, 2] metres.
        valid: [N] bool.

    Returns:
        [k, N] bool.
    """
    forecasts = np.asanyarray(forecast)[:, None]
    hits = _batch_collisions(forecasts, np.asarray(valid)[None])
    return hits[:, 0]


def _batch_collisions(forecast: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """[k, B, N] bool; `forecast [k, B, N, T, 2]`, `valid [B, N]`."""
    # Samples last, so that a pair is a contiguous row.
    paths = forecast[:, valid].transpose(2, 3, 1, 0).copy()  # [T, 2, A, k]
    steps, _, agents, samples = paths.shape
    low = paths.min(axis=0)
    high = paths.max(axis=0) + REACH
    first, other = _pairs_of_scenes(valid.sum(axis=1))
    # First the boxes around all samples of a pair, then those of each.
    near = _meet(low.min(axis=-1), high.max(axis=-1), first, other)
    first = first[near]
    other = other[near]
    meets = _meet(low, high, first, other)
    pair, sample = np.nonzero(meets)

    # Numbers of the paths in `flat`, whose last axis is [A * k].
    flat = paths.reshape(steps, 2, -1)
    one = first[pair] * samples + sample
    two = other[pair] * samples + sample
    offset = flat.take(one, axis=2) - flat.take(two, axis=2)
    close = _collide(offset)
    hit = np.zeros(agents * samples, bool)
    hit[one[close]] = True
    hit[two[close]] = True
    hits = np.zeros(forecast.shape[:3], bool)
    hits[:, valid] = hit.reshape(agents, samples).T
    return hits


def _pairs_of_scenes(sizes: np.ndarray) -> np.ndarray:
    """[2, P] numbers of the two agents of each pair, of scenes of `sizes [B]` agents."""
    starts = np.cumsum(sizes) - sizes
    pairs = []
    for size, start in zip(sizes, starts):
        pairs.append(np.stack(np.triu_indices(size, 1)) + start)
    return np.concatenate(pairs, axis=1)


def _meet(
    low: np.ndarray, high: np.ndarray, first: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """[P, ...] whether boxes from `low [2, A, ...]` to `high` overlap."""
    starts_before = low[:, first] < high[:, other]
    ends_behind = low[:, other] < high[:, first]
    x, y = starts_before & ends_behind
    return x & y


def _collide(offset: np.ndarray) -> np.ndarray:
    """[C] whether paths whose offset is `offset [T, 2, C]` come too close."""
    end = np.square(offset[-1]).sum(axis=0)
    # The offset moves along a segment; its nearest point to zero is at `t` in [0, 1].
    x, y = offset[:-1].swapaxes(0, 1)
    moves = offset[1:] - offset[:-1]
    dx, dy = moves.swapaxes(0, 1)
    # The smallest positive number, for an offset that stays.
    tiny = np.finfo(offset.dtype).tiny
    length = np.maximum(dx**2 + dy**2, tiny)
    t = -(x * dx + y * dy) / length
    t = np.clip(t, 0, 1)
    square = (x + t * dx) ** 2 + (y + t * dy) ** 2
    nearest = square.min(axis=0, initial=np.inf)
    return np.minimum(end, nearest) < COLLISION_DISTANCE**2


def collision_rate(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] share of samples in which an agent collides; `forecast [k, B, N, T, 2]`."""
    hits = _batch_collisions(forecast, np.asarray(scene.valid))
    return hits.mean(axis=0)


def truth_collision_rate(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] whether an agent collides in the truth; `forecast [k, B, N, T, 2]`."""
    return collision_rate(np.asarray(scene.known_future)[None], scene)


def excess_collisions(forecast: np.ndarray, scene: Scene) -> np.ndarray:
    """[B, N] `collision_rate` less `truth_collision_rate`; `forecast [k, B, N, T, 2]`."""
    return collision_rate(forecast, scene) - truth_collision_rate(forecast, scene)


def neighbour_share(moves: Array, scene: Scene) -> Weighted:
    """[N] bool, whether an agent's forecast moves by more than `MOVED`; `moves [k, N, T, 2]`."""
    farthest = _length(moves).max(axis=(0, 2))
    return farthest > MOVED, _in_company(scene)


def neighbour_near(moves: Array, scene: Scene) -> Weighted:
    """[N] bool, `neighbour_share` of the agents whose nearest neighbour is within `NEAR`."""
    last = jnp.asarray(scene.observed)[:, -1]
    itself = jnp.eye(len(last), dtype=bool)
    others = jnp.asarray(scene.valid) & ~itself
    distance = _length(last[:, None] - last)
    distance = jnp.where(others, distance, jnp.inf)
    closest = distance.min(axis=1)
    changed, company = neighbour_share(moves, scene)
    return changed, company & (closest <= NEAR)


def neighbour_move(moves: Array, scene: Scene) -> Weighted:
    """[N] mean over samples of the move at the last step."""
    last = _length(moves[:, :, -1])
    return last.mean(axis=0), _in_company(scene)


def _in_company(scene: Scene) -> Array:
    """[N] bool, agents of scenes of two or more."""
    valid = jnp.asarray(scene.valid)
    return valid & (valid.sum() > 1)


# Log scores of the symbols and events that k forecasts make probable.
#
# Scored are ordered pairs within 8 m of each other at the last observation. Counts of
# samples become probabilities as in `symbolic.forecast`, smoothed by one sample spread
# uniformly. The score is -ln p_c, in nats, for the class c that came true (Good,
# "Rational decisions", 1952); it is proper. A movement below 0.125 m/s counts as
# standing, and events are timed in seconds, at any period. studies/pages/symbolic_forecast.md
# compares with a Markov chain.

SETTINGS = SymbolSettings()
IN_SIGHT = 8.0
"""Distance up to which a pair is scored, metres."""


def state_log(forecast: Array, scene: Scene) -> Weighted:
    """[] mean log score of the QTC_C1 state at each step, nats, and [] the number of pairs."""

    def states(settings: SymbolSettings, *paths: Array) -> Array:
        return state_steps(settings, *paths).astype(jnp.int16)

    count = len(all_states("c1"))
    return _log_score(states, count, forecast, scene)


def event_log(forecast: Array, scene: Scene) -> Weighted:
    """[] mean log score of the events, nats, and [] the number of pairs."""

    def happens(settings: SymbolSettings, *paths: Array) -> Array:
        first = event_steps(settings, tuple(EVENTS), *paths)
        return jnp.moveaxis(first < forecast.shape[2], 0, -1)

    return _log_score(happens, 2, forecast, scene)


def _log_score(
    classes_of: Callable[..., Array], classes: int, forecast: Array, scene: Scene
) -> Weighted:
    """The mean score of the scene's pairs, whose paths have the classes `[N, N, ...]`."""
    settings = dataclasses.replace(SETTINGS, period=scene.period)
    last = jnp.asarray(scene.observed)[:, -1]

    def pair_classes(future: Array) -> Array:
        path = jnp.concatenate([last[:, None], future], axis=1)
        return classes_of(settings, path[:, None], path)

    true = pair_classes(jnp.asarray(scene.known_future))
    # One sample after the other, for [k, N, N, T, 2] numbers of a crowd are many.
    hits = jax.lax.map(lambda future: pair_classes(future) == true, forecast)
    hits = hits.sum(axis=0)
    smoothing = settings.smoothing
    probability = (hits + smoothing / classes) / (len(forecast) + smoothing)
    scores = -jnp.log(probability)
    offset = last[:, None] - last[None]
    square = jnp.square(offset).sum(axis=-1)
    pairs = (square <= IN_SIGHT**2) & other_pairs(scene.valid)
    count = pairs.sum()
    scores = scores.reshape(*pairs.shape, -1)
    scores = jnp.where(pairs, scores.mean(axis=-1), 0)
    return scores.sum() / jnp.maximum(count, 1), count


# What a metric is, and the table of all metrics; `scoring` computes them.

Compute = Callable[..., Any]


@dataclasses.dataclass(frozen=True)
class Metric:
    """A score of k forecasts of a scene: one number, or one for each step."""

    title: str
    """Column head; its first word stands above the others."""
    compute: Compute
    """`compute(forecast [k, N, T, 2], scene) -> values` for one scene of N slots.

    `values` has a number for each agent, [N]; for each agent and step, [N, T]; or one
    for the scene, []. `jax.jit` and `jax.vmap` trace it. Positions are metres relative
    to the scene's origin, the truth is `scene.future`; values of slots that are not
    `scene.valid` are ignored.

    The mean over a test set counts each valid agent once, and a scene's number as often
    as the scene has valid agents. To count otherwise return `(values, weights)` with
    weights [N] or [], such as 0 where an agent has no value.
    """
    unit: str = "m"
    """`m`, ...; `share` is shown in per cent; empty for a plain number."""
    about: str = ""
    """A line of explanation below tables; metrics with the same line share it."""
    higher_is_better: bool | None = False
    """None where neither is better; no model is marked as the best then."""
    by_default: bool = True
    """Whether it is computed without being named (`metrics`)."""
    moves: bool = False
    """Whether `forecast` is how far each sample moves when an agent's neighbours are there."""
    weighted: bool = False
    """Whether `compute` takes a third argument, the probabilities [k] of the samples; None where
    all are the same. Other metrics take the samples for equally probable."""
    drawn: bool = False
    """Whether the metric is of the distribution: of independent draws, as many of every
    forecaster, in place of samples."""
    on_host: bool = False
    """Whether `compute` gets numpy arrays of a batch, [k, B, N, T, 2] and a scene with a leading
    axis B, and returns [B, N] or [B]: for work that depends on the numbers."""

    @property
    def label(self) -> str:
        """Title and unit."""
        if not self.unit:
            return self.title
        return f"{self.title} [{self.unit}]"

    def text(self, value: float | None) -> str:
        """`value` for a table's cell, without the unit where that is metres."""
        if value is None:
            return "-"
        if self.unit == "share":
            return f"{100 * value:.1f} %"
        if self.unit in ("", "m"):
            return f"{value:.3f}"
        return f"{value:.3f} {self.unit}"


_JOINT = "joint: the best of k forecasts of the whole scene (SGAN's protocol)"
_MARGINAL = "marginal: each agent's own best of k (most later papers)"
_SAME = "FDE of that ADE: the error at the last step, in the sample with the least ADE"
_MISS = (
    "missed: even the best of k samples of an agent ends more than 2 m from the truth"
)
_CENTRAL = "central: the most probable sample of the scene, or else the one nearest to the others"
_PROPER = (
    "energy score, CRPS: proper scores of the distribution, by independent draws, unbiased; "
    "less is better"
)
_KDE = "KDE-NLL: minus the log density of the truth by a Gaussian kernel density of 100 draws"
_COVERED = "covered: true positions in the region that should hold this share of them"
_NEIGHBOURS = (
    "neighbours: people of scenes of two or more whose forecast moves by over 1 mm when the others "
    "are removed, of all or of those with somebody within 2 m; mean move at the last step"
)
_SYMBOLS = (
    "states, events: log scores of those of ordered pairs within 8 m; less is better"
)

_further = functools.partial(Metric, by_default=False)
_on_host = functools.partial(_further, unit="share", on_host=True)
_weighted = functools.partial(_further, weighted=True)
_distribution = functools.partial(_weighted, drawn=True)
_moves = functools.partial(
    _further, about=_NEIGHBOURS, moves=True, higher_is_better=None
)
_symbols = functools.partial(_further, unit="nats", about=_SYMBOLS, drawn=True)


def _covered(level: float) -> Metric:
    compute = functools.partial(coverage, level)
    title = f"covered at {100 * level:.0f} %"
    return _distribution(title, compute, "share", _COVERED, higher_is_better=None)


METRICS: Registry[Metric] = Registry(
    "metric",
    {
        "joint_ade": Metric("joint ADE", joint_ade, "m", _JOINT),
        "joint_fde": Metric("joint FDE", joint_fde, "m", _JOINT),
        "marginal_ade": Metric("marginal ADE", marginal_ade, "m", _MARGINAL),
        "marginal_fde": Metric("marginal FDE", marginal_fde, "m", _MARGINAL),
        "horizon": Metric("mean error", horizon),
        "collision_rate": Metric(
            "people in collision", collision_rate, "share", on_host=True
        ),
        "truth_collision_rate": _on_host(
            "truth's collisions", truth_collision_rate, higher_is_better=None
        ),
        "excess_collisions": _on_host("collisions beyond truth's", excess_collisions),
        "draw_collisions": _on_host("draws in collision", collision_rate, drawn=True),
        "miss_rate": _further("missed by 2 m", missed, "share", _MISS),
        "joint_fde_same": _further("joint FDE of that ADE", joint_fde_same, "m", _SAME),
        "marginal_fde_same": _further(
            "marginal FDE of that ADE", marginal_fde_same, "m", _SAME
        ),
        "energy_score": _distribution("energy score", energy_score, "m", _PROPER),
        "person_energy": _distribution(
            "person's energy score", person_energy, "m", _PROPER
        ),
        "crps": _distribution("CRPS", crps, "m", _PROPER),
        "kde_nll": _distribution("KDE-NLL", kde_nll, "nats", _KDE),
        "coverage_50": _covered(0.5),
        "coverage_90": _covered(0.9),
        "central_ade": _weighted("central ADE", central_ade, "m", _CENTRAL),
        "central_fde": _weighted("central FDE", central_fde, "m", _CENTRAL),
        "neighbour_share": _moves("changed by neighbours", neighbour_share, "share"),
        "neighbour_near": _moves("changed by near neighbours", neighbour_near, "share"),
        "neighbour_move": _moves("moved by neighbours", neighbour_move),
        "state_log": _symbols("states log", state_log),
        "event_log": _symbols("events log", event_log),
    },
)

SYMBOLS = ("state_log", "event_log")
"""Names of the metrics of symbols, which take longer than all others together."""


def register_metric(
    name: str, title: str, *, replace: bool = False, **fields: Any
) -> Callable[[Compute], Compute]:
    """Return a decorator that adds a function as a metric to tables, JSON, cards and replay.

    Args:
        name: in JSON, in Python and after `--metrics`.
        title: see `Metric`.
        replace: replace another metric of this name.
        **fields: of `Metric`.
    """

    def register(compute: Compute) -> Compute:
        METRICS.register(name, Metric(title, compute, **fields), replace=replace)
        return compute

    return register


def metric_names(
    further: Sequence[str] = (), *, collisions: bool = True
) -> tuple[str, ...]:
    """Names of the metrics that are computed by default, in the table's order.

    Args:
        further: names to add; `all` adds every metric but those of symbols.
        collisions: whether the collision rate is among the defaults.
    """
    names = {name for name, metric in METRICS.items() if metric.by_default}
    if not collisions:
        names.discard("collision_rate")
    for name in further:
        if name == "all":
            names |= METRICS.keys() - set(SYMBOLS)
        elif METRICS[name]:
            names.add(name)
    return tuple(name for name in METRICS if name in names)


def known_metric(name: str) -> Metric:
    """Return the metric of this name; for one that only a report knows, a title alone."""
    if name in METRICS:
        return METRICS[name]
    return Metric(name, METRICS.__getitem__, "", higher_is_better=None)
