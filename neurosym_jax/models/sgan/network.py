"""SGAN and NeuroSyM: layers and cells, poolings, configurations, generator and discriminator,
and the forecast of one scene.
"""

import abc
import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Annotated, Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Checked, Positive, Size, Whole
from neurosym_jax.errors import InputError
from neurosym_jax.models.forecaster import Lengths, NoiseSpec, with_weighting
from neurosym_jax.plugins import Registry
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.scene import Scene, make_scene
from neurosym_jax.symbolic.weighting import WEIGHTINGS, Cnd, Weighting

__all__ = [
    "CELLS",
    "LSTM",
    "NO_FORECAST",
    "POOLINGS",
    "Affine",
    "AsDescribed",
    "Cell",
    "Decoder",
    "Discriminator",
    "DiscriminatorConfig",
    "Encoder",
    "Generator",
    "GeneratorConfig",
    "NeurosymIjcnn",
    "NeurosymRos",
    "NoPooling",
    "Perceptron",
    "PoolNet",
    "PoolNetwork",
    "Pooling",
    "Social",
    "Weigh",
    "bottleneck_relu",
    "decode_scene",
    "embed",
    "encode_scene",
    "init_generator",
    "interact_scene",
    "max_over_neighbours",
    "pool",
    "pooling_network",
    "register_cell",
    "register_pooling",
    "with_bias",
]


# Affine layers, perceptrons and recurrent cells, initialised as SGAN initialises them.
#
# Kernels are [in, out]. Chains of affine layers are folded into one matrix where that
# saves work (see `embed`, `Decoder` and the poolings); an optimiser still sees the
# parameters of the unfolded layers.


def kaiming_normal(key, shape, dtype=jnp.float32):
    """Initialiser drawing from N(0, 2 / inputs): K. He et al., ICCV 2015."""
    scale = jnp.sqrt(jnp.array(2 / shape[0], dtype))
    numbers = jax.random.normal(key, shape, dtype)
    # Without barriers the compiler would multiply by products of constants, and the
    # numbers drawn would depend on whether a network's initialisation is compiled as
    # one program.
    return jax.lax.optimization_barrier(numbers) * scale


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
    square = x * x
    numerator = 1.4903334e-08
    denominator = 8.3964648e-07
    for a, b in (
        (2.1683279e-05, 3.3910569e-04),
        (3.5595330e-03, 2.6119196e-02),
        (1.3434543e-01, 4.6767871e-01),
        (1.0, 1.0),
    ):
        numerator = numerator * square + a
        denominator = denominator * square + b
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
            gates = gates + state[0] @ self.recurrent.recurrent_kernel
            return self.cell.update(gates, state), None

        # Zeros made from the gates have their type and, under `jax.shard_map`, vary over
        # the same devices, as a scan's carry must.
        zero = jnp.zeros_like(driven[0, :, :1])
        hidden = jnp.broadcast_to(zero, (zero.shape[0], self.h_dim))
        state, _ = jax.lax.scan(step, self.cell.start(hidden), driven)
        return state[0]


# What a pooling is, and those of SGAN: none, Social LSTM's and its own.
#
# Its own is a perceptron of every pair, the maximum over neighbours, a ReLU. An agent is
# among its own neighbours, as in SGAN, so the maximum is never over nothing.

NO_FORECAST = (
    "does not weight pairs: it takes one row of alpha an agent, picked by the released collation "
    "out of other scenes' pairs, so it forecasts in parity cases only"
)
"""What is wrong with a pooling that takes "alpha_rows"."""


@dataclasses.dataclass(frozen=True)
class Pooling(Checked, abc.ABC):
    """A pooling over each agent's neighbours in one scene; the fields of a subclass are options.

    A subclass is registered by `register_pooling` and chosen by
    `GeneratorConfig.pooling`.
    """

    title: ClassVar[str]
    """What a model with it is called in tables."""
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "position"})
    """What the network is called with, by name, besides `valid` [N] bool:

    - "hidden": [N, h_dim] hidden states;
    - "position": [N, 2] metres, the last position;
    - "track": [N, obs_len, 2] metres, the last positions, observed or predicted;
    - "alpha": [N, N, obs_len] weight of j for i at each step of the track;
    - "alpha_rows": [N, obs_len] instead, for the parity of a release (`NO_FORECAST`).
    """

    @abc.abstractmethod
    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> Any:
        """The Flax module from `inputs` to [N, `width(h_dim)`].

        It returns finite vectors for every slot; only valid agents contribute. Sizes
        are those of a hidden state, a track, and an embedded position in the generator.
        """

    def width(self, h_dim: int) -> int:
        """Size of a pooled vector, by default the option `bottleneck_dim`."""
        return getattr(self, "bottleneck_dim")  # noqa: B009 (a subclass has it)


