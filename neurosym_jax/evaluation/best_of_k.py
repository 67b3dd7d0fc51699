"""Errors of the best of k forecasts, of the whole scene or of each agent.

Joint best-of-k takes one sample for the whole scene (SGAN's protocol); marginal best-of-k lets each
agent have its own, which is what most later papers report. The two are not comparable, so both are
always computed. The minima of ADE and of FDE are taken independently, as SGAN does.
"""

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.evaluation.metric import Metric

__all__ = ["METRICS", "MISSED", "distances"]

MISSED = 2.0
"""Metres from the last position of an agent's best sample to the true one that are a miss."""


@jax.jit  # So that several metrics trace it once.
def distances(forecast: Array, future: Array, valid: Array) -> Array:
    """[k, N, T] metres, zero for agents that are not valid."""
    offset = jnp.square(forecast - future)
    return jnp.where(valid[:, None], jnp.sqrt(offset[..., 0] + offset[..., 1]), 0)


def _joint_ade(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    distance = distances(forecast, future, valid)
    return distance.mean(axis=-1).sum(axis=-1).min(), valid.sum()


def _joint_fde(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    return distances(forecast, future, valid)[..., -1].sum(axis=-1).min(), valid.sum()


def _marginal_ade(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    distance = distances(forecast, future, valid)
    return distance.mean(axis=-1).min(axis=0).sum(), valid.sum()


def _marginal_fde(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    return distances(forecast, future, valid)[..., -1].min(axis=0).sum(), valid.sum()


def _miss_rate(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    """Chang et al., "Argoverse" (CVPR 2019)."""
    final = distances(forecast, future, valid)[..., -1].min(axis=0)
    return (final > MISSED).sum(), valid.sum()


def _horizon(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
    """The error at each step, in the sample of best joint ADE."""
    distance = distances(forecast, future, valid)
    best = distance.mean(axis=-1).sum(axis=-1).argmin()
    return distance[best].sum(axis=0), valid.sum()


_JOINT = "joint: the best of k forecasts of the whole scene (SGAN's protocol)"
_MARGINAL = "marginal: each agent's own best of k (most later papers)"
_MISS = "missed: even the best of k samples of an agent ends more than 2 m from the truth"

METRICS = (
    Metric("joint_ade", "joint ADE", "m", _joint_ade, _JOINT),
    Metric("joint_fde", "joint FDE", "m", _joint_fde, _JOINT),
    Metric("marginal_ade", "marginal ADE", "m", _marginal_ade, _MARGINAL),
    Metric("marginal_fde", "marginal FDE", "m", _marginal_fde, _MARGINAL),
    Metric("horizon", "mean displacement error", "m", _horizon),
    Metric("miss_rate", "missed by 2 m", "share", _miss_rate, _MISS, by_default=False),
)
