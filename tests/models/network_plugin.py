"""A plugin's pooling with an option, and its recurrent cell: one file, as a user would write it."""

import dataclasses
from typing import ClassVar

import jax
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
        apart = jnp.square(position - position[:, None]).sum(axis=-1)
        weight = jnp.exp(-apart / self.temperature) * valid * (1 - jnp.eye(len(valid)))
        return nn.Dense(self.width)(weight @ hidden)


@register_cell("gru")
@dataclasses.dataclass(frozen=True)
class GRU(Cell):
    """Gates r, z, n of the input, and the part of n that r multiplies."""

    title: ClassVar[str] = "GRU"

    def network(self, inputs, features, name):
        return GRUNetwork(inputs, features, name=name)

    def start(self, hidden):
        return (hidden,)

    def update(self, gates, state):
        r, z, of_input, of_hidden = jnp.split(gates, 4, axis=-1)
        new = jnp.tanh(of_input + jax.nn.sigmoid(r) * of_hidden)
        keep = jax.nn.sigmoid(z)
        return (keep * state[0] + (1 - keep) * new,)


class GRUNetwork(nn.Module):
    inputs: int
    features: int

    def setup(self):
        draw = nn.initializers.lecun_normal()
        of_input = self.param("input_kernel", draw, (self.inputs, 3 * self.features))
        of_hidden = self.param("recurrent_kernel", draw, (self.features, 3 * self.features))
        self.bias = self.param("bias", nn.initializers.zeros, (4 * self.features,))
        self.input_kernel = jnp.pad(of_input, [(0, 0), (0, self.features)])
        gap = jnp.zeros((self.features, self.features))
        both, last = jnp.split(of_hidden, [2 * self.features], axis=1)
        self.recurrent_kernel = jnp.concatenate([both, gap, last], axis=1)

    def __call__(self, x):
        return x @ self.input_kernel + self.bias
