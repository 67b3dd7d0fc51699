"""Frozen configurations and their JSON form: the only place a hyper-parameter has a default.

The defaults are those of the published SGAN checkpoints, which are not those of SGAN's own
command line. A configuration read from JSON is refused if it has a field we do not know or a
format we cannot read, so that a typo never trains or evaluates a different model.
"""

import dataclasses
import json
import math
import types
import typing
from typing import Any, Literal, TypeVar

from neurosym_jax.checks import refuse_below, refuse_seed
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
    "weighting_from_text",
]

FORMAT = 1


def _named(config: Any, *names: str) -> dict[str, Any]:
    return {name: getattr(config, name) for name in names}


@dataclasses.dataclass(frozen=True)
class GeneratorConfig:
    """Architecture of a trajectory generator.

    Lengths are in time steps, `neighborhood_size` in metres, everything else counts units.
    """

    obs_len: int = 8
    pred_len: int = 8
    period: float = 0.4
    """Seconds between time steps, in training."""
    embedding_dim: int = 16
    encoder_h_dim: int = 32
    decoder_h_dim: int = 32
    mlp_dim: int = 64
    pooling: str = "pool_net"
    """`none`, SGAN's `pool_net`, S-LSTM's grid `social`, NeuroSyM in its variants `as_described`,
    `neurosym_ros` and `neurosym_ijcnn`; or what `models.register_pooling` was told."""
    bottleneck_dim: int = 8
    pool_hidden_dim: int = 512
    pool_every_timestep: bool = False
    neighborhood_size: float = 2.0
    grid_size: int = 8
    noise_dim: int = 8
    noise_type: Literal["gaussian", "uniform"] = "gaussian"
    noise_mix_type: Literal["global", "ped"] = "global"
    weighting: WeightingConfig | None = None
    """Of NeuroSyM only, where it defaults to the papers' `cnd`; a kind by name will do."""

    def __post_init__(self):
        """Refuse, in words, what the networks cannot be built from."""
        counts = [field.name for field in dataclasses.fields(self) if field.type is int]
        refuse_below(1, _named(self, *(name for name in counts if name != "noise_dim")))
        for name in ("period", "neighborhood_size"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} must be positive, not {getattr(self, name)}")
        if not 0 <= self.noise_dim < self.decoder_h_dim:
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
        if isinstance(self.weighting, str):
            object.__setattr__(self, "weighting", WeightingConfig(self.weighting))
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
    embedding_dim: int = 16
    h_dim: int = 48
    mlp_dim: int = 64
    pool_hidden_dim: int = 512

    def __post_init__(self):
        """Refuse a layer without units."""
        refuse_below(1, _named(self, "embedding_dim", "h_dim", "mlp_dim", "pool_hidden_dim"))


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """A recipe: how a generator is trained. An earlier run without a field had its default."""

    seed: int = 0
    steps: int = 3000
    """Generator steps."""
    batch_scenes: int = 64
    """Scenes in a batch, about: their proportions by size are fixed."""
    max_agents: int | None = 16
    """Larger scenes are cropped, anew each time, to an agent and its nearest neighbours."""
    best_k: int = 20
    """Samples of the variety loss, of which the best is learned from."""
    criterion: Literal["squared_displacement", "distance"] = "distance"
    """What best means: SGAN's squared displacements, or ADE and FDE each with its own best."""
    fde_weight: float = 0.5
    """Of the FDE term of the criterion `distance`."""
    weigh_scenes: Literal["equally", "by_agents"] = "by_agents"
    """SGAN's loss sums over scenes, whatever their size; the test's average runs over agents."""
    l2_weight: float = 1.0
    adversarial_weight: float = 0.0
    """0 trains no discriminator."""
    label_real: tuple[float, float] = (0.7, 1.2)
    """Range of the smoothed label of real trajectories, one draw a step."""
    label_fake: tuple[float, float] = (0.0, 0.3)
    g_learning_rate: float = 1e-2
    d_learning_rate: float = 1e-3
    schedule: Literal["constant", "cosine"] = "cosine"
    warmup_steps: int = 100
    clip_norm: float = 2.0
    """Largest norm of the generator's gradient; 0 for no clipping."""
    rotate: bool | float = 1.0
    """Share of the training scenes turned at random, and half of them mirrored; true is 1."""
    scale: float = 0.0
    """Stretch each training scene by a random factor within 1 +- scale."""
    jitter: float = 0.0
    """Largest standard deviation, in metres, of errors added to a scene's observed positions."""
    ema: float = 0.0
    """Decay of the averaged parameters that are validated and kept; 0 keeps the raw ones."""
    validate_every: int = 500
    """Steps between validations; the best state by validation is kept."""
    select_by: Literal["ade", "ade_fde"] = "ade_fde"
    """Joint validation error that the best state has least of."""
    discriminator: DiscriminatorConfig = DiscriminatorConfig()

    def __post_init__(self):
        """Refuse, before any step, what would fail late or train nothing."""
        refuse_seed(self.seed)
        counts = ("steps", "batch_scenes", "max_agents", "best_k", "validate_every")
        refuse_below(1, _named(self, *counts))
        weights = ("l2_weight", "fde_weight", "adversarial_weight")
        refuse_below(0, _named(self, *weights, "warmup_steps", "clip_norm", "jitter"))
        if self.l2_weight == self.adversarial_weight == 0:
            raise InputError("l2_weight and adversarial_weight are 0: nothing would be learned")
        for name in ("g_learning_rate", "d_learning_rate"):
            if not 0 < getattr(self, name) < math.inf:
                raise InputError(f"{name} must be positive, not {getattr(self, name)}")
        if not 0 <= self.rotate <= 1:
            raise InputError(f"rotate must lie in [0, 1], not {self.rotate}")
        for name in ("scale", "ema"):
            if not 0 <= getattr(self, name) < 1:
                raise InputError(f"{name} must lie in [0, 1), not {getattr(self, name)}")
        for name in ("label_real", "label_fake"):
            low, high = getattr(self, name)
            if not -math.inf < low <= high < math.inf:
                raise InputError(f"{name} must be a range of numbers, not [{low}, {high}]")


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

