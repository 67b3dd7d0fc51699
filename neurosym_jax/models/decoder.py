"""The LSTM decoder: a first hidden state to `pred_len` displacements, each fed back in.

Without pooling inside the loop the chain hidden -> displacement -> embedding -> gates is affine, so
after the first step it is one matrix, added to the recurrent one. The fold changes results by float
rounding only.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.models.layers import Affine, Perceptron
from neurosym_jax.models.lstm import LSTMParameters, lstm_update
from neurosym_jax.models.poolings import POOLINGS, make_pooling

__all__ = ["Decoder", "Weigh"]

Weigh = Callable[[Array, Array], Array]
"""`(positions [N, T, 2] metres, valid [N]) -> alpha [N, N, T]`."""


class Decoder(nn.Module):
    """Unrolls one scene's forecast, pooling at every predicted step if the config says so."""

    config: GeneratorConfig

    def setup(self):
        """Declare embedding, LSTM, output layer and, where used, pooling and its perceptron."""
        config = self.config
        self.spatial_embedding = Affine(2, config.embedding_dim)
        self.lstm = LSTMParameters(config.embedding_dim, config.decoder_h_dim)
        self.hidden2pos = Affine(config.decoder_h_dim, 2)
        if config.pool_every_timestep:
            self.pooling = make_pooling(config, config.decoder_h_dim)
            self.mlp = Perceptron(
                (
                    config.decoder_h_dim + config.bottleneck_dim,
                    config.mlp_dim,
                    config.decoder_h_dim,
                )
            )

    def __call__(
        self,
        hidden: Array,
        observed: Array,
        displacement: Array,
        valid: Array,
        weigh: Weigh | None = None,
    ) -> Array:
        """Forecast displacements.

        Args:
            hidden: [N, decoder_h_dim] first hidden state; the cell state starts at zero.
            observed: [N, obs_len, 2] positions, metres.
            displacement: [N, 2] last observed displacement, metres.
            valid: [N] bool.
            weigh: of NeuroSyM where it pools at predicted steps: alpha of the positions of the last
                `obs_len` steps, seen or predicted. Nothing later than a step is in it.

        Returns:
            [N, pred_len, 2] displacements, metres.
        """
        base = displacement if self.config.beside_velocity else None
        if self.config.pool_every_timestep:
            return self._pooled(hidden, observed, displacement, base, valid, weigh)
        return self._folded(hidden, displacement, base)

    def _folded(self, hidden: Array, displacement: Array, base: Array | None) -> Array:
        kernel, bias = self.lstm.after(self.spatial_embedding)
        recurrent = self.lstm.recurrent_kernel
        feedback = recurrent + self.hidden2pos.kernel @ kernel
        feedback_bias = bias + self.hidden2pos.bias @ kernel
        if base is not None:
            feedback_bias = feedback_bias + base @ kernel

        def step(state, _):
            gates, cell = state
            hidden, cell = lstm_update(gates, cell)
            # Here and not after the loop: were the hidden states its output, they would be
            # computed twice, once to be stacked and once for the product.
            return (hidden @ feedback + feedback_bias, cell), self.hidden2pos(hidden)

        gates = displacement @ kernel + bias + hidden @ recurrent
        state = (gates, jnp.zeros_like(hidden))
        _, displacements = jax.lax.scan(step, state, length=self.config.pred_len)
        displacements = jnp.moveaxis(displacements, 0, 1)
        return displacements if base is None else displacements + base[:, None]

    def _pooled(
        self,
        hidden: Array,
        observed: Array,
        displacement: Array,
        base: Array | None,
        valid: Array,
        weigh: Weigh | None,
    ) -> Array:
        unroll = nn.scan(
            lambda decoder, state, valid: decoder._pooled_step(state, base, valid, weigh),
            variable_broadcast="params",
            split_rngs={"params": False},
            in_axes=nn.broadcast,  # pyright: ignore[reportArgumentType]
            length=self.config.pred_len,
        )
        track = observed if POOLINGS[self.config.pooling].windowed else observed[:, -1:]
        state = (hidden, jnp.zeros_like(hidden), track, displacement)
        _, displacements = unroll(self, state, valid)
        return jnp.moveaxis(displacements, 0, 1)

    def _pooled_step(
        self,
        state: tuple[Array, ...],
        base: Array | None,
        valid: Array,
        weigh: Weigh | None,
    ):
        hidden, cell, track, displacement = state
        kernel, bias = self.lstm.after(self.spatial_embedding)
        gates = displacement @ kernel + bias + hidden @ self.lstm.recurrent_kernel
        hidden, cell = lstm_update(gates, cell)
        displacement = self.hidden2pos(hidden)
        if base is not None:
            displacement = displacement + base
        position = track[:, -1] + displacement
        track = jnp.concatenate([track[:, 1:], position[:, None]], axis=1)
        pooling = POOLINGS[self.config.pooling]
        weights = () if weigh is None else (weigh(track, valid),)
        pooled = self.pooling(hidden, track if pooling.windowed else position, valid, *weights)
        hidden = self.mlp(jnp.concatenate([hidden, pooled], axis=-1))
        return (hidden, cell, track, displacement), displacement
