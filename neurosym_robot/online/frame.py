"""What a stream of people consists of: everybody seen at one moment."""

from typing import NamedTuple

import numpy as np

__all__ = ["Frame"]


class Frame(NamedTuple):
    """Everybody seen at one moment, as `Predictor.push` takes it."""

    stamp: float
    """Seconds, of the message's header."""
    ids: np.ndarray
    """[N] int64."""
    xy: np.ndarray
    """[N, 2] float64 world metres."""
