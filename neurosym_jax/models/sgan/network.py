"""The generator of SGAN and NeuroSyM, for one scene and one noise, and SGAN's discriminator.

Encoding does not depend on the noise, so best-of-k encodes once and maps `decode` over
k noises. It has two parts: `observe` (recurrent) looks at no neighbour, `interact`
(pooling, context) does.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.models.sgan.config import DiscriminatorConfig, GeneratorConfig
from neurosym_jax.models.sgan.layers import (
    LSTM,
    Affine,
    Encoder,
    Perceptron,
    embed,
    with_bias,
)
from neurosym_jax.models.sgan.pooling import Pooling, PoolNetwork
from neurosym_jax.scene import Scene

__all__ = ["Decoder", "Discriminator", "Generator", "Weigh", "pool", "pooling_network"]

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
        return self.context_mlp(context) if self.config.needs_context_mlp else context

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

        def step(carry, _):
            gates, state = carry
            # The bias is added here: were the sum carried, XLA would store it in a pass
            # of its own.
            state = cell.update(with_bias(gates, feedback_bias), state)
            # The displacement is computed here: were the hidden states the loop's
            # output, XLA would compute them twice, once to be stacked and once for the
            # product.
            return (state[0] @ feedback, state), self.hidden2pos(state[0])

        # `feedback_bias` has the output layer's bias, which the displacement observed
        # has not.
        gates = (
            with_bias(displacement, -self.hidden2pos.bias) @ kernel + hidden @ recurrent
        )
        carry = gates, cell.start(hidden)
        _, displacements = jax.lax.scan(step, carry, length=self.config.pred_len)
        return jnp.moveaxis(displacements, 0, 1)

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
