"""What a forecaster is: k futures of one scene, given noise; `forecasters` has the table.

Equal forecasters are equal to `jax.jit`, so they share compiled programs.

Noise is a function of (seed, scene, sample, slot), the same however scenes are batched. Each scene,
or each agent slot where noise is per agent, has its own stream of random numbers. A sample's
numbers do not depend on how many samples are drawn, which is a property of JAX's partitionable
threefry (element i of an array depends on i alone) that the tests check.
"""

import abc
import dataclasses
import functools
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.configuration import Seed, refuse
from neurosym_jax.models.config import Lengths
from neurosym_jax.runtime.process import COMPILED_QUICKLY, refuse_beyond_memory
from neurosym_jax.scene import Scene
from neurosym_jax.symbolic.weighting import Weighting, initial_parameters

__all__ = ["Distribution", "Forecaster", "Lengths", "NoiseSpec", "TwoStageForecaster"]
__all__ += ["draw_noise", "refuse_many", "scene_noise", "with_weighting"]

CHUNK = 1024
"""Streams drawn in one call, so that one compiled program serves any number of scenes."""
Distribution = tuple[Array, Array | None]
"""Samples [k, N, pred_len, 2] of a scene and their probabilities [k]; None where all have the
same."""


@dataclasses.dataclass(frozen=True)
class NoiseSpec:
    """The noise that a forecaster takes for each sample; a deterministic one has `dim` 0."""

    dim: int = 0
    per_agent: bool = False
    distribution: Literal["gaussian", "uniform"] = "gaussian"
    """Standard normal, or uniform on [-1, 1)."""


@dataclasses.dataclass(frozen=True)
class Forecaster(abc.ABC):
    """A forecast of one scene, as a function of parameters, scene and noise."""

    config: Any
    """Configuration, of type `Config`."""

    Config: ClassVar[type] = Lengths
    """A frozen dataclass with at least the fields of `Lengths`."""

    @property
    def title(self) -> str:
        """What tables call it; by default the name of the class."""
        return type(self).__name__

    @property
    def pred_len(self) -> int:
        """Time steps that are forecast."""
        return self.config.pred_len

    @property
    def noise(self) -> NoiseSpec:
        """The noise it takes; by default none, a deterministic forecast."""
        return NoiseSpec()

    @property
    def state_size(self) -> int:
        """Numbers that decoding one sample of one agent takes besides the future itself."""
        return 0

    @property
    def sees_neighbours(self) -> bool:
        """Whether a forecast should depend on who else is in the scene."""
        return True

    def initial(self, key: Array) -> Any:
        """New parameters; consumes `key`. None if they are not known: nothing checks a model's."""
        return None

    def shapes(self) -> Any:
        """The parameters that `initial` makes, as shapes without values."""
        return jax.eval_shape(self.initial, jax.random.key(0))

    @abc.abstractmethod
    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """Futures [k, N, pred_len, 2] of one scene, metres relative to its origin.

        A function for `jax.vmap` and `jax.jit`. The scene has N slots, and neither `future` nor
        `origin`; `noise` is [k, dim], or [k, N, dim] where it is per agent; k = 1 for dim 0.
        """

    def prepared(self, scene: Scene) -> Scene:
        """The padded `scene` of a single forecast, with what is best computed on the host."""
        return scene

    def distribution(self, params: Any, scene: Scene, noise: Array) -> Distribution:
        """`forecast`, and the probabilities [k] of its samples; None where all have the same."""
        return self.forecast(params, scene, noise), None

    def count(self, samples: int) -> int:
        """Number of samples it makes where `samples` are asked for: one without noise.

        Raises:
            InputError: where it cannot make as many.
        """
        return samples if self.noise.dim else 1


class TwoStageForecaster(Forecaster):
    """A forecaster that encodes a scene once and decodes it for each noise.

    Where decoding looks at no neighbour, an evaluation decodes the agents of many scenes as one
    scene, without padding and by one program.
    """

    @property
    def encoder(self) -> "TwoStageForecaster | None":
        """The forecaster that encodes: equal ones share a program; None if `encode` gives ()."""
        return None

    @property
    def decodes_alone(self) -> bool:
        """Whether `decode` looks at no neighbour."""
        return True

    def encode(self, params: Any, scene: Scene) -> Any:
        """The context of one scene, which does not depend on the noise: arrays [N, ...] if any."""
        return ()

    @abc.abstractmethod
    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """As `forecast`, given the context [N, ...]; if `decodes_alone`, without identity."""

    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """See `Forecaster.forecast`."""
        return self.decode(params, self.encode(params, scene), scene, noise)


def refuse_many(
    forecaster: Forecaster, samples: int, agents: int, decoded: int | None = None
) -> None:
    """Refuse a forecast of `agents` people that would not fit into memory: XLA ends the process.

    `decoded` is the number of them that are decoded at the same time; default: all.

    Raises:
        InputError: with both sizes.
    """
    # Futures, a copy in their places, offsets from the truth; and the noise.
    future = 6 * forecaster.pred_len + 2 * forecaster.noise.dim
    numbers = agents * future + (agents if decoded is None else decoded) * forecaster.state_size
    what = f"a forecast of {agents} people at once with {samples} samples"
    refuse_beyond_memory(what, 4.0 * samples * numbers, "ask for fewer samples")


def with_weighting(params: Any, weighting: Weighting | None) -> Any:
    """The parameters of a network, and those that its weighting starts from, if it learns any."""
    start = jax.tree.map(jnp.asarray, initial_parameters(weighting))
    return {**params, "weighting": start} if start else params


def scene_noise(spec: NoiseSpec, key: Array, identity: Array, samples: int, agents: int) -> Array:
    """Noise of one scene, [k, dim] or per agent [k, N, dim].

    `key` is the run's, the same for every scene, and is not consumed; `identity` is `Scene`'s.
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
    each = slots[0] if slots else 1
    slot = np.tile(np.arange(each, dtype=np.uint32), len(identity))
    streams = np.column_stack([np.repeat(identity, each, axis=0), slot])
    key, parts = jax.random.key(seed), []
    for chunk in np.split(streams, range(CHUNK, len(streams), CHUNK)):
        filled = np.pad(chunk, [(0, CHUNK - len(chunk)), (0, 0)])
        parts.append(np.asarray(_streams(spec, key, filled[:, :2], filled[:, 2], samples)))
    return np.concatenate(parts, axis=1)[:, : len(slot)].reshape(shape)


def _stream(spec: NoiseSpec, key: Array, identity: Array, slot: Array, samples: int) -> Array:
    for part in (identity[0], identity[1], slot):
        key = jax.random.fold_in(key, part)
    # Always float32: under x64 the default type would be float64, which has other numbers.
    shape, dtype = (samples, spec.dim), jnp.float32
    if spec.distribution == "gaussian":
        return jax.random.normal(key, shape, dtype)
    return jax.random.uniform(key, shape, dtype, minval=-1.0, maxval=1.0)


@functools.partial(jax.jit, static_argnums=(0, 4), compiler_options=COMPILED_QUICKLY)
def _streams(spec, key, identity, slot, samples):
    draw = functools.partial(_stream, spec, key, samples=samples)
    return jax.vmap(draw, out_axes=1)(identity, slot)