Config = TypeVar("Config")

_FORMER: dict[type, dict[str, Any]] = {TrainConfig: {"shards": 1}}
"""Fields that earlier versions wrote, and the value that means what is done without them."""


def to_json(config: Any) -> dict[str, Any]:
    """The plain dictionary form of a configuration, with its format version."""
    return {"format": FORMAT, **dataclasses.asdict(config)}


def from_json(cls: type[Config], data: dict[str, Any] | str, source: str = "config") -> Config:
    """Build `cls` from its JSON form (a dictionary or text).

    Raises:
        InputError: naming `source` and the field, for an unknown format, an unknown field, or a
            value of the wrong type.
    """
    try:
        fields: Any = json.loads(data) if isinstance(data, str) else data
    except json.JSONDecodeError as error:
        raise InputError(f"{source}: not JSON ({error})") from None
    if not isinstance(fields, dict):
        raise InputError(f"{source}: not a JSON object")
    fields = dict(fields)
    version = fields.pop("format", None)
    if version != FORMAT:
        raise InputError(f"{source}: format {version!r} is not the format {FORMAT} of this version")
    for name, value in _FORMER.get(cls, {}).items():
        if fields.get(name) == value:
            del fields[name]
    hints = typing.get_type_hints(cls)
    for name, value in fields.items():
        if name not in hints:
            raise InputError(f"{source}: unknown field {name!r} for {cls.__name__}")
        hint = hints[name]
        of = next((kind for kind in (hint, *typing.get_args(hint)) if _is_config(kind)), None)
        if of is not None and isinstance(value, dict):
            fields[name] = from_json(of, {"format": FORMAT, **value}, f"{source}: {name}")
        elif of is WeightingConfig and isinstance(value, str):
            fields[name] = weighting_from_text(value, source)
        elif typing.get_origin(hint) is tuple and isinstance(value, list):
            fields[name] = tuple(value)
        if not _fits(fields[name], hint):
            raise InputError(f"{source}: {name} = {value!r} does not fit {hint}")
    try:
        return cls(**fields)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def weighting_from_text(text: str, source: str = "weighting") -> WeightingConfig:
    """The weighting of this `name`: `KIND[,FIELD=VALUE...]`.

    Raises:
        InputError: naming `source`, for an unknown kind or field, or a value that does not fit.
    """
    kind, *changes = text.split(",")
    fields: dict[str, Any] = {"format": FORMAT, "kind": kind}
    for change in changes:
        field, _, value = change.partition("=")
        try:
            fields[field] = json.loads(value)
        except json.JSONDecodeError:
            fields[field] = value
    return from_json(WeightingConfig, fields, source)


def _is_config(hint: Any) -> bool:
    return isinstance(hint, type) and dataclasses.is_dataclass(hint)


def _fits(value: Any, hint: Any) -> bool:
    origin = typing.get_origin(hint)
    if origin is Literal:
        return value in typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return any(_fits(value, option) for option in typing.get_args(hint))
    if origin is tuple:
        of = typing.get_args(hint)
        return isinstance(value, tuple) and len(value) == len(of) and all(map(_fits, value, of))
    if hint in (int, float):
        return isinstance(value, int | hint) and not isinstance(value, bool)
    return not isinstance(hint, type) or isinstance(value, hint)
