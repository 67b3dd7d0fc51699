"""A plugin's metric: the distance to the nearest other person in the forecast.

neurosym evaluate --plugin examples/closest.py
"""

import jax.numpy as jnp

from neurosym_jax.evaluation import register_metric


@register_metric("closest", "nearest neighbour", unit="m", higher_is_better=True)
def closest(forecast, scene):
    """Least distance to another person, mean over samples; of a person alone, no value."""
    # [k, N, N, T]
    distance = jnp.linalg.norm(forecast[:, :, None] - forecast[:, None], axis=-1)
    others = scene.valid[:, None] & scene.valid & ~jnp.eye(len(scene.valid), dtype=bool)
    least = jnp.where(others[..., None], distance, jnp.inf).min(axis=(2, 3))  # [k, N]
    return least.mean(axis=0), others.any(axis=1)
