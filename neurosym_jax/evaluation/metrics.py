"""Errors of k sampled forecasts of one scene against what happened.

Joint best-of-k takes one sample for the whole scene (SGAN's protocol); marginal best-of-k lets each
agent have its own, which is what most later papers report. The two are not comparable, so both are
always computed. The minima of ADE and of FDE are taken independently, as SGAN does.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

__all__ = ["COLLISION_DISTANCE", "SceneErrors", "collisions", "scene_errors"]

COLLISION_DISTANCE = 0.2
"""Metres between two people's centres under which they collide."""


@dataclasses.dataclass(frozen=True, eq=False)
class SceneErrors:
    """Sums over the agents of each of S scenes, float64; divide by agents for means."""

    agents: np.ndarray
    """[S] number of agents."""
    joint_ade: np.ndarray
    """[S] metres, minimum over samples of the agents' summed time-mean error."""
    joint_fde: np.ndarray
    """[S] metres, the same of the error at the last step."""
    marginal_ade: np.ndarray
    """[S] metres, sum over agents of each one's minimum over samples."""
    marginal_fde: np.ndarray
    """[S] metres, the same of the error at the last step."""
    horizon: np.ndarray
    """[S, pred_len] metres, agents' summed error at each step in the sample of best joint ADE."""

    def table(self) -> np.ndarray:
        """[S, 5 + pred_len] all fields side by side, in their order."""
        return np.column_stack([getattr(self, each.name) for each in dataclasses.fields(self)])

    @classmethod
    def of_table(cls, table: np.ndarray) -> "SceneErrors":
        """The inverse of `table`."""
        return cls(*table[:, :5].T, horizon=table[:, 5:])


def scene_errors(forecast: np.ndarray, future: np.ndarray, sizes: np.ndarray) -> SceneErrors:
    """Errors of S scenes, whose agents follow each other.

    Args:
        forecast: [k, A, pred_len, 2] metres.
        future: [A, pred_len, 2] metres, the truth in the same frame.
        sizes: [S] agents of each scene, at least 1, A altogether.
    """
    sizes = np.asarray(sizes)
    first = np.cumsum(sizes) - sizes
    # In the forecast's own precision: a tenth of the time, and its rounding is no worse.
    offset = np.square(forecast - future)
    distance = np.sqrt(offset[..., 0] + offset[..., 1])
    ade, fde = distance.mean(axis=-1, dtype=np.float64), distance[..., -1].astype(np.float64)
    joint = np.add.reduceat(ade, first, axis=1)
    best = np.repeat(joint.argmin(axis=0), sizes)
    return SceneErrors(
        agents=sizes.astype(np.float64),
        joint_ade=joint.min(axis=0),
        joint_fde=np.add.reduceat(fde, first, axis=1).min(axis=0),
        marginal_ade=np.add.reduceat(ade.min(axis=0), first),
        marginal_fde=np.add.reduceat(fde.min(axis=0), first),
        horizon=np.add.reduceat(distance[best, np.arange(len(best))], first, dtype=np.float64),
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
