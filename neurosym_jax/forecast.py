"""From scenes to k sampled futures: the forecasters, and where scenes gain their batch axis.

A forecaster is written for one scene, `one(params, scene, noise)`; `batch` maps it over padded
scenes. Equal forecasters are equal to `jax.jit`, so they share compiled programs.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.data.batching import bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.models import Generator
from neurosym_jax.noise import NoiseSpec, draw_noise
from neurosym_jax.scene import Scene, make_scene, pad_scene, to_world
from neurosym_jax.symbolic.weighting import pair_alpha

__all__ = [
    "AgentwiseForecaster",
    "Forecaster",
    "GeneratorForecaster",
    "Model",
    "decode_scene",
    "encode_scene",
    "forecast_scene",
    "predict",
]

PART = 256
"""Agents decoded in one call: with 20 samples their states stay in the second-level cache."""


@dataclasses.dataclass(frozen=True)
class Forecaster:
    """A forecast of one scene, as a function of parameters, scene and noise."""

    pred_len: int

    @property
    def noise(self) -> NoiseSpec:
        """The noise it wants; the default is none, a deterministic forecast."""
        return NoiseSpec()

    def one(self, params: Any, scene: Scene, noise: Array) -> Array:
        """`[k, N, pred_len, 2]` metres relative to the scene's origin.

        `noise` is `[k, dim]`, or `[k, N, dim]` where the spec says per agent.
        """
        raise TypeError(f"{type(self).__name__} does not say how it forecasts a scene")

    def packed(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """`[k, A, pred_len, 2]`: futures of the A valid agents of `scenes`, scene after scene.

        `scenes` has a leading axis of B scenes, `noise` is `[k, B, dim]` or `[k, B, N, dim]`.
        """
        futures = np.asarray(_over_scenes(self, params, scenes, noise))
        return futures[:, np.asarray(scenes.valid)]

    def batch(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """`packed` in its places, `[k, B, N, pred_len, 2]`; zero where a slot is not valid."""
        valid = np.asarray(scenes.valid)
        packed = self.packed(params, scenes, noise)
        futures = np.zeros((len(packed), *valid.shape, *packed.shape[2:]), packed.dtype)
        futures[:, valid] = packed
        return futures


class AgentwiseForecaster(Forecaster):
    """A forecaster in which agents do not look at each other.

    The agents of all scenes are then forecast as if they were one scene, without padding, in parts
    of one size: a single compiled program serves every bucket.
    """

    def packed(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """See `Forecaster.packed`."""
        return in_parts(
            lambda scene, noise: forecast_scene(self, params, scene, noise),
            *pack_agents(scenes, noise),
        )


def pack_agents(scenes: Scene, noise: np.ndarray) -> tuple[Scene, np.ndarray]:
    """The valid agents of a batch as one scene of A agents, and their noise `[k, A, dim]`."""
    valid = np.asarray(scenes.valid)
    if noise.ndim == 3:
        noise = np.broadcast_to(
            noise[:, :, None], (*noise.shape[:2], valid.shape[1], noise.shape[2])
        )
    agents = jax.tree.map(lambda leaf: np.asarray(leaf)[valid], scenes.replace(identity=None))
    return agents, noise[:, valid]


def in_parts(forecast: Callable[[Any, Any], Array], agents: Any, noise: np.ndarray) -> np.ndarray:
    """`forecast(agents, noise)` in parts of `PART` agents: `[k, A, pred_len, 2]`.

    `agents` are arrays with a leading axis of A agents, `noise` is `[k, A, dim]`.
    """
    count = noise.shape[1]
    parts = []
    for at in range(0, max(count, 1), PART):
        short = max(0, at + PART - count)

        def part(leaf: np.ndarray, axis: int, at: int = at, short: int = short) -> np.ndarray:
            index = (slice(None),) * axis + (slice(at, at + PART),)
            widths = [(0, short if dim == axis else 0) for dim in range(leaf.ndim)]
            return np.pad(leaf[index], widths) if short else leaf[index]

        futures = forecast(jax.tree.map(lambda leaf: part(leaf, 0), agents), part(noise, 1))
        parts.append(np.asarray(futures)[:, : PART - short])
    return np.concatenate(parts, axis=1)


@functools.partial(jax.jit, static_argnums=0)
def _over_scenes(forecaster: Forecaster, params, scenes, noise):
    return jax.vmap(forecaster.one, in_axes=(None, 0, 1), out_axes=1)(params, scenes, noise)


@functools.partial(jax.jit, static_argnums=0)
def forecast_scene(forecaster: Forecaster, params: Any, scene: Scene, noise: Any) -> Array:
    """`forecaster.one`, compiled; equal forecasters share the program."""
    return forecaster.one(params, scene, noise)


@dataclasses.dataclass(frozen=True)
class GeneratorForecaster(Forecaster):
    """A `Generator`: encoding and pooling once, then one decoding for each noise."""

    pred_len: int = dataclasses.field(init=False)
    config: GeneratorConfig

    def __post_init__(self):
        """Take the horizon from the config."""
        object.__setattr__(self, "pred_len", self.config.pred_len)

    @property
    def noise(self) -> NoiseSpec:
        """As the config says."""
        config = self.config
        return NoiseSpec(config.noise_dim, config.noise_mix_type == "ped", config.noise_type)

    def one(self, params: Any, scene: Scene, noise: Array) -> Array:
        """See `Forecaster.one`."""
        context = encode_scene(self.config, params, scene)
        return decode_scene(self.config, params, context, scene, noise)

    def packed(self, params: Any, scenes: Scene, noise: np.ndarray) -> np.ndarray:
        """See `Forecaster.packed`; what looks at no neighbours works on packed agents."""
        if self.config.pool_every_timestep:
            return super().packed(params, scenes, noise)
        agents, noise = pack_agents(scenes, noise)
        if self.config.pooling == "none":
            return in_parts(
                lambda scene, noise: forecast_scene(self, params, scene, noise), agents, noise
            )
        context = np.asarray(_encode_scenes(self.config, params, scenes))[np.asarray(scenes.valid)]
        return in_parts(
            lambda part, noise: _decode_agents(self.config, params, *part, noise),
            (context, agents),
            noise,
        )


def encode_scene(config: GeneratorConfig, params: Any, scene: Scene) -> Any:
    """Context `[N, C]` of one scene: symbols and alpha (NeuroSyM), encoding, pooling."""
    alpha = None
    if config.weighting is not None:
        alpha = pair_alpha(scene.observed, scene.valid, weighting=config.weighting)
    return Generator(config).apply(params, scene, alpha, method="encode")


def decode_scene(
    config: GeneratorConfig, params: Any, context: Array, scene: Scene, noise: Array
) -> Array:
    """`[k, N, pred_len, 2]` metres relative to the scene's origin; see `Forecaster.one`."""
    decode = functools.partial(Generator(config).apply, params, context, scene, method="decode")
    displacement: Any = jax.vmap(decode)(noise)
    return scene.observed[:, -1, None] + jnp.cumsum(displacement, axis=-2)


