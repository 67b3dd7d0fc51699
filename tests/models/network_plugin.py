"""A plugin's pooling with an option, and its recurrent cell: one file, as a user would write it."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from flax import linen as nn

from neurosym_jax.models import Cell, Pooling, register_cell, register_pooling


@register_pooling("nearest")
@dataclasses.dataclass(frozen=True)
class Nearest(Pooling):
    """The hidden states of neighbours, weighted by how near they are."""

    title: ClassVar[str] = "Nearest neighbours"
    bottleneck_dim: int = 8
    temperature: float = 1.0

    def network(self, h_dim, *, obs_len, embedding_dim):
        return NearestNetwork(self.temperature, self.bottleneck_dim)


class NearestNetwork(nn.Module):
    temperature: float
    width: int

    @nn.compact
    def __call__(self, hidden, position, valid):
        distance = jnp.square(position - position[:, None]).sum(axis=-1)
        weight = (
            jnp.exp(-distance / self.temperature) * valid * (1 - jnp.eye(len(valid)))
        )
        return nn.Dense(self.width)(weight @ hidden)


@register_cell("rnn")
@dataclasses.dataclass(frozen=True)
class RNN(Cell):
    """The simplest cell (Elman, 1990): its only gate is the next hidden state."""

    title: ClassVar[str] = "RNN"

    def network(self, inputs, features, name):
        return RNNNetwork(inputs, features, name=name)

    def start(self, hidden):
        return (hidden,)

    def update(self, gates, state):
        return (jnp.tanh(gates),)


class RNNNetwork(nn.Module):
    inputs: int
    features: int

    def setup(self):
        draw = nn.initializers.lecun_normal()
        self.input_kernel = self.param(
            "input_kernel", draw, (self.inputs, self.features)
        )
        self.recurrent_kernel = self.param(
            "recurrent_kernel", draw, (self.features,) * 2
        )
        self.bias = self.param("bias", nn.initializers.zeros, (self.features,))

    def __call__(self, x):
        return x @ self.input_kernel + self.bias
