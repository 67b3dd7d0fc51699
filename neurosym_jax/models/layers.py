"""Affine layers and the ReLU perceptron, initialised as SGAN initialises them.

Kernels are [in, out]. The layers expose `kernel` and `bias`, because chains of affine layers are
folded into one matrix where that saves work (see `cell`, `decoder` and the poolings). An optimiser
still sees the parameters of the unfolded layers.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

__all__ = ["Affine", "Perceptron", "uniform_within"]


def kaiming_normal(key, shape, dtype=jnp.float32):
    """Initialiser drawing from N(0, 2 / inputs): K. He et al., ICCV 2015."""
    scale = jnp.sqrt(jnp.array(2 / shape[0], dtype))
    # Without barriers the compiler would multiply by products of constants, and the numbers drawn
    # would depend on whether a network's initialisation is compiled as one program.
    return jax.lax.optimization_barrier(jax.random.normal(key, shape, dtype)) * scale


def uniform_within(bound: float) -> nn.initializers.Initializer:
    """Initialiser drawing from U(-bound, bound), torch's default for LSTMs and biases."""

    def initialise(key, shape, dtype=jnp.float32):
        drawn = jax.random.uniform(key, shape, dtype, -bound, bound)
        return jax.lax.optimization_barrier(drawn)

    return initialise


class Affine(nn.Module):
    """`x @ kernel + bias`; Kaiming-normal kernel, bias uniform within 1/sqrt(inputs)."""

    inputs: int
    outputs: int

    def setup(self):
        """Declare `kernel [inputs, outputs]` and `bias [outputs]`."""
        self.kernel = self.param("kernel", kaiming_normal, (self.inputs, self.outputs))
        self.bias = self.param("bias", uniform_within(self.inputs**-0.5), (self.outputs,))

    def __call__(self, x: Array) -> Array:
        """`[..., inputs]` to `[..., outputs]`."""
        return x @ self.kernel + self.bias


class Perceptron(nn.Module):
    """Affine layers, each followed by ReLU, the last included: SGAN's `make_mlp`."""

    sizes: Sequence[int]
    """Inputs, hidden sizes and outputs."""

    def setup(self):
        """Declare `layer_0`, `layer_1`, ..."""
        self.layers = [
            Affine(inputs, outputs, name=f"layer_{index}")
            for index, (inputs, outputs) in enumerate(zip(self.sizes, self.sizes[1:]))
        ]

    def __call__(self, x: Array) -> Array:
        """`[..., sizes[0]]` to `[..., sizes[-1]]`, all non-negative."""
        for layer in self.layers:
            x = nn.relu(layer(x))
        return x
