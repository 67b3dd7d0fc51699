"""The noise of stochastic forecasters.

Noise is a function of (seed, scene, sample, slot), the same however scenes are batched.
Each scene, or each agent slot where noise is per agent, has its own stream of random
numbers. A sample's numbers do not depend on how many samples are drawn, which is a
property of JAX's partitionable threefry (element i of an array depends on i alone) that
the tests check.
"""

import dataclasses
import functools
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.configuration import Seed, refuse
from neurosym_jax.runtime.process import COMPILED_QUICKLY
from neurosym_jax.runtime.programs import program

__all__ = ["NoiseSpec", "draw_noise", "key_numbers", "key_of", "scene_noise"]

CHUNK = 1024
"""Streams drawn in one call, so that one compiled program serves any number of scenes."""


@dataclasses.dataclass(frozen=True)
class NoiseSpec:
    """The noise that a forecaster takes for each sample; a deterministic one has `dim` 0."""

    dim: int = 0
    per_agent: bool = False
    distribution: Literal["gaussian", "uniform"] = "gaussian"
    """Standard normal, or uniform on [-1, 1)."""

    def draw(self, key: Array, shape: tuple[int, ...], dtype: Any = float) -> Array:
        """Numbers [*shape] of the distribution; consumes `key`."""
        if self.distribution == "gaussian":
            return jax.random.normal(key, shape, dtype)
        return jax.random.uniform(key, shape, dtype, minval=-1.0, maxval=1.0)


def scene_noise(
    spec: NoiseSpec, key: Array, identity: Array, samples: int, agents: int
) -> Array:
    """Noise of one scene, [k, dim] or per agent [k, N, dim].

    `key` is the run's, the same for every scene, and is not consumed; `identity` is
    `Scene`'s.
    """
    slots = jnp.arange(agents, dtype=jnp.uint32) if spec.per_agent else jnp.uint32(0)
    draw = functools.partial(_stream, spec, key, identity, samples=samples)
    return jax.vmap(draw, out_axes=1)(slots) if spec.per_agent else draw(slots)


def draw_noise(
    spec: NoiseSpec, seed: int, identity: np.ndarray, samples: int, agents: int
) -> np.ndarray:
    """`scene_noise` of B scenes, `identity [B, 2]`: [k, B, dim] or [k, B, N, dim] on the host.

    Raises:
        InputError: for a seed outside [0, 2**32), which JAX would silently wrap.
    """
    refuse(Seed, {"seed": seed})
    slots = (agents,) if spec.per_agent else ()
    shape = (samples, len(identity), *slots, spec.dim)
    if spec.dim == 0:
        return np.zeros(shape, np.float32)
    per_scene = slots[0] if slots else 1
    slot = np.tile(np.arange(per_scene, dtype=np.uint32), len(identity))
    streams = np.column_stack([np.repeat(identity, per_scene, axis=0), slot])
    key, parts = key_numbers(seed), []
    for chunk in np.split(streams, range(CHUNK, len(streams), CHUNK)):
        filled = np.pad(chunk, [(0, CHUNK - len(chunk)), (0, 0)])
        parts.append(
            np.asarray(_streams(spec, key, filled[:, :2], filled[:, 2], samples))
        )
    return np.concatenate(parts, axis=1)[:, : len(slot)].reshape(shape)


def key_numbers(seed: int) -> np.ndarray:
    """[2] uint32: the numbers of `jax.random.key(seed)`, on the host."""
    return np.array([0, seed], np.uint32)


def key_of(numbers: Array) -> Array:
    """The key of `key_numbers [2]`, made within a program: outside, it would be one of its own."""
    return jax.random.wrap_key_data(numbers, impl="threefry2x32")


def _stream(
    spec: NoiseSpec, key: Array, identity: Array, slot: Array, samples: int
) -> Array:
    for part in (identity[0], identity[1], slot):
        key = jax.random.fold_in(key, part)
    # Always float32: under x64 the default type would be float64, which has other
    # numbers.
    return spec.draw(key, (samples, spec.dim), jnp.float32)


@program((0, 4), compiler_options=COMPILED_QUICKLY)
def _streams(spec, key, identity, slot, samples):
    draw = functools.partial(_stream, spec, key_of(key), samples=samples)
    return jax.vmap(draw, out_axes=1)(identity, slot)
