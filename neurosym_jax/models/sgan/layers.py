"""Affine layers, perceptrons and recurrent cells, initialised as SGAN initialises them.

Kernels are [in, out]. Chains of affine layers are folded into one matrix where that
saves work (see `embed`, `Decoder` and the poolings); an optimiser still sees the
parameters of the unfolded layers.
"""

import abc
import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Checked
from neurosym_jax.plugins import Registry

__all__ = [
    "CELLS",
    "LSTM",
    "Affine",
    "Cell",
    "Encoder",
    "Perceptron",
    "embed",
    "register_cell",
]
__all__ += ["with_bias"]


def kaiming_normal(key, shape, dtype=jnp.float32):
    """Initialiser drawing from N(0, 2 / inputs): K. He et al., ICCV 2015."""
    scale = jnp.sqrt(jnp.array(2 / shape[0], dtype))
    # Without barriers the compiler would multiply by products of constants, and the
    # numbers drawn would depend on whether a network's initialisation is compiled as
    # one program.
    return jax.lax.optimization_barrier(jax.random.normal(key, shape, dtype)) * scale


def uniform_within(bound: float) -> nn.initializers.Initializer:
    """Initialiser drawing from U(-bound, bound), torch's default for LSTMs and biases."""

    def initialise(key, shape, dtype=jnp.float32):
        return jax.lax.optimization_barrier(
            jax.random.uniform(key, shape, dtype, -bound, bound)
        )

    return initialise


def with_bias(x: Array, *biases: Array) -> Array:
    """`x [..., F]` plus each bias [F]: ranks are equal, for JAX may be set to refuse others."""
    for bias in biases:
        x = x + bias.reshape((1,) * (x.ndim - 1) + (-1,))
    return x


@jax.custom_jvp
@jax.jit
def tanh(x: Array) -> Array:
    """`jnp.tanh(x [...])` by a rational function, as accurate in float32 (2.8e-7) and faster.

    It has the least relative error where |x| <= 8.2 and is constant beyond.
    """
    if x.dtype != jnp.float32:
        return jnp.tanh(x)
    x = jnp.clip(x, -8.2, 8.2)
    square, numerator, denominator = x * x, 1.4903334e-08, 8.3964648e-07
    for a, b in (
        (2.1683279e-05, 3.3910569e-04),
        (3.5595330e-03, 2.6119196e-02),
        (1.3434543e-01, 4.6767871e-01),
        (1.0, 1.0),
    ):
        numerator, denominator = numerator * square + a, denominator * square + b
    return x * numerator / denominator


@tanh.defjvp
def _(primals: tuple[Array], tangents: tuple[Array]) -> tuple[Array, Array]:
    y = tanh(*primals)
    return y, (1 - y * y) * tangents[0]


def sigmoid(x: Array) -> Array:
    """`jax.nn.sigmoid(x [...])`; an exponential costs more than `tanh`."""
    return 0.5 + 0.5 * tanh(0.5 * x)


class Affine(nn.Module):
    """`x @ kernel + bias`; Kaiming-normal kernel, bias uniform within 1/sqrt(inputs)."""

    inputs: int
    outputs: int

    def setup(self):
        """Declare `kernel [inputs, outputs]` and `bias [outputs]`."""
        self.kernel = self.param("kernel", kaiming_normal, (self.inputs, self.outputs))
        self.bias = self.param(
            "bias", uniform_within(self.inputs**-0.5), (self.outputs,)
        )

    def __call__(self, x: Array) -> Array:
        """`[..., inputs]` to `[..., outputs]`."""
        return with_bias(x @ self.kernel, self.bias)


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