@dataclasses.dataclass(frozen=True)
class NoPooling(Pooling):
    """Agents do not see each other."""

    title: ClassVar[str] = "SGAN, no pooling"
    inputs: ClassVar[frozenset[str]] = frozenset()

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> Any:
        """None: there is nothing to call."""

    def width(self, h_dim: int) -> int:
        """0."""
        return 0


@dataclasses.dataclass(frozen=True)
class Social(Pooling):
    """Social LSTM's pooling: neighbours' hidden states summed in the cells of a grid.

    Alahi et al., CVPR 2016. The grid has `grid_size` x `grid_size` cells over a square
    of side `neighborhood_size` metres centred on the agent, x to the right and y
    downwards, as in SGAN's code.
    """

    title: ClassVar[str] = "SGAN, social pooling"
    neighborhood_size: Positive = 2.0
    grid_size: Size = 8

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return _GridNetwork(h_dim, self.grid_size, self.neighborhood_size)

    def width(self, h_dim: int) -> int:
        """That of a hidden state."""
        return h_dim


class _GridNetwork(nn.Module):
    h_dim: int
    grid_size: int
    neighborhood_size: float

    def setup(self):
        cells = self.grid_size**2
        self.mlp = Perceptron((cells * self.h_dim, self.h_dim))

    def __call__(self, hidden: Array, position: Array, valid: Array) -> Array:
        """`hidden [N, H]`, `position [N, 2]`, `valid [N]` to `[N, H]`."""
        half = self.neighborhood_size / 2
        offset = position[None] - position[:, None]
        is_near = (jnp.abs(offset) < half).all(axis=-1)
        itself = jnp.eye(valid.shape[0], dtype=bool)
        inside = is_near & valid[None] & ~itself
        # Rows of the grid count downwards.
        place = jnp.stack([offset[..., 0], -offset[..., 1]], -1)
        scaled = (place + half) / (2 * half)
        numbers = jnp.floor(scaled * self.grid_size)
        column, row = jnp.moveaxis(numbers, -1, 0)
        cell = jnp.where(inside, column + self.grid_size * row, -1)
        cells = jnp.arange(self.grid_size**2, dtype=cell.dtype)
        occupied = (cell[..., None] == cells[None, None]).astype(hidden.dtype)
        sums = jnp.einsum("ijc,jh->ich", occupied, hidden)
        return self.mlp(sums.reshape(valid.shape[0], -1))


@dataclasses.dataclass(frozen=True)
class PoolNet(Pooling):
    """SGAN's pooling (Gupta et al., CVPR 2018), see `PoolNetwork`."""

    title: ClassVar[str] = "SGAN"
    bottleneck_dim: Size = 8
    hidden_dim: Size = 512

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return PoolNetwork(embedding_dim, h_dim, self.hidden_dim, self.bottleneck_dim)


class PoolNetwork(nn.Module):
    """SGAN's pooling module: a perceptron of `[Dense(p_j - p_i); h_j]`, maximum over j.

    The first layer is linear in the pair, so it splits into per-agent parts, `W [S (p_j
    - p_i) + s; h_j] + b = u_j - v_i`; only its ReLU and the small second layer are
    computed per pair.
    """

    embedding_dim: int
    h_dim: int
    hidden_dim: int
    bottleneck_dim: int

    def setup(self):
        """Declare the embedding of relative positions and the pair perceptron."""
        self.spatial_embedding = Affine(2, self.embedding_dim)
        self.mlp = Perceptron(
            (self.embedding_dim + self.h_dim, self.hidden_dim, self.bottleneck_dim)
        )

    def __call__(self, hidden: Array, position: Array, valid: Array) -> Array:
        """`hidden [N, H]`, `position [N, 2]`, `valid [N]` to `[N, bottleneck_dim]`."""
        first, second = self.mlp.layers
        embedding_kernel, hidden_kernel = jnp.split(first.kernel, [self.embedding_dim])
        v = position @ (self.spatial_embedding.kernel @ embedding_kernel)
        bias = self.spatial_embedding.bias @ embedding_kernel + first.bias
        u = with_bias(v + hidden @ hidden_kernel, bias)
        highest = max_over_neighbours(
            lambda _, v, u, __: u - v, (), v, u, (), second, valid
        )
        return bottleneck_relu(self, highest)


