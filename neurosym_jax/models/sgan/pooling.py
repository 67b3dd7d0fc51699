"""What a pooling is, and those of SGAN: none, Social LSTM's and its own.

Its own is a perceptron of every pair, the maximum over neighbours, a ReLU. An agent is
among its own neighbours, as in SGAN, so the maximum is never over nothing.
"""

import abc
import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.configuration import Checked, Positive, Size
from neurosym_jax.models.sgan.layers import Affine, Perceptron, with_bias

__all__ = ["NO_FORECAST", "NoPooling", "PoolNet", "PoolNetwork", "Pooling", "Social"]
__all__ += ["bottleneck_relu", "max_over_neighbours"]

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
        self.mlp = Perceptron((self.grid_size**2 * self.h_dim, self.h_dim))

    def __call__(self, hidden: Array, position: Array, valid: Array) -> Array:
        """`hidden [N, H]`, `position [N, 2]`, `valid [N]` to `[N, H]`."""
        half = self.neighborhood_size / 2
        offset = position[None] - position[:, None]
        inside = (
            (jnp.abs(offset) < half).all(axis=-1)
            & valid[None]
            & ~jnp.eye(valid.shape[0], dtype=bool)
        )
        scaled = (jnp.stack([offset[..., 0], -offset[..., 1]], -1) + half) / (2 * half)
        column, row = jnp.moveaxis(jnp.floor(scaled * self.grid_size), -1, 0)
        cell = jnp.where(inside, column + self.grid_size * row, -1)
        cells = jnp.arange(self.grid_size**2, dtype=cell.dtype)[None, None]
        occupied = (cell[..., None] == cells).astype(hidden.dtype)
        return self.mlp(
            jnp.einsum("ijc,jh->ich", occupied, hidden).reshape(valid.shape[0], -1)
        )


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
    highest: Any = _maximum(layer, *inputs)
    return jnp.where(valid.any(), highest, 0)


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
    return jnp.where(valid[:, None], with_bias(hidden @ kernel, bias), -jnp.inf)


def _forward(layer, shared, agents, neighbours, pairs, kernel, bias, valid):
    slots = jnp.arange(valid.shape[0])[:, None]

    def of_agent(agent):
        values = _candidates(layer, shared, neighbours, kernel, bias, valid, *agent)
        highest = values.max(axis=0)
        # `argmax` is several times slower on a CPU than these two reductions.
        return highest, jnp.where(
            values == highest[None], slots, valid.shape[0] - 1
        ).min(axis=0)

    highest, winner = jax.lax.map(of_agent, (agents, pairs))
    return highest, (shared, agents, neighbours, pairs, kernel, winner)


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

    zeros = jax.tree.map(jnp.zeros_like, (shared, neighbours, weight))
    sums, (own_grads, pair_grads) = jax.lax.scan(
        backward_agent, zeros, (agents, pairs, winner, cotangent)
    )
    shared_grad, neighbour_grads, weight_grad = sums
    bias_grad = cotangent.sum(axis=0)
    return (
        shared_grad,
        own_grads,
        neighbour_grads,
        pair_grads,
        weight_grad.T,
        bias_grad,
        None,
    )


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
        return jnp.where(
            x > 0, cotangent, leak * jnp.minimum(cotangent, 0)
        ), jnp.zeros_like(leak)

    return nn.relu(x), pull
