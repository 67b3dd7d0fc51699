"""The LSTM of torch: gates in the order i, f, g, o, and two biases.

Two biases add up to one in the forward pass, but not under Adam or norm clipping, where each gets
its own update; Flax's cells have one bias, so training them is not training torch's.
"""

import dataclasses
from typing import ClassVar

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.models.cell import Cell
from neurosym_jax.models.layers import uniform_within

__all__ = ["LSTM", "LSTMNetwork"]


@dataclasses.dataclass(frozen=True)
class LSTM(Cell):
    """SGAN's cell; its state is (hidden, cell), [..., H] each."""

    title: ClassVar[str] = "LSTM"

    def network(self, inputs: int, features: int, name: str) -> nn.Module:
        """See `LSTMNetwork`."""
        return LSTMNetwork(inputs, features, name=name)

    def start(self, hidden: Array) -> tuple[Array, ...]:
        """`hidden [..., H]`, and a cell state of zeros."""
        return hidden, jnp.zeros_like(hidden)

    def update(self, gates: Array, state: tuple[Array, ...]) -> tuple[Array, ...]:
        """`gates [..., 4 H]` are in the order input, forget, cell, output."""
        i, f, g, o = jnp.split(gates, 4, axis=-1)
        cell = jax.nn.sigmoid(f) * state[1] + jax.nn.sigmoid(i) * jnp.tanh(g)
        return jax.nn.sigmoid(o) * jnp.tanh(cell), cell


class LSTMNetwork(nn.Module):
    """The parameters of one LSTM layer, uniform within 1/sqrt(features) as torch draws them."""

    inputs: int
    features: int

    def setup(self):
        """Declare two kernels `[in, 4 H]` and two biases `[4 H]`."""
        draw = uniform_within(self.features**-0.5)
        gates = 4 * self.features
        self.input_kernel = self.param("input_kernel", draw, (self.inputs, gates))
        self.recurrent_kernel = self.param("recurrent_kernel", draw, (self.features, gates))
        self.input_bias = self.param("input_bias", draw, (gates,))
        self.recurrent_bias = self.param("recurrent_bias", draw, (gates,))

    def __call__(self, x: Array) -> Array:
        """`x [..., inputs]` to its part of the gates, [..., 4 H]."""
        return x @ self.input_kernel + self.input_bias + self.recurrent_bias