def max_over_neighbours(
    first_layer: Callable[..., Array],
    shared: Any,
    agents: Any,
    neighbours: Any,
    pairs: Any,
    second: Affine,
    valid: Array,
) -> Array:
    """`max_j W relu(first_layer of i and j) + b` over valid j, for every agent i.

    `first_layer(shared, own, theirs, of_pair)` gives the [hidden] of one pair before
    its ReLU, from parameters and from slices of `agents` and `neighbours` [N, ...] and
    `pairs` [N, N, ...]; W and b are `second`'s. The result is [N, B], finite for every
    slot, 0 if nobody is `valid [N]`.

    Agents are processed one by one, so the widest array is `[N, hidden]`, which stays
    in the cache where `[N, N, hidden]` does not. Only the neighbour who wins the
    maximum of an output (of equals, the first) has a gradient, so the backward pass
    computes no other pair. It is written by hand: there is no forward-mode derivative.
    """
    layer = jax.vmap(first_layer, in_axes=(None, None, 0, 0))
    inputs = (shared, agents, neighbours, pairs, second.kernel, second.bias, valid)
    highest: Any = _maximum(layer, *_varying_alike(inputs))
    return jnp.where(valid.any(), highest, 0)


def _varying_alike(arrays: Any) -> Any:
    """The tree `arrays`, each of which varies over the devices that any of them varies over.

    Under `jax.shard_map` the gradient of a parameter, which is on all devices, is a
    sum over them. A gradient written by hand has that sum only if the parameter is
    marked as varying before.
    """
    every_axis = frozenset[str]()
    for leaf in jax.tree.leaves(arrays):
        every_axis |= _varying_axes(leaf)

    def varying(leaf: Array) -> Array:
        missing = every_axis - _varying_axes(leaf)
        if missing:
            return jax.lax.pcast(leaf, tuple(missing), to="varying")
        return leaf

    return jax.tree.map(varying, arrays)


def _varying_axes(leaf: Array) -> frozenset[str]:
    kind: Any = jax.typeof(leaf)
    if hasattr(kind, "vma"):  # Its name in JAX before 0.10.2.
        return kind.vma
    return kind.manual_axis_type.varying


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _maximum(layer, shared, agents, neighbours, pairs, kernel, bias, valid):
    def of_agent(agent):
        return _candidates(layer, shared, neighbours, kernel, bias, valid, *agent).max(
            axis=0
        )

    return jax.lax.map(of_agent, (agents, pairs))


def _candidates(
    layer, shared, neighbours, kernel, bias, valid, own, pair_rows
) -> Array:
    """[N, B] candidates of one agent; -inf where not valid."""
    hidden = nn.relu(layer(shared, own, neighbours, pair_rows))
    candidates = with_bias(hidden @ kernel, bias)
    return jnp.where(valid[:, None], candidates, -jnp.inf)


def _forward(layer, shared, agents, neighbours, pairs, kernel, bias, valid):
    slots = jnp.arange(valid.shape[0])[:, None]

    def of_agent(agent):
        values = _candidates(layer, shared, neighbours, kernel, bias, valid, *agent)
        highest = values.max(axis=0)
        # `argmax` is several times slower on a CPU than these two reductions.
        is_highest = values == highest[None]
        winners = jnp.where(is_highest, slots, valid.shape[0] - 1)
        return highest, winners.min(axis=0)

    highest, winner = jax.lax.map(of_agent, (agents, pairs))
    return highest, (shared, agents, neighbours, pairs, kernel, winner)


@full_precision
def _backward(layer, saved, cotangent):
    shared, agents, neighbours, pairs, kernel, winner = saved
    weight = kernel.T

    def backward_agent(sums, agent):
        shared_grad, neighbour_grads, weight_grad = sums
        own, pair_rows, winner, cotangent = agent
        neighbour, pair = jax.tree.map(
            lambda rows: jnp.take(rows, winner, axis=0), (neighbours, pair_rows)
        )
        before, pull = jax.vjp(layer, shared, own, neighbour, pair)
        active = jnp.where(before > 0, cotangent[:, None], 0)
        shared_part, own_grad, neighbour_grad, pair_grad = pull(active * weight)
        sums = (
            jax.tree.map(jnp.add, shared_grad, shared_part),
            _add_rows(neighbour_grads, winner, neighbour_grad),
            weight_grad + active * before,
        )
        pair_grads = _add_rows(
            jax.tree.map(jnp.zeros_like, pair_rows), winner, pair_grad
        )
        return sums, (own_grad, pair_grads)

    summed = shared, neighbours, weight
    sums, (own_grads, pair_grads) = jax.lax.scan(
        backward_agent,
        jax.tree.map(_wide_zeros, summed),
        (agents, pairs, winner, cotangent),
    )
    shared_grad, neighbour_grads, weight_grad = jax.tree.map(
        lambda total, leaf: total.astype(leaf.dtype), sums, summed
    )
    bias_grad = cotangent.sum(axis=0).astype(kernel.dtype)
    return (
        shared_grad,
        own_grads,
        neighbour_grads,
        pair_grads,
        weight_grad.T,
        bias_grad,
        None,
    )


