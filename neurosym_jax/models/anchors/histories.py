"""Histories cut to a random length, for training."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import Scene

__all__ = ["WHOLE", "shorten"]

WHOLE = 0.3
"""Share of people whose history stays whole."""


def shorten(scenes: Scene, key: Array) -> Scene:
    """`scenes [B, N, ...]` in which people were seen for 2 steps or more, up to all.

    A person's number of steps is drawn from all with the same probability, or is all
    with the probability `WHOLE`. Positions before are filled in as `with_steps` does;
    consumes `key`.
    """
    observed: Any = jnp.asarray(scenes.observed)
    steps = observed.shape[-2]
    cut, length = jax.random.split(key)
    people = observed.shape[:-2]
    count = jax.random.randint(length, people, 2, steps + 1)
    count = jnp.where(jax.random.uniform(cut, people) < WHOLE, steps, count)
    first = (steps - count)[..., None]
    number = jnp.arange(steps)
    seen = number >= first
    at_first = jnp.take_along_axis(observed, first[..., None], axis=-2)
    after = jnp.take_along_axis(observed, first[..., None] + 1, axis=-2)
    back = (number - first)[..., None].astype(observed.dtype)
    earlier = at_first + back * (after - at_first)
    observed = jnp.where(seen[..., None], observed, earlier)
    return scenes.replace(observed=observed, seen=seen)
