"""What people see of their neighbours: vectors in the frame of a heading, features, attention."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from neurosym_jax.symbolic.qtc import observe

__all__ = [
    "SLOW",
    "attend",
    "closest_approach",
    "heading_of",
    "length",
    "pair_features",
    "turned",
]

SLOW = 0.125
"""Speed at which a heading has faded to 0.7, m/s; symbols take slower movement for none."""
WIDE = 20.0
"""Radius in which people are counted, metres."""
LONGEST = 5.0
"""Time within which the closest approach is searched, s."""


def heading_of(velocity: Array, slow: float) -> Array:
    """Direction of `velocity [..., 2]`, with length near 1 above the speed `slow` and 0 at rest.

    Tracking noise of a standing person gives a random direction; this one fades out
    instead.
    """
    return velocity / length(velocity, slow)[..., None]


def turned(vector: Array, heading: Array, sign: int) -> Array:
    """`vector [..., 2]` rotated by the angle of `heading [..., 2]`; with sign -1 rotated back."""
    x, y = vector[..., 0], vector[..., 1]
    cos = heading[..., 0]
    sin = sign * heading[..., 1]
    return jnp.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)


def length(vector: Array, smooth: float = 1e-3) -> Array:
    """[...] length of `vector [..., 2]`, smooth below `smooth` metres so that 0 has a gradient."""
    return jnp.sqrt(jnp.square(vector).sum(axis=-1) + smooth**2)


def closest_approach(
    bearing: Array, motion: Array, slack: float, longest: float, smooth: float = 1e-3
) -> tuple[Array, Array]:
    """Time [...] from now to the closest approach, up to `longest`, and the distance [...] then.

    `bearing [..., 2]` is a relative position, `motion [..., 2]` its change in a unit of
    time; `slack` is added to the square of the motion, so that a pair at rest has the
    time 0.
    """
    soon = -(bearing * motion).sum(axis=-1) / (jnp.square(motion).sum(axis=-1) + slack)
    soon = jnp.clip(soon, 0, longest)
    return soon, length(bearing + motion * soon[..., None], smooth)


def pair_features(
    config: Any,
    observed: Array,
    velocity: Array,
    heading: Array,
    valid: Array,
    near: Array | None,
) -> tuple[Array, Array, Array]:
    """Features of j seen by i `[N, N, F]`, nearness `[N, N]` and number around `[N]`.

    With `near [N, C]`, j are these and the first two are `[N, C, ...]`. Features are
    the pair's bearing, motion, closest approach and speeds, its QTC_C1 symbols at two
    steps, or all of these.
    """
    position = observed[:, -1]
    number = jnp.arange(valid.shape[0])

    def seen(values: Array) -> Array:
        return values[near]  # None adds an axis.

    offset = seen(position) - position[:, None]
    distance = length(offset)
    features = []
    if config.geometry:
        pace = velocity / config.period
        bearing = turned(offset, heading[:, None], -1)
        relative = seen(pace) - pace[:, None]
        motion = turned(relative, heading[:, None], -1)
        soon, miss = closest_approach(bearing, motion, 0.05, LONGEST)
        close = 1 / jnp.maximum(distance, 1)
        speed = length(pace)
        other_speed = jnp.broadcast_to(seen(speed), distance.shape)
        # Equal without `near`, but a copy of the rows would change the last bits of a
        # training.
        own = (
            other_speed.T
            if near is None
            else jnp.broadcast_to(speed[:, None], distance.shape)
        )
        features += [
            *(
                bearing[..., 0] * close,
                bearing[..., 1] * close,
                motion[..., 0],
                motion[..., 1],
            ),
            *(
                length(relative),
                jnp.exp(-distance),
                distance / config.radius,
                1 / (distance + 0.3),
            ),
            *(soon, jnp.exp(-2 * miss - soon), own, other_speed),
        ]
    if config.symbols:
        factor = SLOW * config.period
        thresholds: Any = {
            "quantisation_factor": factor,
            "side_quantisation_factor": factor,
        }
        for end in (observed.shape[1], max(observed.shape[1] - 3, 2)):
            own_track, other_track = (
                track[..., end - 2 : end, :]
                for track in (observed[:, None], seen(observed))
            )
            state = observe(own_track, other_track, **thresholds)[..., 0, :].astype(
                observed.dtype
            )
            features += [
                *jnp.moveaxis(state, -1, 0),
                *jnp.moveaxis(jnp.abs(state), -1, 0),
            ]
    others = seen(valid) & valid[:, None] & (seen(number) != number[:, None])
    stacked = jnp.where(others[..., None], jnp.stack(features, -1), 0)
    gate = jnp.where(others, _within(distance, config.radius), 0)
    if near is None:
        return stacked, gate, jnp.where(others, _within(distance, WIDE), 0).sum(1)
    return stacked, gate, _around(position, valid)


def attend(score: Array, value: Array, gate: Array) -> Array:
    """Attention with an empty slot, `sum_j g_ij exp(s_ij) v_ij / (1 + sum_j g_ij exp(s_ij))`.

    A softmax over neighbours alone would give a single neighbour the full weight at any
    distance. `score [N, N, HEADS]` and `value [N, N, M]`, an equal part for each head,
    give [N, M]; `gate [N, N]` is 0 for a neighbour that is not attended to.
    """
    weight = gate[..., None] * jnp.exp(jnp.clip(score, -8, 8))
    share = weight / (1 + weight.sum(1, keepdims=True))
    value = value.reshape(*share.shape, -1)
    return (share[..., None] * value).sum(1).reshape(gate.shape[0], -1)


def _around(position: Array, valid: Array) -> Array:
    """[N] the number of people around each; each is added for all others at once, in 4 N bytes."""
    x, y = position.T  # Apart, the loop runs in wide instructions: 25 times faster.

    def count(total: Array, other: Array) -> tuple[Array, None]:
        apart = jnp.hypot(x - x[other], y - y[other])
        return total + valid[other] * _within(apart, WIDE), None

    start = jnp.full(valid.shape[0], -1, position.dtype)  # Nobody is around themselves.
    return jnp.maximum(
        jax.lax.scan(count, start, jnp.arange(valid.shape[0]), unroll=8)[0], 0
    )


def _within(distance: Array, radius: float) -> Array:
    """1 at distance 0, falling smoothly to 0 at `radius`."""
    return jnp.square(jnp.maximum(1 - jnp.square(distance / radius), 0))