def _wide_zeros(leaf: Array) -> Array:
    """Zeros of the leaf's shape, to sum gradients of bfloat16 in float32."""
    return jnp.zeros_like(leaf, dtype=jnp.promote_types(leaf.dtype, jnp.float32))


def _add_rows(arrays: Any, rows: Array, values: Any) -> Any:
    return jax.tree.map(lambda array, value: array.at[rows].add(value), arrays, values)


_maximum.defvjp(_forward, _backward)


def bottleneck_relu(module: nn.Module, x: Array) -> Array:
    """`relu(x [..., F])`, the end of the pooling `module`.

    Its gradient at `x <= 0` is 0, or, where the module has the variable `leak` of the
    collection `training`, that share of the gradients which raise `x` (see
    `training.step`).
    """
    if not module.has_variable("training", "leak"):
        return nn.relu(x)
    return _leaking_relu(x, module.get_variable("training", "leak"))


@jax.custom_gradient
def _leaking_relu(x: Array, leak: Array) -> Any:
    def pull(cotangent: Array) -> tuple[Array, Array]:
        raising = leak * jnp.minimum(cotangent, 0)
        return jnp.where(x > 0, cotangent, raising), jnp.zeros_like(leak)

    return nn.relu(x), pull


# NeuroSyM's poolings: SGAN's with the pair's relative history weighted step by step by
# alpha.
#
# `docs/models.md` explains the three variants: the papers' (`as_described`), the robot
# package's (`neurosym_ros`) and the earlier release's with its defects
# (`neurosym_ijcnn`).


class _DescribedNetwork(nn.Module):
    """As described: each step's `Dense(X_j(t) - X_i(t))` times `alpha_ij(t)`, beside h_j.

    The first layer of the pair perceptron is linear in `[alpha dx, alpha dy, alpha]` of
    each step, so the embedding folds into it: 3 inputs a step instead of
    `embedding_dim`.
    """

    obs_len: int
    embedding_dim: int
    h_dim: int
    hidden_dim: int
    bottleneck_dim: int
    whole_history: ClassVar[bool] = False
    """Whether the embedding takes all steps at once."""

    def setup(self):
        steps = self.obs_len if self.whole_history else 1
        width = self.obs_len * self.embedding_dim
        self.spatial_embedding = Affine(2 * steps, self.embedding_dim * steps)
        self.mlp = Perceptron(
            (width + self.h_dim, self.hidden_dim, self.bottleneck_dim)
        )

    def __call__(
        self, hidden: Array, track: Array, valid: Array, alpha: Array
    ) -> Array:
        """Social vectors `[N, bottleneck_dim]`, see `Pooling.inputs`."""
        first, second = self.mlp.layers
        step_kernel, hidden_kernel = jnp.split(
            first.kernel, [self.obs_len * self.embedding_dim]
        )
        shared, own, neighbour = self.histories(track, step_kernel)
        neighbours = neighbour, with_bias(hidden @ hidden_kernel, first.bias)
        highest = max_over_neighbours(
            self.pair, shared, own, neighbours, alpha, second, valid
        )
        return bottleneck_relu(self, highest)

    def histories(self, track: Array, step_kernel: Array) -> tuple[Array, Array, Array]:
        """The first layer's parameters, and the histories of agents i and of neighbours j."""
        step_kernel = step_kernel.reshape(
            self.obs_len, self.embedding_dim, self.hidden_dim
        )
        # [3, obs_len, hidden_dim]: what alpha dx, alpha dy and alpha of each step
        # contribute.
        dense = self.spatial_embedding
        embedding = jnp.concatenate([dense.kernel, dense.bias[None]])
        folded = jnp.einsum("ce,teh->cth", embedding, step_kernel)
        return folded.reshape(3 * self.obs_len, self.hidden_dim), track, track

    @staticmethod
    def pair(
        folded: Array, own: Array, neighbour: tuple[Array, Array], alpha: Array
    ) -> Array:
        """The first layer of a pair, see `max_over_neighbours`."""
        track, neighbour_part = neighbour
        x, y = (track - own).T
        return jnp.concatenate([alpha * x, alpha * y, alpha]) @ folded + neighbour_part


