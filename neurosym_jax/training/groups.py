"""Training batches: a tuple of Scenes `[scenes, slots, ...]`, one for each size class."""

import itertools
from collections.abc import Sequence

from neurosym_jax.scene import Scene

__all__ = ["Groups", "cuts"]

Groups = tuple[Scene, ...]


def cuts(sizes: Sequence[int]) -> list[int]:
    """The places where `jnp.split` cuts an axis into parts of these sizes."""
    return list(itertools.accumulate(sizes))[:-1]