@dataclasses.dataclass(frozen=True)
class Cell(Checked, abc.ABC):
    """A recurrent cell of encoder and decoder; the fields of a subclass are its options.

    A step is `update(x @ input_kernel + biases + h @ recurrent_kernel, state)`, for an
    input x and a state whose first array is h. This form lets the affine layers around
    the cell fold into it.
    """

    title: ClassVar[str]
    """What tables call it, except an LSTM."""

    @abc.abstractmethod
    def network(self, inputs: int, features: int, name: str) -> Any:
        """The Flax module with the cell's parameters, called `name`.

        It has `input_kernel` [inputs, G], `recurrent_kernel` [features, G] and maps x
        [..., inputs] to `x @ input_kernel` + biases [..., G]. G is the number of
        pre-activations, the gates.
        """

    def scoped(self, inputs: int, features: int) -> Any:
        """The network; its parameters are in a scope of the class's name."""
        return self.network(inputs, features, type(self).__name__.lower())

    @abc.abstractmethod
    def start(self, hidden: Array) -> tuple[Array, ...]:
        """The state with this hidden state [..., H], before the first step."""

    @abc.abstractmethod
    def update(self, gates: Array, state: tuple[Array, ...]) -> tuple[Array, ...]:
        """The next state, from `gates` [..., G]."""


@dataclasses.dataclass(frozen=True)
class LSTM(Cell):
    """SGAN's cell, the LSTM of torch; its state is (hidden, cell), [..., H] each."""

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
        cell = sigmoid(f) * state[1] + sigmoid(i) * tanh(g)
        return sigmoid(o) * tanh(cell), cell


class LSTMNetwork(nn.Module):
    """The parameters of one LSTM layer, uniform within 1/sqrt(features) as torch draws them.

    Torch's two biases add up to one in the forward pass, but not under Adam or norm
    clipping, where each gets its own update; Flax's cells have one bias, so training
    them is not training torch's.
    """

    inputs: int
    features: int

    def setup(self):
        """Declare two kernels `[in, 4 H]` and two biases `[4 H]`."""
        draw = uniform_within(self.features**-0.5)
        gates = 4 * self.features
        self.input_kernel = self.param("input_kernel", draw, (self.inputs, gates))
        self.recurrent_kernel = self.param(
            "recurrent_kernel", draw, (self.features, gates)
        )
        self.input_bias = self.param("input_bias", draw, (gates,))
        self.recurrent_bias = self.param("recurrent_bias", draw, (gates,))

    def __call__(self, x: Array) -> Array:
        """`x [..., inputs]` to its part of the gates, [..., 4 H]."""
        return with_bias(x @ self.input_kernel, self.input_bias, self.recurrent_bias)


CELLS: Registry[type[Cell]] = Registry("cell", {"lstm": LSTM})

register_cell = CELLS.register


def embed(embedding: Affine, network: Any) -> tuple[Array, Array]:
    """Kernel and bias of a cell's gates as an affine map of what `embedding` embeds.

    The embedding has no nonlinearity, so `(x S + s) W + b = x (S W) + (s W + b)`.
    """
    return embedding.kernel @ network.input_kernel, network(embedding.bias)


class Encoder(nn.Module):
    """Displacements to the last hidden state of a cell that starts from zeros."""

    cell: Cell
    embedding_dim: int
    h_dim: int

    def setup(self):
        """Declare the embedding and the cell."""
        self.spatial_embedding = Affine(2, self.embedding_dim)
        self.recurrent = self.cell.scoped(self.embedding_dim, self.h_dim)

    def __call__(self, displacement: Array) -> Array:
        """`displacement [N, T, 2]` metres to the hidden state `[N, h_dim]` after the last step."""
        kernel, bias = embed(self.spatial_embedding, self.recurrent)
        driven = with_bias(jnp.moveaxis(displacement, 1, 0) @ kernel, bias)

        def step(state, gates):
            return self.cell.update(
                gates + state[0] @ self.recurrent.recurrent_kernel, state
            ), None

        zeros = jnp.zeros((displacement.shape[0], self.h_dim), displacement.dtype)
        return jax.lax.scan(step, self.cell.start(zeros), driven)[0][0]
