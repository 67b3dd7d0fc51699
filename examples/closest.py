"""A metric of one's own: how near the forecast lets people come to each other.

neurosym evaluate --plugin examples/closest.py
"""

import jax.numpy as jnp

from neurosym_jax.evaluation import Metric, register_metric


def closest(forecast, future, valid):
    """Sum over people of the least distance to another, mean over samples; and the people."""
    apart = jnp.linalg.norm(forecast[:, :, None] - forecast[:, None], axis=-1)  # [k, N, N, T]
    others = valid[:, None] & valid & ~jnp.eye(len(valid), dtype=bool)
    least = jnp.where(others[..., None], apart, jnp.inf).min(axis=(2, 3))  # [k, N]
    counted = others.any(axis=1)
    return jnp.where(counted, least, 0).mean(axis=0).sum(), counted.sum()


register_metric(Metric("closest", "nearest neighbour", "m", closest, higher_is_better=True))