class _RosNetwork(_DescribedNetwork):
    """The robot package: one Linear over the whole flattened history, then alpha by step.

    Block t of its output, `embedding_dim` channels, is multiplied by `alpha_ij(t)`, but
    mixes all steps. The Linear splits into per-agent parts because the history is a
    difference.
    """

    whole_history: ClassVar[bool] = True

    def histories(self, track: Array, step_kernel: Array) -> tuple[Array, Array, Array]:
        """See `_DescribedNetwork.histories`."""
        steps = track.reshape(track.shape[0], -1)
        own = steps @ self.spatial_embedding.kernel
        shape = track.shape[0], self.obs_len, -1
        shifted = with_bias(own, self.spatial_embedding.bias)
        return step_kernel, own.reshape(shape), shifted.reshape(shape)

    @staticmethod
    def pair(
        step_kernel: Array, own: Array, neighbour: tuple[Array, Array], alpha: Array
    ) -> Array:
        """See `_DescribedNetwork.pair`."""
        shifted, neighbour_part = neighbour
        weighted = (shifted - own) * alpha[:, None]
        return weighted.ravel() @ step_kernel + neighbour_part


class _IjcnnNetwork(_DescribedNetwork):
    """The earlier release: its relative history is identically zero, so nothing depends on i.

    Of the embedding only the bias acts, times a row of alpha that the released
    collation picked for agent j; all agents get the same maximum over j.
    """

    def __call__(self, hidden: Array, valid: Array, alpha_rows: Array) -> Array:
        """Social vectors `[N, bottleneck_dim]`, all rows equal; an InputError for other alpha."""
        if np.shape(alpha_rows) != (hidden.shape[0], self.obs_len):
            raise InputError(f"neurosym_ijcnn {NO_FORECAST}")
        embedded = alpha_rows[..., None] * self.spatial_embedding.bias
        embedded = embedded.reshape(hidden.shape[0], -1)
        vectors = self.mlp(jnp.concatenate([embedded, hidden], axis=-1))
        vectors = jnp.where(valid[:, None], vectors, 0)
        highest = vectors.max(axis=0)
        return jnp.broadcast_to(highest, vectors.shape)


@dataclasses.dataclass(frozen=True)
class AsDescribed(PoolNet):
    """NeuroSyM as its papers describe it."""

    title: ClassVar[str] = "NeuroSyM"
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "track", "alpha"})
    variant: ClassVar[type[_DescribedNetwork]] = _DescribedNetwork

    def network(self, h_dim: int, *, obs_len: int, embedding_dim: int) -> nn.Module:
        """See `Pooling.network`."""
        return self.variant(
            obs_len, embedding_dim, h_dim, self.hidden_dim, self.bottleneck_dim
        )


@dataclasses.dataclass(frozen=True)
class NeurosymRos(AsDescribed):
    """NeuroSyM as the authors' robot package computes it."""

    title: ClassVar[str] = "NeuroSyM (robot package)"
    variant: ClassVar[type[_DescribedNetwork]] = _RosNetwork


@dataclasses.dataclass(frozen=True)
class NeurosymIjcnn(AsDescribed):
    """NeuroSyM as the earlier release computes it, with its defects."""

    title: ClassVar[str] = "NeuroSyM (IJCNN release)"
    inputs: ClassVar[frozenset[str]] = frozenset({"hidden", "alpha_rows"})
    variant: ClassVar[type[_DescribedNetwork]] = _IjcnnNetwork


# Configurations of SGAN's networks, and the table of poolings.
#
# Defaults are those of the published SGAN checkpoints, which SGAN's own command line does
# not have.

POOLINGS: Registry[type[Pooling]] = Registry(
    "pooling",
    {
        "none": NoPooling,
        "pool_net": PoolNet,
        "social": Social,
        "as_described": AsDescribed,
        "neurosym_ros": NeurosymRos,
        "neurosym_ijcnn": NeurosymIjcnn,
    },
)

register_pooling = POOLINGS.register


