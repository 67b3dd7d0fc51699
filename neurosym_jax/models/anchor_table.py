"""The anchor table: constant velocity plus k fixed offsets, the same for everybody.

961 numbers for 20 samples of 12 steps. A network that does not beat it has learned nothing from the
scene but the speed.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Checked, Count, Positive
from neurosym_jax.errors import InputError
from neurosym_jax.models.frames import heading_of, length, turned

__all__ = ["SLOW", "AnchorTable", "AnchorTableConfig"]

SLOW = 0.125
"""Speed at which a heading has faded to 0.7, m/s; symbols take slower movement for none."""


@dataclasses.dataclass(frozen=True)
class AnchorTableConfig(Checked):
    """Lengths and number of samples of a table or a network of anchors."""

    obs_len: Count = 8
    """Observed time steps, at least 4."""
    pred_len: Count = 8
    """Time steps to forecast."""
    period: Positive = 0.4
    """Seconds between time steps, in training."""
    samples: Count = 20
    """Number of joint forecasts, k."""

    def __post_init__(self):
        """Refuse fewer observed steps than the mean velocity needs."""
        super().__post_init__()
        if self.obs_len < 4:
            raise InputError(f"obs_len must be at least 4, not {self.obs_len}")


class AnchorTable(nn.Module):
    """Fixed offsets in each person's frame, scaled by the speed, and further ones for the still."""

    config: AnchorTableConfig

    @nn.compact
    def __call__(
        self,
        observed: Array,
        valid: Array,
        alpha: Array | None = None,
        company: Array | float = 0.0,
    ) -> tuple[Array, Array]:
        """Forecast positions `[k, N, pred_len, 2]`, equally probable: log-probabilities `[k]`.

        Only `observed [N, obs_len, 2]` is used; the other arguments are those of `AnchorNetwork`.
        """
        config = self.config
        mix = self.param("mix", nn.initializers.constant(0.8), ())
        mean = (observed[:, -1] - observed[:, -4]) / 3
        velocity = mix * (observed[:, -1] - observed[:, -2]) + (1 - mix) * mean
        ahead = jnp.arange(1, config.pred_len + 1, dtype=observed.dtype)[:, None]
        shape = (config.samples, config.pred_len, 2)
        moving = self.param("moving", _offsets(0.25), shape)[:, None]
        still = self.param("still", _offsets(0.1), shape)[:, None]
        scale = (length(mean) * config.pred_len)[:, None, None]
        heading = heading_of(mean, SLOW * config.period)[:, None]
        residual = turned(moving * scale + still, heading, 1)
        forecast = observed[:, -1:] + velocity[:, None] * ahead + residual
        return forecast, jnp.full(config.samples, -np.log(config.samples), observed.dtype)


def _offsets(scale: float) -> nn.initializers.Initializer:
    """Initialiser of `[k, steps, 2]`: offsets that grow with time; the first sample has none."""

    def initialise(key, shape, dtype=jnp.float32):
        time = jnp.arange(1, shape[1] + 1, dtype=dtype)[:, None] / shape[1]
        ends = scale * nn.initializers.normal(1.0)(key, (shape[0], 1, 2), dtype)
        return (ends * time).at[0].set(0.0)

    return initialise
