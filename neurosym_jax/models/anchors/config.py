"""Configurations of the anchors network and of the anchor table, and what both forecast.

They stand apart from the networks: a forecast by a kept program imports no Flax.
"""

import dataclasses
from typing import Annotated, NamedTuple

from jax import Array

from neurosym_jax.configuration import Positive, Rule, Size
from neurosym_jax.errors import InputError
from neurosym_jax.models.anchors.frames import pair_features
from neurosym_jax.models.forecaster import Lengths
from neurosym_jax.symbolic.weighting import WEIGHTINGS, Weighting

__all__ = ["AnchorConfig", "AnchorForecast", "AnchorTableConfig"]


class AnchorForecast(NamedTuple):
    """The forecast of one scene of N people, metres."""

    samples: Array
    """[k, N, pred_len, 2] joint forecasts."""
    log_probability: Array
    """[k] of the samples."""
    points: Array
    """[P, N, pred_len, 2] equally probable forecasts of each person; P = 0 without any."""


@dataclasses.dataclass(frozen=True)
class AnchorTableConfig(Lengths):
    """Lengths and number of samples of an anchor table or network."""

    obs_len: Annotated[Size, Rule("be at least 4", lambda steps: steps >= 4)] = 8
    """Observed time steps."""
    samples: Size = 20
    """Number of joint forecasts, k."""


@dataclasses.dataclass(frozen=True)
class AnchorConfig(AnchorTableConfig):
    """Architecture of the anchors network."""

    points: Annotated[
        int, Rule("lie in [0, 65536]", lambda points: 0 <= points <= 65536)
    ] = 0
    """Number of equally probable forecasts of each person, of which the distribution consists; 0
    for none."""
    hidden: Size = 96
    """Units of a person's two hidden layers."""
    short: bool = False
    """Whether it learns from incomplete histories, too, and forecasts people seen for fewer steps
    than `obs_len`; it has further parameters for them."""
    radius: Positive = 10.0
    """Distance at which the attention to a neighbour has smoothly fallen to 0, metres; people are
    counted up to 20 m."""
    geometry: bool = True
    """Whether the attention sees neighbours' positions and velocities."""
    symbols: bool = False
    """Whether the attention sees the QTC_C1 symbols of a pair, now and 1.2 s ago at steps of 0.4 s.
    Without `geometry` and `symbols` people do not see each other."""
    weighting: Annotated[Weighting | None, WEIGHTINGS] = None
    """Weights of pairs, alpha, by which the attention is multiplied; None for 1."""

    def __post_init__(self):
        super().__post_init__()
        if self.weighting is not None and not self.interacts:
            raise InputError(
                "weighting: without geometry and symbols there are no pairs to weight"
            )

    @property
    def interacts(self) -> bool:
        """Whether people see each other."""
        return self.geometry or self.symbols

    def pair_features(
        self,
        observed: Array,
        velocity: Array,
        heading: Array,
        valid: Array,
        near: Array | None,
    ) -> tuple[Array, Array, Array]:
        """Features of j seen by i `[N, N, F]`, nearness `[N, N]` and number around `[N]`.

        See `frames.pair_features`; a subclass may add features.
        """
        return pair_features(self, observed, velocity, heading, valid, near)
