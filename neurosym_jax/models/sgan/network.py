"""SGAN and NeuroSyM: configurations, generator and discriminator, and the forecast of one
scene.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Annotated, Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Checked, Size, Whole
from neurosym_jax.errors import InputError
from neurosym_jax.models.forecaster import Lengths, NoiseSpec, with_weighting
from neurosym_jax.models.sgan.pooling import (
    CELLS,
    LSTM,
    Affine,
    AsDescribed,
    Cell,
    Encoder,
    NeurosymIjcnn,
    NeurosymRos,
    NoPooling,
    Perceptron,
    Pooling,
    PoolNet,
    PoolNetwork,
    Social,
    embed,
    with_bias,
)
from neurosym_jax.plugins import Registry
from neurosym_jax.scene import Scene, make_scene
from neurosym_jax.symbolic.weighting import WEIGHTINGS, Cnd, Weighting

__all__ = [
    "POOLINGS",
    "Decoder",
    "Discriminator",
    "DiscriminatorConfig",
    "Generator",
    "GeneratorConfig",
    "Weigh",
    "decode_scene",
    "encode_scene",
    "init_generator",
    "interact_scene",
    "pool",
    "pooling_network",
    "register_pooling",
]


# Configurations of SGAN's networks, and the table of poolings.
#
# Defaults are those of the published SGAN checkpoints, which SGAN's own command line does
# not have.

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
        can_repeat = self.pools and "alpha_rows" not in self.pooling.inputs
        if self.pool_every_timestep and not can_repeat:
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


# The generator of SGAN and NeuroSyM, for one scene and one noise, and SGAN's
# discriminator.
#
# Encoding does not depend on the noise, so best-of-k encodes once and maps `decode` over
# k noises. It has two parts: `observe` (recurrent) looks at no neighbour, `interact`
# (pooling, context) does.

Weigh = Callable[[Array, Array], Array]
"""`(positions [N, T, 2] metres, valid [N]) -> alpha [N, N, T]`."""


class Generator(nn.Module):
    """LSTM encoder, pooling over neighbours, noise, LSTM decoder (Gupta et al., CVPR 2018)."""

    config: GeneratorConfig

    def setup(self):
        """Declare the parts that the config asks for."""
        config = self.config
        self.encoder = Encoder(config.cell, config.embedding_dim, config.encoder_h_dim)
        if config.pools:
            self.pooling = pooling_network(config, config.encoder_h_dim)
        if config.needs_context_mlp:
            inputs = config.encoder_h_dim + config.pooling.width(config.encoder_h_dim)
            outputs = config.decoder_h_dim - config.noise_dim
            self.context_mlp = Perceptron((inputs, config.mlp_dim, outputs))
        self.decoder = Decoder(config)

    def __call__(
        self,
        scene: Scene,
        noise: Array,
        alpha: Array | None = None,
        weigh: Weigh | None = None,
    ) -> Array:
        """One forecast of `scene`: `[N, pred_len, 2]` displacements in metres.

        `noise` is `[noise_dim]`, or `[N, noise_dim]` if drawn per agent. NeuroSyM needs
        the weights `alpha [N, N, obs_len]`, and `weigh` if it pools at predicted steps
        (see `Decoder`).
        """
        hidden = self.observe(jnp.asarray(scene.displacement))
        return self.decode(self.interact(hidden, scene, alpha), scene, noise, weigh)

    def observe(self, displacement: Array) -> Array:
        """Hidden states `[N, encoder_h_dim]` after `displacement [N, obs_len, 2]`, in metres."""
        return self.encoder(displacement)

    def interact(
        self, context: Array, scene: Scene, alpha: Array | None = None
    ) -> Array:
        """Context `[N, decoder_h_dim - noise_dim]` from the `context [N, H]` of `observe`."""
        if self.config.pools:
            context = jnp.concatenate(
                [context, self.pool(context, scene, alpha)], axis=-1
            )
        if self.config.needs_context_mlp:
            return self.context_mlp(context)
        return context

    def pool(self, context: Array, scene: Scene, alpha: Array | None = None) -> Array:
        """The vectors `[N, B]` that `interact` adds to `context`; the config must pool."""
        track = jnp.asarray(scene.observed)
        return pool(
            self.pooling, self.config.pooling, context, track, scene.valid, alpha
        )

    def decode(
        self, context: Array, scene: Scene, noise: Array, weigh: Weigh | None = None
    ) -> Array:
        """Forecast displacements `[N, pred_len, 2]` from `context` and one noise, see `Decoder`."""
        noise = jnp.broadcast_to(noise, (context.shape[0], self.config.noise_dim))
        hidden = jnp.concatenate([context, noise.astype(context.dtype)], axis=-1)
        return self.decoder(
            hidden, scene, jnp.asarray(scene.displacement)[:, -1], weigh
        )


class Decoder(nn.Module):
    """A first hidden state to `pred_len` displacements, each fed back in.

    Without pooling inside the loop the chain hidden -> displacement -> embedding ->
    gates is affine, so after the first step it is one matrix, added to the recurrent
    one. The fold changes results by float rounding only.
    """

    config: GeneratorConfig

    def setup(self):
        """Declare embedding, cell, output layer and, if used, pooling and its perceptron."""
        config = self.config
        self.spatial_embedding = Affine(2, config.embedding_dim)
        self.recurrent = config.cell.scoped(config.embedding_dim, config.decoder_h_dim)
        self.hidden2pos = Affine(config.decoder_h_dim, 2)
        if config.pool_every_timestep:
            hidden = config.decoder_h_dim
            self.pooling = pooling_network(config, hidden)
            self.mlp = Perceptron(
                (hidden + config.pooling.width(hidden), config.mlp_dim, hidden)
            )

    def __call__(
        self, hidden: Array, scene: Scene, displacement: Array, weigh: Weigh | None
    ) -> Array:
        """Forecast displacements [N, pred_len, 2] in metres.

        `hidden` is the first hidden state [N, decoder_h_dim], `displacement [N, 2]` the
        last one observed. If NeuroSyM pools at predicted steps, `weigh` gives the alpha
        of the last `obs_len` positions, observed or predicted, up to a step.
        """
        if not self.config.pool_every_timestep:
            return self._folded(hidden, displacement)
        unroll = nn.scan(
            lambda decoder, carry, _: decoder._pooled_step(carry, scene.valid, weigh),
            variable_broadcast=("params", "training"),
            split_rngs={"params": False},
            length=self.config.pred_len,
        )
        carry = (
            self.config.cell.start(hidden),
            jnp.asarray(scene.observed),
            displacement,
        )
        _, displacements = unroll(self, carry, None)
        return jnp.moveaxis(displacements, 0, 1)

    def _folded(self, hidden: Array, displacement: Array) -> Array:
        cell, recurrent = self.config.cell, self.recurrent.recurrent_kernel
        kernel, bias = embed(self.spatial_embedding, self.recurrent)
        feedback = recurrent + self.hidden2pos.kernel @ kernel
        feedback_bias = bias + self.hidden2pos.bias @ kernel

        def displaced(gates, state):
            # The bias is added here: were the sum carried, XLA would store it in a pass
            # of its own.
            state = cell.update(with_bias(gates, feedback_bias), state)
            # The displacement is computed here: were the hidden states the loop's
            # output, XLA would compute them twice, once to be stacked and once for the
            # product.
            return state, self.hidden2pos(state[0])

        def step(state, _):
            return displaced(state[0] @ feedback, state)

        # `feedback_bias` has the output layer's bias, which the displacement observed
        # has not.
        unbiased = with_bias(displacement, -self.hidden2pos.bias)
        gates = unbiased @ kernel + hidden @ recurrent
        # The first step stands apart, so that the last computes no gates that no step
        # reads.
        state, first = displaced(gates, cell.start(hidden))
        _, others = jax.lax.scan(step, state, length=self.config.pred_len - 1)
        return jnp.moveaxis(jnp.concatenate([first[None], others]), 0, 1)

    def _pooled_step(self, carry: Any, valid: Any, weigh: Weigh | None):
        state, track, displacement = carry
        kernel, bias = embed(self.spatial_embedding, self.recurrent)
        gates = with_bias(displacement @ kernel, bias)
        gates = gates + state[0] @ self.recurrent.recurrent_kernel
        hidden, *rest = self.config.cell.update(gates, state)
        displacement = self.hidden2pos(hidden)
        position = (track[:, -1] + displacement)[:, None]
        track = jnp.concatenate([track[:, 1:], position], axis=1)
        alpha = None if weigh is None else weigh(track, valid)
        pooled = pool(self.pooling, self.config.pooling, hidden, track, valid, alpha)
        hidden = self.mlp(jnp.concatenate([hidden, pooled], axis=-1))
        return ((hidden, *rest), track, displacement), displacement


def pooling_network(config: GeneratorConfig, h_dim: int) -> Any:
    """The network of the config's pooling, for hidden states of size `h_dim`."""
    return config.pooling.network(
        h_dim, obs_len=config.obs_len, embedding_dim=config.embedding_dim
    )