@dataclasses.dataclass(frozen=True)
class GeneratorConfig(Lengths):
    """Architecture of a trajectory generator; numbers count units unless they say otherwise."""

    embedding_dim: Size = 16
    encoder_h_dim: Size = 32
    decoder_h_dim: Size = 32
    mlp_dim: Size = 64
    pooling: Annotated[Pooling, POOLINGS] = PoolNet()
    """How neighbours are pooled: a component with its own options, see `POOLINGS`."""
    pool_every_timestep: bool = False
    """Pool at predicted steps too. The symbols of NeuroSyM are then those of the last `obs_len`
    positions of each sample, observed or predicted."""
    cell: Annotated[Cell, CELLS] = LSTM()
    """The recurrent cell of encoder and decoder."""
    noise_dim: Whole = 8
    noise_type: Literal["gaussian", "uniform"] = "gaussian"
    noise_mix_type: Literal["global", "ped"] = "global"
    """One noise vector a scene, or one for each agent."""
    weighting: Annotated[Weighting | None, WEIGHTINGS] = None
    """Weights of pairs, for a pooling that takes alpha; its default is then the papers' `cnd`."""

    def __post_init__(self):
        super().__post_init__()
        if self.noise_dim >= self.decoder_h_dim:
            raise InputError(
                f"noise_dim must lie in [0, decoder_h_dim = {self.decoder_h_dim}), "
                f"not {self.noise_dim}: noise is a part of the decoder's first hidden state"
            )
        pooling = POOLINGS.name_of(self.pooling)
        can_repeat = self.pools and "alpha_rows" not in self.pooling.inputs
        if self.pool_every_timestep and not can_repeat:
            raise InputError(
                f"pool_every_timestep needs a pooling other than {pooling!r}"
            )
        if self.weighting is not None and not self.symbolic:
            raise InputError(
                f"pooling {pooling!r} has no symbols for a weighting to weight"
            )
        if self.weighting is None and self.symbolic:
            object.__setattr__(self, "weighting", Cnd())

    @property
    def noise(self) -> NoiseSpec:
        """The noise that each sample begins with."""
        return NoiseSpec(self.noise_dim, self.noise_mix_type == "ped", self.noise_type)

    @property
    def pools(self) -> bool:
        """Whether agents see each other."""
        return not isinstance(self.pooling, NoPooling)

    @property
    def symbolic(self) -> bool:
        """Whether pairs are weighted: NeuroSyM."""
        return "alpha" in self.pooling.inputs

    @property
    def needs_context_mlp(self) -> bool:
        """Whether a multi-layer perceptron stands between the encoder and the decoder."""
        return (
            self.noise_dim > 0 or self.pools or self.encoder_h_dim != self.decoder_h_dim
        )


@dataclasses.dataclass(frozen=True)
class DiscriminatorConfig(Checked):
    """Architecture of a trajectory discriminator: `local` scores h, `global` scores pooled h."""

    kind: Literal["global", "local"] = "global"
    embedding_dim: Size = 16
    h_dim: Size = 48
    mlp_dim: Size = 64
    pool_hidden_dim: Size = 512


# The generator of SGAN and NeuroSyM, for one scene and one noise, and SGAN's
# discriminator.
#
# Encoding does not depend on the noise, so best-of-k encodes once and maps `decode` over
# k noises. It has two parts: `observe` (recurrent) looks at no neighbour, `interact`
# (pooling, context) does.

