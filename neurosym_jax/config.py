"""The configurations of networks and of training: where hyper-parameters have their defaults.

The defaults are those of the published SGAN checkpoints, which are not those of SGAN's own command
line. Values are checked when a configuration is made; `configuration` has its JSON form.
"""

import dataclasses
from typing import Annotated, Literal

from neurosym_jax.configuration import (
    Count,
    Positive,
    Whole,
    component_from_text,
    refuse_misfits,
)
from neurosym_jax.errors import InputError
from neurosym_jax.models.poolings import POOLINGS
from neurosym_jax.symbolic.state_weightings import Cnd
from neurosym_jax.symbolic.weighting import Weighting
from neurosym_jax.symbolic.weightings import WEIGHTINGS

__all__ = ["DiscriminatorConfig", "GeneratorConfig"]


@dataclasses.dataclass(frozen=True)
class GeneratorConfig:
    """Architecture of a trajectory generator.

    Lengths are in time steps, `neighborhood_size` in metres, everything else counts units.
    """

    obs_len: Count = 8
    pred_len: Count = 8
    period: Positive = 0.4
    """Seconds between time steps, in training."""
    embedding_dim: Count = 16
    encoder_h_dim: Count = 32
    decoder_h_dim: Count = 32
    mlp_dim: Count = 64
    pooling: str = "pool_net"
    """`none`, SGAN's `pool_net`, S-LSTM's grid `social`, NeuroSyM in its variants `as_described`,
    `neurosym_ros` and `neurosym_ijcnn`, `encounter`; or what `models.register_pooling` was told."""
    bottleneck_dim: Count = 8
    pool_hidden_dim: Count = 512
    pool_every_timestep: bool = False
    """Pool at predicted steps too; the symbols of NeuroSyM are then those of the positions of the
    last `obs_len` steps, seen or predicted, of each sample its own."""
    neighborhood_size: Positive = 2.0
    grid_size: Count = 8
    beside_velocity: bool = False
    """Forecast how people deviate from constant velocity, which is itself the first sample: that of
    a noise of 0, and never learned from. Needs `noise_type` fixed."""
    noise_dim: Whole = 8
    noise_type: Literal["gaussian", "uniform", "fixed"] = "gaussian"
    """Drawn anew for each scene, or `fixed`: k vectors that are the same in every scene, which a
    network learns to spread its forecasts by (see `forecasting.noise`)."""
    noise_mix_type: Literal["global", "ped"] = "global"
    weighting: Annotated[Weighting | None, WEIGHTINGS] = None
    """Of NeuroSyM only, where it defaults to the papers' `cnd`; a kind by name will do."""

    def __post_init__(self):
        """Refuse, in words, what the networks cannot be built from."""
        if isinstance(self.weighting, str):
            weighting = component_from_text(self.weighting, WEIGHTINGS, "weighting")
            object.__setattr__(self, "weighting", weighting)
        refuse_misfits(self)
        if self.noise_dim >= self.decoder_h_dim:
            raise InputError(
                f"noise_dim must lie in [0, decoder_h_dim = {self.decoder_h_dim}), "
                f"not {self.noise_dim}: noise is a part of the decoder's first hidden state"
            )
        if self.noise_type == "fixed" and self.noise_mix_type == "ped":
            raise InputError("noise_type fixed needs noise_mix_type global: agents have no order")
        if self.beside_velocity and not (self.noise_type == "fixed" and self.noise_dim):
            raise InputError("beside_velocity needs noise_type fixed and a noise_dim above 0")
        pooling = POOLINGS[self.pooling]
        if self.pool_every_timestep and (pooling.module is None or not pooling.of_pairs):
            raise InputError(f"pool_every_timestep needs a pooling other than {self.pooling!r}")
        if self.weighting is not None and not self.symbolic:
            raise InputError(f"pooling {self.pooling!r} has no symbols for a weighting to weight")
        if self.weighting is None and self.symbolic:
            object.__setattr__(self, "weighting", Cnd())
        if pooling.returns_hidden and self.bottleneck_dim != self.encoder_h_dim:
            raise InputError(
                f"{self.pooling} pooling returns a hidden state: bottleneck_dim must equal "
                f"encoder_h_dim ({self.encoder_h_dim}), not {self.bottleneck_dim}"
            )

    @property
    def symbolic(self) -> bool:
        """Whether this is NeuroSyM."""
        return POOLINGS[self.pooling].symbolic

    @property
    def needs_context_mlp(self) -> bool:
        """Whether a multi-layer perceptron stands between the encoder and the decoder."""
        return (
            self.noise_dim > 0 or self.pooling != "none" or self.encoder_h_dim != self.decoder_h_dim
        )


@dataclasses.dataclass(frozen=True)
class DiscriminatorConfig:
    """Architecture of a trajectory discriminator: `local` scores h, `global` scores pooled h."""

    kind: Literal["global", "local"] = "global"
    embedding_dim: Count = 16
    h_dim: Count = 48
    mlp_dim: Count = 64
    pool_hidden_dim: Count = 512

    def __post_init__(self):
        """Refuse what a network cannot be built from."""
        refuse_misfits(self)
