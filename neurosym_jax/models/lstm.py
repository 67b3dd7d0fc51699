"""The LSTM of torch: gates in the order i, f, g, o, and two biases.

Two biases add up to one in the forward pass, but not under Adam or norm clipping, where each gets
its own update; Flax's cells have one, so training them is not training torch's.
"""

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.models.layers import Affine, uniform_within

__all__ = ["Encoder", "LSTMParameters", "lstm_update"]


def lstm_update(gates: Array, cell: Array) -> tuple[Array, Array]:
    """One LSTM step after its matrix products.

    Args:
        gates: [..., 4 H] pre-activations in the order input, forget, cell, output.
        cell: [..., H] cell state.

    Returns:
        New hidden and cell state, [..., H] each.
    """
    i, f, g, o = jnp.split(gates, 4, axis=-1)
    cell = jax.nn.sigmoid(f) * cell + jax.nn.sigmoid(i) * jnp.tanh(g)
    return jax.nn.sigmoid(o) * jnp.tanh(cell), cell


class LSTMParameters(nn.Module):
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

    def after(self, embedding: Affine) -> tuple[Array, Array]:
        """Kernel and bias of the gates as an affine map of what `embedding` embeds.

        The embedding has no nonlinearity, so `(x S + s) W + b = x (S W) + (s W + b)`.
        """
        kernel = embedding.kernel @ self.input_kernel
        bias = embedding.bias @ self.input_kernel + self.input_bias + self.recurrent_bias
        return kernel, bias


class Encoder(nn.Module):
    """Displacements to the last hidden state of an LSTM that starts from zeros."""

    embedding_dim: int
    h_dim: int

    def setup(self):
        """Declare the embedding and the LSTM."""
        self.spatial_embedding = Affine(2, self.embedding_dim)
        self.lstm = LSTMParameters(self.embedding_dim, self.h_dim)

    def __call__(self, displacement: Array) -> Array:
        """`displacement [N, T, 2]` metres to the hidden state `[N, h_dim]` after the last step."""
        kernel, bias = self.lstm.after(self.spatial_embedding)
        driven = jnp.moveaxis(displacement, 1, 0) @ kernel + bias
        recurrent = self.lstm.recurrent_kernel

        def step(state, gates):
            hidden, cell = state
            return lstm_update(gates + hidden @ recurrent, cell), None

        zeros = jnp.zeros((displacement.shape[0], self.h_dim), displacement.dtype)
        (hidden, _), _ = jax.lax.scan(step, (zeros, zeros), driven)
        return hidden