def pool(
    network: Any,
    pooling: Pooling,
    hidden: Array,
    track: Array,
    valid: Any,
    alpha: Array | None,
) -> Array:
    """Pooled vectors [N, B]: `network` called with the inputs that its `pooling` names.

    Raises:
        InputError: without the alpha that the pooling takes.
    """
    if alpha is None and "alpha" in pooling.inputs:
        raise InputError(
            f"{pooling.title} needs alpha [N, N, obs_len]: config.weighting.alpha({{}}, observed), "
            "or call nj.forecast, which computes it"
        )
    inputs = {"hidden": hidden, "position": track[:, -1], "track": track}
    inputs |= {"alpha": alpha, "alpha_rows": alpha}
    return network(
        valid=valid, **{name: inputs[name] for name in sorted(pooling.inputs)}
    )


class Discriminator(nn.Module):
    """LSTM over observation and future; `global` scores pooled states, `local` the agent's own."""

    config: DiscriminatorConfig

    def setup(self):
        """Declare encoder, pooling (global only) and classifier."""
        config = self.config
        self.encoder = Encoder(LSTM(), config.embedding_dim, config.h_dim)
        if config.kind == "global":
            self.pooling = PoolNetwork(
                config.embedding_dim, config.h_dim, config.pool_hidden_dim, config.h_dim
            )
        self.classifier = Perceptron((config.h_dim, config.mlp_dim, 1))

    def __call__(self, positions: Array, displacement: Array, valid: Array) -> Array:
        """Scores `[N]`, at least 0, of `positions [N, T, 2]` and their steps, the first zero."""
        return self.score(self.observe(displacement), positions, valid)

    def observe(self, displacement: Array) -> Array:
        """Hidden states `[N, h_dim]`; looks at no neighbour."""
        return self.encoder(displacement)

    def score(self, hidden: Array, positions: Array, valid: Array) -> Array:
        """Scores `[N]` of agents with these hidden states."""
        if self.config.kind == "global":
            # The released code pools at the trajectory's first position, not its last.
            hidden = self.pooling(hidden, positions[:, 0], valid)
        return jnp.squeeze(self.classifier(hidden), -1)


