"""Headings, and vectors turned into the frame of a heading and back."""

import jax.numpy as jnp
from jax import Array

__all__ = ["heading_of", "length", "turned"]


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
