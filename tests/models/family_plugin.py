"""A plugin's family of models: attention over neighbours, in one file as a user would write it."""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import linen as nn

import neurosym_jax as nj
from neurosym_jax.configuration import Count
from neurosym_jax.models import Lengths


@dataclasses.dataclass(frozen=True)
class AttentionConfig(Lengths):
    hidden: Count = 16
    samples: Count = 3


class AttentionNetwork(nn.Module):
    config: AttentionConfig

    @nn.compact
    def __call__(self, observed, valid):
        config, agents = self.config, observed.shape[0]
        steps = jnp.diff(observed, axis=1)
        state = nn.relu(nn.Dense(config.hidden)(steps.reshape(agents, -1)))
        offset = observed[None, :, -1] - observed[:, None, -1]
        others = valid & ~jnp.eye(agents, dtype=bool)
        share = jax.nn.softmax(jnp.where(others, -jnp.square(offset).sum(-1), -1e9))
        heard = (share * others) @ nn.Dense(config.hidden)(state)
        shape = (agents, config.samples, config.pred_len, 2)
        change = nn.Dense(config.samples * config.pred_len * 2)(
            jnp.concatenate([state, heard], -1)
        )
        ahead = steps[:, -1, None, None] + change.reshape(shape)
        return observed[:, -1, None] + jnp.cumsum(ahead, axis=2).swapaxes(0, 1)


@nj.register_forecaster("attention")
@dataclasses.dataclass(frozen=True)
class Attention(nj.Forecaster):
    Config: ClassVar = AttentionConfig
    title: ClassVar[str] = "Attention over neighbours"

    def init(self, key):
        observed, valid = jnp.zeros((1, self.config.obs_len, 2)), jnp.ones(1, bool)
        return AttentionNetwork(self.config).init(key, observed, valid)

    def count(self, samples):
        return min(samples, self.config.samples)

    def forecast(self, params, scene, noise):
        return AttentionNetwork(self.config).apply(params, scene.observed, scene.valid)[
            : len(noise)
        ]