Weigh = Callable[[Array, Array], Array]
"""`(positions [N, T, 2] metres, valid [N]) -> alpha [N, N, T]`."""


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
            inputs = config.encoder_h_dim + config.pooling.width(config.encoder_h_dim)
            outputs = config.decoder_h_dim - config.noise_dim
            self.context_mlp = Perceptron((inputs, config.mlp_dim, outputs))
        self.decoder = Decoder(config)

    def __call__(
        self,
        scene: Scene,
        noise: Array,
        alpha: Array | None = None,
        weigh: Weigh | None = None,
    ) -> Array:
        """One forecast of `scene`: `[N, pred_len, 2]` displacements in metres.

        `noise` is `[noise_dim]`, or `[N, noise_dim]` if drawn per agent. NeuroSyM needs
        the weights `alpha [N, N, obs_len]`, and `weigh` if it pools at predicted steps
        (see `Decoder`).
        """
        hidden = self.observe(jnp.asarray(scene.displacement))
        context = self.interact(hidden, scene, alpha)
        return self.decode(context, scene, noise, weigh)

    def observe(self, displacement: Array) -> Array:
        """Hidden states `[N, encoder_h_dim]` after `displacement [N, obs_len, 2]`, in metres."""
        return self.encoder(displacement)

    def interact(
        self, context: Array, scene: Scene, alpha: Array | None = None
    ) -> Array:
        """Context `[N, decoder_h_dim - noise_dim]` from the `context [N, H]` of `observe`."""
        if self.config.pools:
            context = jnp.concatenate(
                [context, self.pool(context, scene, alpha)], axis=-1
            )
        if self.config.needs_context_mlp:
            return self.context_mlp(context)
        return context

    def pool(self, context: Array, scene: Scene, alpha: Array | None = None) -> Array:
        """The vectors `[N, B]` that `interact` adds to `context`; the config must pool."""
        track = jnp.asarray(scene.observed)
        return pool(
            self.pooling, self.config.pooling, context, track, scene.valid, alpha
        )

    def decode(
        self, context: Array, scene: Scene, noise: Array, weigh: Weigh | None = None
    ) -> Array:
        """Forecast displacements `[N, pred_len, 2]` from `context` and one noise, see `Decoder`."""
        shape = context.shape[0], self.config.noise_dim
        noise = jnp.broadcast_to(noise, shape)
        hidden = jnp.concatenate([context, noise.astype(context.dtype)], axis=-1)
        return self.decoder(
            hidden, scene, jnp.asarray(scene.displacement)[:, -1], weigh
        )


class Decoder(nn.Module):
    """A first hidden state to `pred_len` displacements, each fed back in.

    Without pooling inside the loop the chain hidden -> displacement -> embedding ->
    gates is affine, so after the first step it is one matrix, added to the recurrent
    one. The fold changes results by float rounding only.
    """

    config: GeneratorConfig

    def setup(self):
        """Declare embedding, cell, output layer and, if used, pooling and its perceptron."""
        config = self.config
        self.spatial_embedding = Affine(2, config.embedding_dim)
        self.recurrent = config.cell.scoped(config.embedding_dim, config.decoder_h_dim)
        self.hidden2pos = Affine(config.decoder_h_dim, 2)
        if config.pool_every_timestep:
            hidden = config.decoder_h_dim
            self.pooling = pooling_network(config, hidden)
            self.mlp = Perceptron(
                (hidden + config.pooling.width(hidden), config.mlp_dim, hidden)
            )

    def __call__(
        self, hidden: Array, scene: Scene, displacement: Array, weigh: Weigh | None
    ) -> Array:
        """Forecast displacements [N, pred_len, 2] in metres.

        `hidden` is the first hidden state [N, decoder_h_dim], `displacement [N, 2]` the
        last one observed. If NeuroSyM pools at predicted steps, `weigh` gives the alpha
        of the last `obs_len` positions, observed or predicted, up to a step.
        """
        if not self.config.pool_every_timestep:
            return self._folded(hidden, displacement)
        unroll = nn.scan(
            lambda decoder, carry, _: decoder._pooled_step(carry, scene.valid, weigh),
            variable_broadcast=("params", "training"),
            split_rngs={"params": False},
            length=self.config.pred_len,
        )
        carry = (
            self.config.cell.start(hidden),
            jnp.asarray(scene.observed),
            displacement,
        )
        _, displacements = unroll(self, carry, None)
        return jnp.moveaxis(displacements, 0, 1)

    def _folded(self, hidden: Array, displacement: Array) -> Array:
        cell, recurrent = self.config.cell, self.recurrent.recurrent_kernel
        kernel, bias = embed(self.spatial_embedding, self.recurrent)
        feedback = recurrent + self.hidden2pos.kernel @ kernel
        feedback_bias = bias + self.hidden2pos.bias @ kernel

        def displaced(gates, state):
            # The bias is added here: were the sum carried, XLA would store it in a pass
            # of its own.
            state = cell.update(with_bias(gates, feedback_bias), state)
            # The displacement is computed here: were the hidden states the loop's
            # output, XLA would compute them twice, once to be stacked and once for the
            # product.
            return state, self.hidden2pos(state[0])

        def step(state, _):
            return displaced(state[0] @ feedback, state)

        # `feedback_bias` has the output layer's bias, which the displacement observed
        # has not.
        unbiased = with_bias(displacement, -self.hidden2pos.bias)
        gates = unbiased @ kernel + hidden @ recurrent
        # The first step stands apart, so that the last computes no gates that no step
        # reads.
        state, first = displaced(gates, cell.start(hidden))
        _, others = jax.lax.scan(step, state, length=self.config.pred_len - 1)
        displacements = jnp.concatenate([first[None], others])
        return jnp.moveaxis(displacements, 0, 1)

    def _pooled_step(self, carry: Any, valid: Any, weigh: Weigh | None):
        state, track, displacement = carry
        kernel, bias = embed(self.spatial_embedding, self.recurrent)
        gates = with_bias(displacement @ kernel, bias)
        gates = gates + state[0] @ self.recurrent.recurrent_kernel
        hidden, *rest = self.config.cell.update(gates, state)
        displacement = self.hidden2pos(hidden)
        position = (track[:, -1] + displacement)[:, None]
        track = jnp.concatenate([track[:, 1:], position], axis=1)
        alpha = None if weigh is None else weigh(track, valid)
        pooling = self.config.pooling
        pooled = pool(self.pooling, pooling, hidden, track, valid, alpha)
        together = jnp.concatenate([hidden, pooled], axis=-1)
        hidden = self.mlp(together)
        return ((hidden, *rest), track, displacement), displacement


