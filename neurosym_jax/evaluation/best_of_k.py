"""Errors of the best of k forecasts, of the whole scene or of each agent.

Joint best-of-k takes one sample for the whole scene (SGAN's protocol); marginal best-of-k takes
each agent's own best, which is what most later papers report. The two are not comparable, so both
are always computed. The minima of ADE and of FDE are taken independently, as SGAN does.
"""

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import Scene

__all__ = ["MISSED", "distances"]

MISSED = 2.0
"""Metres from the last position of an agent's best sample to the true one that are a miss."""


@jax.jit  # So that several metrics trace it once.
def distances(forecast: Array, scene: Scene) -> Array:
    """[k, N, T] metres from the forecast to the truth, zero for agents that are not valid."""
    offset = jnp.square(forecast - scene.known_future)
    return jnp.where(scene.valid[:, None], jnp.sqrt(offset[..., 0] + offset[..., 1]), 0)


def joint_ade(forecast: Array, scene: Scene) -> Array:
    """[N] mean errors over steps, in the sample that is best for the whole scene."""
    return _best(distances(forecast, scene).mean(axis=-1))


def joint_fde(forecast: Array, scene: Scene) -> Array:
    """[N] errors at the last step, in the sample that is best for the whole scene."""
    return _best(distances(forecast, scene)[..., -1])


def _best(errors: Array) -> Array:
    return errors[errors.sum(axis=-1).argmin()]


def marginal_ade(forecast: Array, scene: Scene) -> Array:
    """[N] mean errors over steps, of each agent's own best sample."""
    return distances(forecast, scene).mean(axis=-1).min(axis=0)


def marginal_fde(forecast: Array, scene: Scene) -> Array:
    """[N] errors at the last step, of each agent's own best sample."""
    return distances(forecast, scene)[..., -1].min(axis=0)


def missed(forecast: Array, scene: Scene) -> Array:
    """[N] whether even the best sample ends `MISSED` off (Chang et al., "Argoverse", CVPR 2019)."""
    return marginal_fde(forecast, scene) > MISSED


def horizon(forecast: Array, scene: Scene) -> Array:
    """[N, T] error at each step, in the sample of best joint ADE."""
    distance = distances(forecast, scene)
    return distance[distance.mean(axis=-1).sum(axis=-1).argmin()]
