"""What people see of their neighbours in the anchors network: features of pairs, and attention."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.models.frames import closest_approach, length, turned
from neurosym_jax.symbolic.qtc import observe

__all__ = ["SLOW", "attend", "pair_features"]

SLOW = 0.125
"""Speed at which a heading has faded to 0.7, m/s; symbols take slower movement for none."""
WIDE = 20.0
"""Radius in which people are counted, metres."""
LONGEST = 5.0
"""Time within which the closest approach is searched, s."""


def pair_features(
    config: Any,
    observed: Array,
    velocity: Array,
    heading: Array,
    valid: Array,
    near: Array | None,
) -> tuple[Array, Array, Array]:
    """Features of j seen by i `[N, N, F]`, nearness `[N, N]` and number around `[N]`.

    With `near [N, C]`, j are these and the first two are `[N, C, ...]`.
    """
    position, number = observed[:, -1], jnp.arange(len(valid))

    def seen(values: Array) -> Array:
        return values if near is None else values[near]

    distance = length(seen(position) - position[:, None])
    features = []
    if config.geometry:
        pace = velocity / config.period
        features = _geometry(position, pace, heading, distance, config.radius, seen)
    if config.symbols:
        features += _symbols(observed, seen(observed), SLOW * config.period)
    others = seen(valid) & valid[:, None] & (seen(number) != number[:, None])
    stacked = jnp.where(others[..., None], jnp.stack(features, -1), 0)
    gate = jnp.where(others, _within(distance, config.radius), 0)
    if near is None:
        return stacked, gate, jnp.where(others, _within(distance, WIDE), 0).sum(1)
    return stacked, gate, _around(position, valid)


def attend(score: Array, value: Array, gate: Array) -> Array:
    """Attention with an empty slot, `sum_j g_ij exp(s_ij) v_ij / (1 + sum_j g_ij exp(s_ij))`.

    A softmax over neighbours alone would give a single neighbour the full weight at any distance.
    `score [N, N, HEADS]` and `value [N, N, M]`, an equal part for each head, give [N, M];
    `gate [N, N]` is 0 for a neighbour that is not attended to.
    """
    weight = gate[..., None] * jnp.exp(jnp.clip(score, -8, 8))
    share = weight / (1 + weight.sum(1, keepdims=True))
    value = value.reshape(*share.shape, -1)
    return (share[..., None] * value).sum(1).reshape(gate.shape[0], -1)


def _geometry(
    position: Array,
    velocity: Array,
    heading: Array,
    distance: Array,
    radius: float,
    seen: Callable[[Array], Array],
) -> list[Array]:
    """Features of pairs, each `[N, N]`: bearing, relative motion, closest approach, speeds.

    `velocity [N, 2]` is in m/s; `seen` gives values of j for values of all people.
    """
    there = turned(seen(position) - position[:, None], heading[:, None], -1)
    relative = seen(velocity) - velocity[:, None]
    motion = turned(relative, heading[:, None], -1)
    soon, miss = closest_approach(there, motion, 0.05, LONGEST)
    near = 1 / jnp.maximum(distance, 1)
    pace = length(velocity)
    theirs = jnp.broadcast_to(seen(pace), distance.shape)
    # The two are equal without `near`; this one would change the last bits of a training.
    own = theirs.T if seen(pace) is pace else jnp.broadcast_to(pace[:, None], distance.shape)
    return [
        *(there[..., 0] * near, there[..., 1] * near, motion[..., 0], motion[..., 1]),
        *(length(relative), jnp.exp(-distance), distance / radius, 1 / (distance + 0.3)),
        *(soon, jnp.exp(-2 * miss - soon), own, theirs),
    ]


def _around(position: Array, valid: Array) -> Array:
    """[N] the number of people around each; each is added for all others at once, in 4 N bytes."""
    x, y = position.T  # Apart, the loop runs in wide instructions: 25 times faster.

    def count(total: Array, other: Array) -> tuple[Array, None]:
        apart = jnp.hypot(x - x[other], y - y[other])
        return total + valid[other] * _within(apart, WIDE), None

    start = jnp.full(len(valid), -1, position.dtype)  # Nobody is around themselves.
    return jnp.maximum(jax.lax.scan(count, start, jnp.arange(len(valid)), unroll=8)[0], 0)


def _symbols(own: Array, theirs: Array, factor: float) -> list[Array]:
    """QTC_C1 symbols of all pairs at two steps, and their sizes: 16 features `[N, N]`."""
    features = []
    for end in (own.shape[-2], max(own.shape[-2] - 3, 2)):
        state = observe(
            *(each[..., end - 2 : end, :] for each in (own[:, None], theirs)),
            quantisation_factor=factor,
            side_quantisation_factor=factor,
        )[..., 0, :].astype(own.dtype)
        features += [*jnp.moveaxis(state, -1, 0), *jnp.moveaxis(jnp.abs(state), -1, 0)]
    return features


def _within(distance: Array, radius: float) -> Array:
    """1 at distance 0, falling smoothly to 0 at `radius`."""
    return jnp.square(jnp.maximum(1 - jnp.square(distance / radius), 0))
