"""Training batches: one Scene `[scenes, slots, ...]` for each size class, computed on together."""

import itertools
import math
from collections.abc import Sequence

import jax.numpy as jnp
from jax import Array

from neurosym_jax.scene import AnyArray, Scene

__all__ = ["Groups", "merge", "split"]

Groups = tuple[Scene, ...]


def merge(parts: Sequence[AnyArray]) -> Array:
    """`[scenes, slots, ...]` of each group as one array `[A, ...]` of all slots."""
    return jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts])


def split(whole: Array, shapes: Sequence[tuple[int, ...]], axis: int = 0) -> list[Array]:
    """Cut an axis of `whole [...]` into parts, each of its own shape."""
    ends = list(itertools.accumulate(math.prod(shape) for shape in shapes))[:-1]
    before, after = whole.shape[:axis], whole.shape[axis + 1 :]
    parts = jnp.split(whole, ends, axis)
    return [part.reshape(*before, *shape, *after) for part, shape in zip(parts, shapes)]
