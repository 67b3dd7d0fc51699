"""The configurations of networks and of training: where hyper-parameters have their defaults.

The defaults are those of the published SGAN checkpoints, which are not those of SGAN's own command
line. Values are checked when a configuration is made; its JSON form is that of `config_json`.
"""

import dataclasses
from typing import ClassVar, Literal

from neurosym_jax.checks import (
    BelowOne,
    Count,
    Interval,
    NotNegative,
    Positive,
    Seed,
    Share,
    Whole,
    refuse_misfits,
)
from neurosym_jax.config_json import FORMAT, from_json, to_json
from neurosym_jax.errors import InputError
from neurosym_jax.models.pooling import POOLINGS
from neurosym_jax.symbolic.weighting_config import WeightingConfig

__all__ = [
    "FORMAT",
    "RECIPES",
    "DiscriminatorConfig",
    "GeneratorConfig",
    "TrainConfig",
    "from_json",
    "to_json",
]


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
    `neurosym_ros` and `neurosym_ijcnn`; or what `models.register_pooling` was told."""
    bottleneck_dim: Count = 8
    pool_hidden_dim: Count = 512
    pool_every_timestep: bool = False
    neighborhood_size: Positive = 2.0
    grid_size: Count = 8
    noise_dim: Whole = 8
    noise_type: Literal["gaussian", "uniform"] = "gaussian"
    noise_mix_type: Literal["global", "ped"] = "global"
    weighting: WeightingConfig | None = None
    """Of NeuroSyM only, where it defaults to the papers' `cnd`; a kind by name will do."""

    def __post_init__(self):
        """Refuse, in words, what the networks cannot be built from."""
        if isinstance(self.weighting, str):
            object.__setattr__(self, "weighting", WeightingConfig.from_text(self.weighting))
        refuse_misfits(self)
        if self.noise_dim >= self.decoder_h_dim:
            raise InputError(
                f"noise_dim must lie in [0, decoder_h_dim = {self.decoder_h_dim}), "
                f"not {self.noise_dim}: noise is a part of the decoder's first hidden state"
            )
        pooling = POOLINGS[self.pooling]
        if self.pool_every_timestep and pooling.module is None:
            raise InputError(f"pool_every_timestep needs a pooling other than {self.pooling!r}")
        if self.pool_every_timestep and not pooling.every_step:
            raise InputError(
                f"pool_every_timestep with {self.pooling}: it pools observed steps, and symbols or "
                "histories of predicted steps are not defined"
            )
        if self.weighting is not None and not self.symbolic:
            raise InputError(f"pooling {self.pooling!r} has no symbols for a weighting to weight")
        if self.weighting is None and self.symbolic:
            object.__setattr__(self, "weighting", WeightingConfig())
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


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """A recipe: how a generator is trained. An earlier run without a field had its default."""

    seed: Seed = 0
    steps: Count = 3000
    """Generator steps."""
    batch_scenes: Count = 64
    """Scenes in a batch, about: their proportions by size are fixed."""
    max_agents: Count | None = 16
    """Larger scenes are cropped, anew each time, to an agent and its nearest neighbours."""
    best_k: Count = 20
    """Samples of the variety loss, of which the best is learned from."""
    criterion: Literal["squared_displacement", "distance"] = "distance"
    """What best means: SGAN's squared displacements, or ADE and FDE each with its own best."""
    fde_weight: NotNegative = 0.5
    """Of the FDE term of the criterion `distance`."""
    weigh_scenes: Literal["equally", "by_agents"] = "by_agents"
    """SGAN's loss sums over scenes, whatever their size; the test's average runs over agents."""
    l2_weight: NotNegative = 1.0
    adversarial_weight: NotNegative = 0.0
    """0 trains no discriminator."""
    label_real: Interval = (0.7, 1.2)
    """Range of the smoothed label of real trajectories, one draw a step."""
    label_fake: Interval = (0.0, 0.3)
    g_learning_rate: Positive = 1e-2
    d_learning_rate: Positive = 1e-3
    schedule: Literal["constant", "cosine"] = "cosine"
    warmup_steps: Whole = 100
    clip_norm: NotNegative = 2.0
    """Largest norm of the generator's gradient; 0 for no clipping."""
    rotate: bool | Share = 1.0
    """Share of the training scenes turned at random, and half of them mirrored; true is 1."""
    scale: BelowOne = 0.0
    """Stretch each training scene by a random factor within 1 +- scale."""
    jitter: NotNegative = 0.0
    """Largest standard deviation, in metres, of errors added to a scene's observed positions."""
    ema: BelowOne = 0.0
    """Decay of the averaged parameters that are validated and kept; 0 keeps the raw ones."""
    validate_every: Count = 500
    """Steps between validations; the best state by validation is kept."""
    select_by: Literal["ade", "ade_fde"] = "ade_fde"
    """Joint validation error that the best state has least of."""
    discriminator: DiscriminatorConfig = DiscriminatorConfig()
    FORMER: ClassVar = {"shards": 1}

    def __post_init__(self):
        """Refuse, before any step, what would fail late or train nothing."""
        refuse_misfits(self)
        if self.l2_weight == self.adversarial_weight == 0:
            raise InputError("l2_weight and adversarial_weight are 0: nothing would be learned")


RECIPES = {
    "ours": TrainConfig(rotate=0.5, scale=0.3, jitter=0.04),
    "sgan": TrainConfig(
        max_agents=None,
        steps=8400,
        criterion="squared_displacement",
        weigh_scenes="equally",
        adversarial_weight=1.0,
        # The released code smooths zeros by multiplying them by the random number: they stay 0.
        label_fake=(0.0, 0.0),
        g_learning_rate=1e-4,
        schedule="constant",
        warmup_steps=0,
        rotate=0.0,
        select_by="ade",
    ),
}
"""`sgan` is the published procedure; `ours` is justified in docs/training.md."""