# The generator as functions of one scene: initialisation, encoding, pooling, decoding.


@functools.partial(jax.jit, static_argnums=0)
def init_generator(config: GeneratorConfig, key: Array) -> Any:
    """New parameters, as SGAN draws them, and those of the weighting; consumes `key`."""
    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    pairs = (1,) if "alpha_rows" in config.pooling.inputs else (1, 1)
    alpha = np.zeros((*pairs, config.obs_len))
    weigh = (lambda *_: alpha) if config.symbolic else None
    params = Generator(config).init(
        key, scene, np.zeros((1, config.noise_dim)), alpha, weigh
    )
    return with_weighting(params, config.weighting)


def encode_scene(config: GeneratorConfig, params: Any, scene: Scene) -> Any:
    """Context `[N, C]` of one scene: encoding, symbols and alpha (NeuroSyM), pooling."""
    hidden = Generator(config).apply(
        params, scene.displacement, method=Generator.observe
    )
    return interact_scene(config, params, hidden, scene)


def interact_scene(
    config: GeneratorConfig,
    params: Any,
    hidden: Any,
    scene: Scene,
    method: Callable[..., Any] = Generator.interact,
) -> Any:
    """The part of `encode_scene` that looks at neighbours, after the encoding `hidden [N, H]`.

    `method` is the generator's `interact`, or its `pool` for the pooled vectors.
    """
    weigh = _weighting(config, params)
    alpha = scene.alpha
    if alpha is None and weigh is not None:
        alpha = weigh(jnp.asarray(scene.observed), jnp.asarray(scene.valid))
    return Generator(config).apply(params, hidden, scene, alpha, method=method)


def decode_scene(
    config: GeneratorConfig, params: Any, context: Array, scene: Scene, noise: Array
) -> Array:
    """`[k, N, pred_len, 2]` metres relative to the scene's origin; see `Forecaster.forecast`."""
    weigh = _weighting(config, params)

    def decode(noise: Array) -> Any:
        inputs = (context, scene, noise, weigh)
        return Generator(config).apply(params, *inputs, method=Generator.decode)

    if config.pool_every_timestep:
        # One sample after the other: arrays of all samples' pairs do not stay in the
        # cache.
        displacement: Any = jax.lax.map(decode, noise)
    else:
        displacement = jax.vmap(decode)(noise)
    last = jnp.asarray(scene.observed)[None, :, -1, None]
    return last + jnp.cumsum(displacement, axis=-2)


def _weighting(config: GeneratorConfig, params: Any) -> Weigh | None:
    """The config's weighting with its trained parameters; None for a model without symbols."""
    weighting = config.weighting
    if weighting is None:
        return None
    learned = params.get("weighting", {})
    return functools.partial(weighting.alpha, learned, period=config.period)
