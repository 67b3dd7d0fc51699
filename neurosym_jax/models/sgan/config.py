"""Configurations of SGAN's networks, and the table of poolings.

Defaults are those of the published SGAN checkpoints, which SGAN's own command line does
not have.
"""

import dataclasses
from typing import Annotated, Literal

from neurosym_jax.configuration import Checked, Size, Whole
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import Lengths
from neurosym_jax.forecasting.noise import NoiseSpec
from neurosym_jax.models.sgan.layers import CELLS, LSTM, Cell
from neurosym_jax.models.sgan.neurosym import AsDescribed, NeurosymIjcnn, NeurosymRos
from neurosym_jax.models.sgan.pooling import NoPooling, Pooling, PoolNet, Social
from neurosym_jax.plugins import Registry
from neurosym_jax.symbolic.weighting import WEIGHTINGS, Cnd, Weighting

__all__ = [
    "POOLINGS",
    "DiscriminatorConfig",
    "GeneratorConfig",
    "register_pooling",
]

POOLINGS: Registry[type[Pooling]] = Registry(
    "pooling",
    {
        "none": NoPooling,
        "pool_net": PoolNet,
        "social": Social,
        "as_described": AsDescribed,
        "neurosym_ros": NeurosymRos,
        "neurosym_ijcnn": NeurosymIjcnn,
    },
)

register_pooling = POOLINGS.register


@dataclasses.dataclass(frozen=True)
class GeneratorConfig(Lengths):
    """Architecture of a trajectory generator; numbers count units unless they say otherwise."""

    embedding_dim: Size = 16
    encoder_h_dim: Size = 32
    decoder_h_dim: Size = 32
    mlp_dim: Size = 64
    pooling: Annotated[Pooling, POOLINGS] = PoolNet()  # noqa: RUF009 (frozen)
    """How neighbours are pooled: a component with its own options, see `POOLINGS`."""
    pool_every_timestep: bool = False
    """Pool at predicted steps too. The symbols of NeuroSyM are then those of the last `obs_len`
    positions of each sample, observed or predicted."""
    cell: Annotated[Cell, CELLS] = LSTM()  # noqa: RUF009 (frozen)
    """The recurrent cell of encoder and decoder."""
    noise_dim: Whole = 8
    noise_type: Literal["gaussian", "uniform"] = "gaussian"
    noise_mix_type: Literal["global", "ped"] = "global"
    """One noise vector a scene, or one for each agent."""
    weighting: Annotated[Weighting | None, WEIGHTINGS] = None
    """Weights of pairs, for a pooling that takes alpha; its default is then the papers' `cnd`."""

    def __post_init__(self):
        super().__post_init__()
        if self.noise_dim >= self.decoder_h_dim:
            raise InputError(
                f"noise_dim must lie in [0, decoder_h_dim = {self.decoder_h_dim}), "
                f"not {self.noise_dim}: noise is a part of the decoder's first hidden state"
            )
        pooling = POOLINGS.name_of(self.pooling)
        if self.pool_every_timestep and (
            not self.pools or "alpha_rows" in self.pooling.inputs
        ):
            raise InputError(
                f"pool_every_timestep needs a pooling other than {pooling!r}"
            )
        if self.weighting is not None and not self.symbolic:
            raise InputError(
                f"pooling {pooling!r} has no symbols for a weighting to weight"
            )
        if self.weighting is None and self.symbolic:
            object.__setattr__(self, "weighting", Cnd())

    @property
    def noise(self) -> NoiseSpec:
        """The noise that each sample begins with."""
        return NoiseSpec(self.noise_dim, self.noise_mix_type == "ped", self.noise_type)

    @property
    def pools(self) -> bool:
        """Whether agents see each other."""
        return not isinstance(self.pooling, NoPooling)

    @property
    def symbolic(self) -> bool:
        """Whether pairs are weighted: NeuroSyM."""
        return "alpha" in self.pooling.inputs

    @property
    def needs_context_mlp(self) -> bool:
        """Whether a multi-layer perceptron stands between the encoder and the decoder."""
        return (
            self.noise_dim > 0 or self.pools or self.encoder_h_dim != self.decoder_h_dim
        )


@dataclasses.dataclass(frozen=True)
class DiscriminatorConfig(Checked):
    """Architecture of a trajectory discriminator: `local` scores h, `global` scores pooled h."""

    kind: Literal["global", "local"] = "global"
    embedding_dim: Size = 16
    h_dim: Size = 48
    mlp_dim: Size = 64
    pool_hidden_dim: Size = 512
