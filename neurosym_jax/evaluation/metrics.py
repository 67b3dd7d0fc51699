"""Errors of k sampled forecasts of one scene against what happened.

Joint best-of-k takes one sample for the whole scene (SGAN's protocol); marginal best-of-k lets each
agent have its own, which is what most later papers report. The two are not comparable, so both are
always computed. The minima of ADE and of FDE are taken independently, as SGAN does.
"""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct
from jax import Array

__all__ = ["COLLISION_DISTANCE", "SceneErrors", "collisions", "scene_errors"]

COLLISION_DISTANCE = 0.2
"""Metres between two people's centres under which they collide."""


class SceneErrors(struct.PyTreeNode):
    """Sums over one scene's valid agents; divide by agents for means."""

    agents: Any
    """[] number of valid agents."""
    joint_ade: Any
    """[] metres, minimum over samples of the agents' summed time-mean error."""
    joint_fde: Any
    """[] metres, the same of the error at the last step."""
    marginal_ade: Any
    """[] metres, sum over agents of each one's minimum over samples."""
    marginal_fde: Any
    """[] metres, the same of the error at the last step."""
    horizon: Any
    """[pred_len] metres, agents' summed error at each step in the sample of best joint ADE."""
    colliding: Any
    """[] mean over samples of the number of agents that collide with another; None if not asked."""


def scene_errors(
    forecast: Array, future: Array, valid: Array, *, with_collisions: bool = True
) -> SceneErrors:
    """Errors of one scene.

    Args:
        forecast: [k, N, pred_len, 2] metres.
        future: [N, pred_len, 2] metres, the truth in the same frame.
        valid: [N] bool.
        with_collisions: whether to count collisions, the only work that is quadratic in N.
    """
    distance = jnp.linalg.norm(forecast - future, axis=-1)
    distance = jnp.where(valid[:, None], distance, 0)
    ade, fde = distance.mean(axis=-1), distance[..., -1]
    best = ade.sum(axis=1).argmin()
    return SceneErrors(
        agents=valid.sum(),
        joint_ade=ade.sum(axis=1).min(),
        joint_fde=fde.sum(axis=1).min(),
        marginal_ade=ade.min(axis=0).sum(),
        marginal_fde=fde.min(axis=0).sum(),
        horizon=distance[best].sum(axis=0),
        colliding=collisions(forecast, valid).sum(axis=1).mean() if with_collisions else None,
    )


def collisions(forecast: Array, valid: Array) -> Array:
    """Which agents come closer than `COLLISION_DISTANCE` to another in the same sample.

    Between time steps everybody moves in a straight line, so that fast crossings count.

    Args:
        forecast: [k, N, pred_len, 2] metres.
        valid: [N] bool.

    Returns:
        [k, N] bool.
    """

    def one_sample(forecast: Array) -> Array:
        offset = forecast[:, None] - forecast[None, :]
        # The last move is none, so that a forecast of a single step has a segment too.
        start, move = offset, jnp.diff(offset, axis=-2, append=offset[..., -1:, :])
        # The offset moves along a segment; its nearest point to zero is at `t` in [0, 1].
        length = (move**2).sum(-1)
        t = jnp.clip(-(start * move).sum(-1) / jnp.where(length > 0, length, 1), 0, 1)
        nearest = ((start + t[..., None] * move) ** 2).sum(-1).min(axis=-1)
        return ((nearest < COLLISION_DISTANCE**2) & pairs).any(axis=-1)

    pairs = valid[:, None] & valid[None, :] & ~jnp.eye(len(valid), dtype=bool)
    # Sample by sample, so that memory follows N^2 and not k N^2.
    return jax.lax.map(one_sample, forecast)
