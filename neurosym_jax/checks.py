"""Ranges of the numbers that users give: refused in words before anything is computed."""

import math
from collections.abc import Mapping

from neurosym_jax.errors import InputError

__all__ = ["refuse_below", "refuse_seed"]


def refuse_below(lowest: float, values: Mapping[str, float | None]) -> None:
    """Refuse what is not a finite number of at least `lowest`; None means not given.

    Raises:
        InputError: naming the first that is out of range.
    """
    for name, value in values.items():
        if value is not None and not lowest <= value < math.inf:
            raise InputError(f"{name} must be at least {lowest:g}, not {value}")


def refuse_seed(seed: int, name: str = "seed") -> None:
    """Refuse a seed that is not in [0, 2**32), which jax would silently wrap.

    Raises:
        InputError: naming it.
    """
    if not 0 <= seed < 2**32:
        raise InputError(f"{name} must lie in [0, 2**32), not {seed}")
