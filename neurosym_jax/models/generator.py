"""The generator of SGAN and NeuroSyM, for one scene and one noise vector.

`encode` does not depend on the noise, so best-of-k encodes once and maps `decode` over k noises. It
has two parts: `observe` (recurrent) looks at no neighbour, `interact` (pooling, context) does.
`jax.vmap` adds axes for scenes in a batch and samples (see `forecasting.networks`).
"""

import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.models.cell import Encoder
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.decoder import Decoder, Weigh, pool, pooling_network
from neurosym_jax.models.layers import Perceptron
from neurosym_jax.scene import Scene

__all__ = ["Generator"]


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
            pooled = config.pooling.width(config.encoder_h_dim)
            inputs, outputs = config.encoder_h_dim + pooled, config.decoder_h_dim - config.noise_dim
            self.context_mlp = Perceptron((inputs, config.mlp_dim, outputs))
        self.decoder = Decoder(config)

    def __call__(
        self, scene: Scene, noise: Array, alpha: Array | None = None, weigh: Weigh | None = None
    ) -> Array:
        """One forecast of `scene`: `[N, pred_len, 2]` displacements in metres.

        `noise` is `[noise_dim]`, or `[N, noise_dim]` if drawn per agent. NeuroSyM needs the weights
        `alpha [N, N, obs_len]`, and `weigh` if it pools at predicted steps (see `Decoder`).
        """
        return self.decode(self.encode(scene, alpha), scene, noise, weigh)

    def encode(self, scene: Scene, alpha: Array | None = None) -> Array:
        """Context before the noise: `[N, decoder_h_dim - noise_dim]`."""
        return self.interact(self.observe(jnp.asarray(scene.displacement)), scene, alpha)

    def observe(self, displacement: Array) -> Array:
        """Hidden states `[N, encoder_h_dim]` after `displacement [N, obs_len, 2]`, in metres."""
        return self.encoder(displacement)

    def interact(self, context: Array, scene: Scene, alpha: Array | None = None) -> Array:
        """The result of `encode`, from the hidden states `context [N, H]` of `observe`."""
        if self.config.pools:
            pooled = self.pool(context, scene, alpha)
            context = jnp.concatenate([context, pooled], axis=-1)
        return self.context_mlp(context) if self.config.needs_context_mlp else context

    def pool(self, context: Array, scene: Scene, alpha: Array | None = None) -> Array:
        """The vectors `[N, B]` that `interact` adds to `context`; the config must pool."""
        track = jnp.asarray(scene.observed)
        return pool(self.pooling, self.config.pooling, context, track, scene.valid, alpha)

    def decode(
        self, context: Array, scene: Scene, noise: Array, weigh: Weigh | None = None
    ) -> Array:
        """Forecast displacements `[N, pred_len, 2]` from `context` and one noise, see `Decoder`."""
        noise = jnp.broadcast_to(noise, (context.shape[0], self.config.noise_dim))
        hidden = jnp.concatenate([context, noise.astype(context.dtype)], axis=-1)
        observed, step = jnp.asarray(scene.observed), jnp.asarray(scene.displacement)[:, -1]
        return self.decoder(hidden, observed, step, jnp.asarray(scene.valid), weigh)
