"""The discriminator of SGAN, for one scene: how real is each agent's whole trajectory?"""

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.models.cell import LSTM, Encoder
from neurosym_jax.models.config import DiscriminatorConfig
from neurosym_jax.models.layers import Perceptron
from neurosym_jax.models.pool_net import PoolNetwork

__all__ = ["Discriminator"]


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