_decode_agents = jax.jit(decode_scene, static_argnums=0)


@functools.partial(jax.jit, static_argnums=0)
def _encode_scenes(config, params, scenes):
    return jax.vmap(functools.partial(encode_scene, config), in_axes=(None, 0))(params, scenes)


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A generator's configuration and parameters, and what is known of where they came from."""

    config: GeneratorConfig
    params: dict[str, Any]
    scene: str | None = None
    """The benchmark scene left out of its training, where known."""

    @property
    def name(self) -> str:
        """What kind of model this is."""
        return {
            "none": "SGAN, no pooling",
            "pool_net": "SGAN",
            "social": "SGAN, social pooling",
            "as_described": f"NeuroSyM, {self.config.weighting}",
            "neurosym_ros": f"NeuroSyM (robot package), {self.config.weighting}",
            "neurosym_ijcnn": "NeuroSyM (IJCNN release)",
        }[self.config.pooling]

    @property
    def forecaster(self) -> GeneratorForecaster:
        """The forecaster of this model's parameters."""
        return GeneratorForecaster(self.config)


def predict(
    model: Model,
    observed: ArrayLike,
    *,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    frame: int = 0,
) -> np.ndarray:
    """Forecast one scene in the caller's own frame.

    Args:
        model: see `load_model`.
        observed: [N, obs_len, 2] metres.
        samples: number of futures.
        seed: with `recording` and `frame`, determines the noise.
        recording: name of the recording.
        frame: index of the first observed step in the recording.

    Returns:
        [samples, N, pred_len, 2] float64 metres.

    Raises:
        InputError: for a wrong shape or a coordinate that is not finite.
    """
    scene = make_scene(observed, recording=recording, frame=frame)
    agents, steps = scene.observed.shape[:2]
    if steps != model.config.obs_len:
        raise InputError(f"observed has {steps} steps; the model observes {model.config.obs_len}")
    slots = int(bucket_of(agents))
    padded = pad_scene(scene, slots).replace(origin=None)
    forecaster = model.forecaster
    noise = draw_noise(forecaster.noise, seed, padded.identity[None], samples, slots)
    forecast = forecast_scene(forecaster, model.params, padded, noise[:, 0])
    return to_world(np.asarray(forecast)[:, :agents], scene)
