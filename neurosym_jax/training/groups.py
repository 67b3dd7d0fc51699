"""A training batch: a tuple of Scenes, one for each size class, each `[scenes, slots, ...]`."""

import itertools
from collections.abc import Sequence

from neurosym_jax.scene import Scene

__all__ = ["Groups", "cuts"]

Groups = tuple[Scene, ...]


def cuts(sizes: Sequence[int]) -> list[int]:
    """Where `jnp.split` cuts an axis that holds parts of these sizes, one for each group."""
    return list(itertools.accumulate(sizes))[:-1]