def pooling_network(config: GeneratorConfig, h_dim: int) -> Any:
    """The network of the config's pooling, for hidden states of size `h_dim`."""
    return config.pooling.network(
        h_dim, obs_len=config.obs_len, embedding_dim=config.embedding_dim
    )


def pool(
    network: Any,
    pooling: Pooling,
    hidden: Array,
    track: Array,
    valid: Any,
    alpha: Array | None,
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
    inputs = {"hidden": hidden, "position": track[:, -1], "track": track}
    inputs |= {"alpha": alpha, "alpha_rows": alpha}
    named = {name: inputs[name] for name in sorted(pooling.inputs)}
    return network(valid=valid, **named)


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


# The generator as functions of one scene: initialisation, encoding, pooling, decoding.


@functools.partial(jax.jit, static_argnums=0)
def init_generator(config: GeneratorConfig, key: Array) -> Any:
    """New parameters, as SGAN draws them, and those of the weighting; consumes `key`."""
    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    pairs = (1,) if "alpha_rows" in config.pooling.inputs else (1, 1)
    alpha = np.zeros((*pairs, config.obs_len))
    weigh = (lambda *_: alpha) if config.symbolic else None
    params = Generator(config).init(
        key, scene, np.zeros((1, config.noise_dim)), alpha, weigh
    )
    return with_weighting(params, config.weighting)


@full_precision
def encode_scene(config: GeneratorConfig, params: Any, scene: Scene) -> Any:
    """Context `[N, C]` of one scene: encoding, symbols and alpha (NeuroSyM), pooling."""
    hidden = Generator(config).apply(
        params, scene.displacement, method=Generator.observe
    )
    return interact_scene(config, params, hidden, scene)


@full_precision
def interact_scene(
    config: GeneratorConfig, params: Any, hidden: Any, scene: Scene
) -> Any:
    """The part of `encode_scene` that looks at neighbours, after the encoding `hidden [N, H]`."""
    weigh = _weighting(config, params)
    alpha = scene.alpha
    if alpha is None and weigh is not None:
        alpha = weigh(jnp.asarray(scene.observed), jnp.asarray(scene.valid))
    interact = Generator.interact
    return Generator(config).apply(params, hidden, scene, alpha, method=interact)


@full_precision
def decode_scene(
    config: GeneratorConfig, params: Any, context: Array, scene: Scene, noise: Array
) -> Array:
    """`[k, N, pred_len, 2]` metres relative to the scene's origin; see `Forecaster.forecast`."""
    weigh = _weighting(config, params)

    def decode(noise: Array) -> Any:
        inputs = (context, scene, noise, weigh)
        return Generator(config).apply(params, *inputs, method=Generator.decode)

    if config.pool_every_timestep:
        # One sample after the other: arrays of all samples' pairs do not stay in the
        # cache.
        displacement: Any = jax.lax.map(decode, noise)
    else:
        displacement = jax.vmap(decode)(noise)
    last = jnp.asarray(scene.observed)[None, :, -1, None]
    return last + jnp.cumsum(displacement, axis=-2)


def _weighting(config: GeneratorConfig, params: Any) -> Weigh | None:
    """The config's weighting with its trained parameters; None for a model without symbols."""
    weighting = config.weighting
    if weighting is None:
        return None
    learned = params.get("weighting", {})
    return functools.partial(weighting.alpha, learned, period=config.period)
