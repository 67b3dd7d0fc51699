"""The recurrent decoder: a first hidden state to `pred_len` displacements, each fed back in.

Without pooling inside the loop the chain hidden -> displacement -> embedding -> gates is affine, so
after the first step it is one matrix, added to the recurrent one. The fold changes results by float
rounding only.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.errors import InputError
from neurosym_jax.models.cell import cell_network, embed
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.layers import Affine, Perceptron
from neurosym_jax.models.pooling import Pooling

__all__ = ["Decoder", "Weigh", "pool", "pooling_network"]

Weigh = Callable[[Array, Array], Array]
"""`(positions [N, T, 2] metres, valid [N]) -> alpha [N, N, T]`."""


class Decoder(nn.Module):
    """Unrolls one scene's forecast, pooling at every predicted step if the config says so."""

    config: GeneratorConfig

    def setup(self):
        """Declare embedding, cell, output layer and, if used, pooling and its perceptron."""
        config = self.config
        self.spatial_embedding = Affine(2, config.embedding_dim)
        self.recurrent = cell_network(config.cell, config.embedding_dim, config.decoder_h_dim)
        self.hidden2pos = Affine(config.decoder_h_dim, 2)
        if config.pool_every_timestep:
            hidden = config.decoder_h_dim
            self.pooling = pooling_network(config, hidden)
            self.mlp = Perceptron((hidden + config.pooling.width(hidden), config.mlp_dim, hidden))

    def __call__(
        self,
        hidden: Array,
        observed: Array,
        displacement: Array,
        valid: Array,
        weigh: Weigh | None = None,
    ) -> Array:
        """Forecast displacements [N, pred_len, 2] in metres.

        `hidden` is the first hidden state [N, decoder_h_dim], `displacement [N, 2]` the last one
        observed. If NeuroSyM pools at predicted steps, `weigh` gives the alpha of the last
        `obs_len` positions, observed or predicted, up to a step.
        """
        if not self.config.pool_every_timestep:
            return self._folded(hidden, displacement)
        unroll = nn.scan(
            lambda decoder, state, valid: decoder._pooled_step(state, valid, weigh),
            variable_broadcast=("params", "training"),
            split_rngs={"params": False},
            in_axes=nn.broadcast,  # pyright: ignore[reportArgumentType]
            length=self.config.pred_len,
        )
        state = (self.config.cell.start(hidden), observed, displacement)
        _, displacements = unroll(self, state, valid)
        return jnp.moveaxis(displacements, 0, 1)

    def _folded(self, hidden: Array, displacement: Array) -> Array:
        cell = self.config.cell
        kernel, bias = embed(self.spatial_embedding, self.recurrent)
        recurrent = self.recurrent.recurrent_kernel
        feedback = recurrent + self.hidden2pos.kernel @ kernel
        feedback_bias = bias + self.hidden2pos.bias @ kernel

        def step(carry, _):
            gates, state = carry
            state = cell.update(gates, state)
            # The displacement is computed here: were the hidden states the loop's output, XLA would
            # compute them twice, once to be stacked and once for the product.
            return (state[0] @ feedback + feedback_bias, state), self.hidden2pos(state[0])

        gates = displacement @ kernel + bias + hidden @ recurrent
        carry = (gates, cell.start(hidden))
        _, displacements = jax.lax.scan(step, carry, length=self.config.pred_len)
        return jnp.moveaxis(displacements, 0, 1)

    def _pooled_step(self, carry: Any, valid: Array, weigh: Weigh | None):
        config = self.config
        state, track, displacement = carry
        kernel, bias = embed(self.spatial_embedding, self.recurrent)
        gates = displacement @ kernel + bias + state[0] @ self.recurrent.recurrent_kernel
        hidden, *rest = config.cell.update(gates, state)
        displacement = self.hidden2pos(hidden)
        position = track[:, -1] + displacement
        track = jnp.concatenate([track[:, 1:], position[:, None]], axis=1)
        alpha = None if weigh is None else weigh(track, valid)
        pooled = pool(self.pooling, config.pooling, hidden, track, valid, alpha)
        hidden = self.mlp(jnp.concatenate([hidden, pooled], axis=-1))
        return ((hidden, *rest), track, displacement), displacement


def pooling_network(config: GeneratorConfig, h_dim: int) -> Any:
    """The network of the config's pooling, for hidden states of size `h_dim`."""
    sizes = {"obs_len": config.obs_len, "embedding_dim": config.embedding_dim}
    return config.pooling.network(h_dim, **sizes)


def pool(
    network: Any, pooling: Pooling, hidden: Array, track: Array, valid: Any, alpha: Array | None
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
    given = {
        "hidden": hidden,
        "position": track[:, -1],
        "track": track,
        "alpha": alpha,
        "alpha_rows": alpha,
    }
    return network(valid=valid, **{name: given[name] for name in sorted(pooling.inputs)})
