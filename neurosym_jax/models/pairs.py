"""The part of poolings that works on pairs: two layers, the maximum over neighbours, a ReLU."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn
from jax import Array

from neurosym_jax.models.layers import Affine

__all__ = ["bottleneck_relu", "max_over_neighbours"]

FirstLayer = Callable[[Any, Any, Any, Any], Array]


def max_over_neighbours(
    first_layer: FirstLayer,
    shared: Any,
    agents: Any,
    neighbours: Any,
    pairs: Any,
    second: Affine,
    valid: Array,
) -> Array:
    """`max_j W relu(first_layer of i and j) + b` over valid j, for every agent i.

    `bottleneck_relu` comes after it, which gives the same vectors as a ReLU of every pair.

    Agents are processed one by one, so the widest array is `[N, hidden]`, which stays in the cache
    where `[N, N, hidden]` does not. Only the neighbour who wins the maximum of an output (of
    equals, the first) has a gradient, so the backward pass computes no other pair. It is written by
    hand: there is no forward-mode derivative.

    Args:
        first_layer: `(shared, own, theirs, of_pair) -> [hidden]` of one pair, before its ReLU: from
            `shared`, and from slices of the next three.
        shared: parameters.
        agents: arrays [N, ...] of agents i.
        neighbours: arrays [N, ...] of agents j.
        pairs: arrays [N, N, ...] of (i, j).
        second: the second layer, `hidden -> B`.
        valid: [N] bool.

    Returns:
        [N, B], finite for every slot; 0 if nobody is valid.
    """
    layer = jax.vmap(first_layer, in_axes=(None, None, 0, 0))
    second_layer = second.kernel, second.bias
    highest: Any = _maximum(layer, shared, agents, neighbours, pairs, *second_layer, valid)
    return jnp.where(valid.any(), highest, 0)


@functools.partial(jax.custom_vjp, nondiff_argnums=(0,))
def _maximum(layer, shared, agents, neighbours, pairs, kernel, bias, valid):
    def of_agent(agent):
        return _candidates(layer, shared, neighbours, kernel, bias, valid, *agent).max(axis=0)

    return jax.lax.map(of_agent, (agents, pairs))


def _candidates(layer, shared, neighbours, kernel, bias, valid, own, of_pairs) -> Array:
    """[N, B] candidates of one agent; -inf where not valid."""
    hidden = nn.relu(layer(shared, own, neighbours, of_pairs))
    return jnp.where(valid[:, None], hidden @ kernel + bias, -jnp.inf)


def _forward(layer, shared, agents, neighbours, pairs, kernel, bias, valid):
    slots = jnp.arange(valid.shape[0])[:, None]

    def of_agent(agent):
        values = _candidates(layer, shared, neighbours, kernel, bias, valid, *agent)
        highest = values.max(axis=0)
        # `argmax` is several times slower on a CPU than these two reductions.
        return highest, jnp.where(values == highest, slots, valid.shape[0] - 1).min(axis=0)

    highest, winner = jax.lax.map(of_agent, (agents, pairs))
    return highest, (shared, agents, neighbours, pairs, kernel, winner)


def _backward(layer, saved, cotangent):
    shared, agents, neighbours, pairs, kernel, winner = saved
    weight = kernel.T

    def of_agent(sums, agent):
        of_shared, of_neighbours, of_weight = sums
        own, of_pairs, winner, cotangent = agent
        theirs, chosen = jax.tree.map(
            lambda rows: jnp.take(rows, winner, axis=0), (neighbours, of_pairs)
        )
        before, pull = jax.vjp(layer, shared, own, theirs, chosen)
        active = jnp.where(before > 0, cotangent[:, None], 0)
        more, of_own, of_theirs, of_chosen = pull(active * weight)
        sums = (
            jax.tree.map(jnp.add, of_shared, more),
            _add_rows(of_neighbours, winner, of_theirs),
            of_weight + active * before,
        )
        return sums, (of_own, _add_rows(jax.tree.map(jnp.zeros_like, of_pairs), winner, of_chosen))

    zeros = jax.tree.map(jnp.zeros_like, (shared, neighbours, weight))
    sums, (of_agents, of_pairs) = jax.lax.scan(of_agent, zeros, (agents, pairs, winner, cotangent))
    of_shared, of_neighbours, of_weight = sums
    return of_shared, of_agents, of_neighbours, of_pairs, of_weight.T, cotangent.sum(axis=0), None


def _add_rows(arrays: Any, rows: Array, values: Any) -> Any:
    return jax.tree.map(lambda array, value: array.at[rows].add(value), arrays, values)


_maximum.defvjp(_forward, _backward)


def bottleneck_relu(module: nn.Module, x: Array) -> Array:
    """`relu(x [..., F])`, the end of the pooling `module`.

    Its gradient at `x <= 0` is 0, or, where the module has the variable `leak` of the collection
    `training`, that share of the gradients which raise `x` (see `training.gentle_pooling`).
    """
    if not module.has_variable("training", "leak"):
        return nn.relu(x)
    return _leaking_relu(x, module.get_variable("training", "leak"))


@jax.custom_vjp
def _leaking_relu(x: Array, leak: Array) -> Array:
    return nn.relu(x)


def _leaking_forward(x: Array, leak: Array):
    return nn.relu(x), (x > 0, leak)


def _leaking_backward(saved, cotangent: Array):
    on, leak = saved
    raising = leak * jnp.minimum(cotangent, 0)
    return jnp.where(on, cotangent, raising), jnp.zeros_like(leak)


_leaking_relu.defvjp(_leaking_forward, _leaking_backward)
