"""Scores of a forecast as a probability distribution, of which its k samples are all that is known.

The energy score and the CRPS are proper: in expectation nothing scores better than the distribution
that the truth comes from (Gneiting and Raftery, JASA 2007). Both are of the k samples as they are:
the estimator with 1 / k^2, which also holds for samples that depend on each other, and which for a
single forecast is its error. The one with 1 / (k (k - 1)) is unbiased, but for independent samples
only. The price is that scores of different k are not comparable.
"""

import math

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.evaluation.metric import Metric

__all__ = ["LEAST_LOG_DENSITY", "METRICS", "apart"]

LEAST_LOG_DENSITY = -20.0
"""Nats below which no agent's step counts (Trajectron++)."""


@jax.jit  # So that several metrics trace it once.
def apart(forecast: Array) -> Array:
    """Of each sample `[k, N, T, 2]` the sum of distances to the others: [k, N, T] metres."""

    def add(total: Array, one: Array) -> tuple[Array, None]:
        offset = jnp.square(forecast - one)
        return total + jnp.sqrt(offset[..., 0] + offset[..., 1]), None

    return jax.lax.scan(add, jnp.zeros(forecast.shape[:-1], forecast.dtype), forecast)[0]


def _energy_score(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    """Of the whole scene's joint forecast, one vector of all agents, steps and coordinates.

    Divided by the root of agents times steps, so that a single forecast has its root mean square
    displacement error; weighed by agents, as joint ADE is. Gneiting and Raftery, section 4.3.
    """
    k, n = len(forecast), valid.sum()
    present = valid[:, None, None]
    error = jnp.square(jnp.where(present, forecast - future, 0)).sum(axis=(1, 2, 3))
    # Products of offsets from the mean, which lose nothing where samples lie close together.
    offset = jnp.where(present, forecast - forecast.mean(axis=0), 0).reshape(k, -1)
    product = offset @ offset.T
    square = jnp.diag(product)
    spread = jnp.maximum(square[:, None] + square - 2 * product, 0)
    scale = jnp.sqrt(jnp.maximum(n, 1) * future.shape[1])
    score = jnp.sqrt(error).mean() - jnp.sqrt(spread).mean() / 2
    return n * score / scale, n


def _crps(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    """Of each coordinate by itself, mean over steps and both. The same, section 4.2."""

    def add(total: Array, one: Array) -> tuple[Array, None]:
        return total + jnp.abs(forecast - one).sum(axis=0), None

    spread = jax.lax.scan(add, jnp.zeros_like(future), forecast)[0] / len(forecast) ** 2
    each = jnp.abs(forecast - future).mean(axis=0) - spread / 2
    return jnp.where(valid[:, None, None], each, 0).mean(axis=(1, 2)).sum(), valid.sum()


def _kde_nll(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    """Negative log likelihood of an agent's position by a Gaussian kernel density, mean over steps.

    As in Trajectron++ (Salzmann et al., ECCV 2020; `compute_kde_nll`): `scipy.stats.gaussian_kde`,
    whose kernel is the samples' covariance times k^(-1/3) (Scott's rule in two dimensions), and log
    densities of no less than `LEAST_LOG_DENSITY`. Samples on a line or a point have no density,
    where theirs fails: the least one is taken. Less than three samples are not counted.
    """
    k = len(forecast)
    if k < 3:
        return jnp.zeros(()), jnp.zeros((), int)
    tiny, eps = jnp.finfo(forecast.dtype).tiny, jnp.finfo(forecast.dtype).eps
    centred = forecast - forecast.mean(axis=0)
    x, y = centred[..., 0], centred[..., 1]
    factor = k ** (-1 / 3) / (k - 1)
    xx, xy, yy = (factor * (a * b).sum(axis=0) for a, b in ((x, x), (x, y), (y, y)))  # [N, T]
    # Cholesky's factor of the kernel's covariance: [[a, 0], [b, c]].
    a = jnp.sqrt(jnp.maximum(xx, tiny))
    b = xy / a
    rest = yy - b**2
    c = jnp.sqrt(jnp.maximum(rest, tiny))
    flat = (xx <= tiny) | (rest <= 4 * eps * yy)
    offset = future - forecast
    u = offset[..., 0] / a
    v = (offset[..., 1] - b * u) / c
    density = jax.nn.logsumexp(-(u**2 + v**2) / 2, axis=0) - jnp.log(a * c)
    density = density - math.log(2 * math.pi * k)
    density = jnp.maximum(jnp.where(flat, LEAST_LOG_DENSITY, density), LEAST_LOG_DENSITY)
    return -jnp.where(valid, density.mean(axis=-1), 0).sum(), valid.sum()


def _coverage(level: float) -> Metric:
    """Whether the truth lies in the region that holds `level` of a forecast, by agent and step.

    The region of k samples: those positions are in it whose mean distance to the samples is least.
    Of k + 1 exchangeable points, the samples and the truth, each has each rank in that order
    equally often; the truth is covered where its rank is among the first `level`, in part at the
    boundary and among equals. So a forecast that is right covers exactly `level`, whatever k is.
    The rank is that of a multivariate rank histogram (Gneiting et al., TEST 2008). One sample has
    no region.
    """

    def compute(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
        k = len(forecast)
        if k == 1:
            return jnp.zeros(()), jnp.zeros((), int)
        offset = jnp.square(forecast - future)
        to_truth = jnp.sqrt(offset[..., 0] + offset[..., 1])
        samples, truth = apart(forecast) + to_truth, to_truth.sum(axis=0)
        nearer, equal = (samples < truth).sum(axis=0), 1 + (samples == truth).sum(axis=0)
        covered = jnp.clip((level * (k + 1) - nearer) / equal, 0, 1)
        return jnp.where(valid, covered.mean(axis=-1), 0).sum(), valid.sum()

    percent = round(100 * level)
    about = "covered: true positions in the region that should hold so many of them"
    title = f"covered at {percent} %"
    return Metric(f"coverage_{percent}", title, "share", compute, about, by_default=False)


_PROPER = "energy score, CRPS: proper scores of the k samples as a distribution; less is better"

METRICS = (
    Metric("energy_score", "energy score", "m", _energy_score, _PROPER, by_default=False),
    Metric("crps", "CRPS", "m", _crps, _PROPER, by_default=False),
    Metric("kde_nll", "KDE NLL", "nats", _kde_nll, by_default=False),
    _coverage(0.5),
    _coverage(0.9),
)
