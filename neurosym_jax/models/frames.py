"""Headings, vectors turned into the frame of a heading and back, and closest approaches."""

import jax.numpy as jnp
from jax import Array

__all__ = ["closest_approach", "heading_of", "length", "turned"]


def heading_of(velocity: Array, slow: float) -> Array:
    """Direction of `velocity [..., 2]`, with length near 1 above the speed `slow` and 0 at rest.

    Tracking noise of a standing person gives a random direction; this one fades out instead.
    """
    return velocity / jnp.sqrt(jnp.square(velocity).sum(-1, keepdims=True) + slow**2)


def turned(vector: Array, heading: Array, sign: int) -> Array:
    """`vector [..., 2]` rotated by the angle of `heading [..., 2]`; with sign -1 rotated back."""
    x, y = vector[..., 0], vector[..., 1]
    cos, sin = heading[..., 0], sign * heading[..., 1]
    return jnp.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)


def length(vector: Array, smooth: float = 1e-3) -> Array:
    """[...] length of `vector [..., 2]`, smooth below `smooth` metres so that 0 has a gradient."""
    return jnp.sqrt(jnp.square(vector).sum(axis=-1) + smooth**2)


def closest_approach(
    there: Array, motion: Array, slack: float, longest: float, smooth: float = 1e-3
) -> tuple[Array, Array]:
    """Time [...] from now to the closest approach, up to `longest`, and the distance [...] then.

    `there [..., 2]` is a relative position, `motion [..., 2]` its change in a unit of time; `slack`
    is added to the square of the motion, so that a pair at rest has the time 0.
    """
    soon = -(there * motion).sum(axis=-1) / (jnp.square(motion).sum(axis=-1) + slack)
    soon = jnp.clip(soon, 0, longest)
    return soon, length(there + motion * soon[..., None], smooth)
