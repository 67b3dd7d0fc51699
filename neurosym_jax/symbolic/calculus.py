"""What a calculus of the QTC family is."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.symbolic.qtc import Convention

__all__ = ["Calculus", "Observe", "Thresholds"]


class Thresholds(NamedTuple):
    """From where on movements and distances count; all are inclusive, and may be traced."""

    quantisation_factor: ArrayLike = 0.0
    """Metres per step: q1, q2 and the difference of two steps' lengths."""
    side_quantisation_factor: ArrayLike | None = None
    """Metres per step across the line: q3 and q4, see `qtc.qtc_c1`."""
    angle: ArrayLike = 0.0
    """Radians by which two angles differ: q6."""
    near: ArrayLike = 1.22
    """Metres between k and l, at the later frame of a step, up to which QTC_BC has sides."""
    apart: ArrayLike | None = None
    """Metres beyond which it has none again; in between a pair stays what it was, and counts as
    apart at first. None is `near`."""


Observe = Callable[[ArrayLike, ArrayLike, Convention, Thresholds], Array]


@dataclasses.dataclass(frozen=True)
class Calculus:
    """One calculus of the family."""

    symbols: tuple[str, ...]
    """What its symbols are called, m of them."""
    observe: Observe
    """`(k [..., T, 2], l [..., T, 2], convention, thresholds) -> [..., T-1, m]` int8 states."""
    possible: Callable[[np.ndarray], np.ndarray] = lambda every: np.ones(len(every), bool)
    """Which of the states [S, m] of symbols in {-1, 0, 1} moving points can be in, [S] bool."""
    optional: tuple[int, ...] = ()
    """Places of the symbols that are all `ABSENT` when a pair is apart."""
