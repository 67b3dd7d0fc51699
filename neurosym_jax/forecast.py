"""From a scene to k sampled futures: the noise, and the mapping of a generator over it.

A forecast's noise is a function of (seed, scene identity, sample index) and, where noise is per
agent, of the agent's slot: it does not depend on how scenes are batched, padded or ordered, nor on
how many samples are asked for.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import ArrayLike

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.data.batching import bucket_of
from neurosym_jax.errors import InputError
from neurosym_jax.models import Generator
from neurosym_jax.scene import Scene, make_scene, pad_scene, to_world

__all__ = ["GeneratorForecast", "Model", "forecast_scene", "predict", "sample_noise", "scene_key"]


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A generator's configuration and parameters, and what is known of where they came from."""

    config: GeneratorConfig
    params: dict[str, Any]
    scene: str | None = None
    """The benchmark scene left out of its training, where known."""


def scene_key(key: Array, identity: Array) -> Array:
    """The scene's own random key: `key` folded with `identity [2]`; `key` is not consumed."""
    return jax.random.fold_in(jax.random.fold_in(key, identity[0]), identity[1])


def sample_noise(config: GeneratorConfig, key: Array, samples: int, agents: int) -> Array:
    """Noise for one scene, from the scene's own key.

    Returns:
        [samples, noise_dim] where noise is global to the scene, else [samples, agents, noise_dim].
        Sample s (and slot n) does not depend on how many samples (and slots) there are.
    """

    def draw(key: Array) -> Array:
        if config.noise_type == "gaussian":
            return jax.random.normal(key, (config.noise_dim,))
        return jax.random.uniform(key, (config.noise_dim,), minval=-1.0, maxval=1.0)

    split = jax.vmap(jax.random.fold_in, in_axes=(None, 0))
    keys = split(key, jnp.arange(samples))
    if config.noise_mix_type == "global":
        return jax.vmap(draw)(keys)
    slots = jax.vmap(split, in_axes=(0, None))(keys, jnp.arange(agents))
    return jax.vmap(jax.vmap(draw))(slots)


def forecast_scene(
    config: GeneratorConfig, params: Any, scene: Scene, key: Array, samples: int
) -> Array:
    """`[samples, N, pred_len, 2]` positions in metres relative to the scene's origin.

    `key` is the evaluation's, the same for every scene; encoding and pooling are done once.
    """
    generator = Generator(config)
    noise = sample_noise(config, scene_key(key, scene.identity), samples, scene.valid.shape[0])
    context = generator.apply(params, scene, method="encode")
    decode = functools.partial(generator.apply, params, context, scene, method="decode")
    displacement = jax.vmap(decode)(noise)
    return scene.observed[:, -1, None] + jnp.cumsum(displacement, axis=-2)


@dataclasses.dataclass(frozen=True)
class GeneratorForecast:
    """`forecast_scene` for a fixed config: equal configs are equal functions to `jax.jit`."""

    config: GeneratorConfig

    def __call__(self, params: Any, scene: Scene, key: Array, samples: int) -> Array:
        """See `forecast_scene`."""
        return forecast_scene(self.config, params, scene, key, samples)


@functools.partial(jax.jit, static_argnums=(0, 4))
def _forecast_jitted(config, params, scene, key, samples):
    return forecast_scene(config, params, scene, key, samples)


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
        frame: start frame.

    Returns:
        [samples, N, pred_len, 2] float64 metres.

    Raises:
        InputError: for a wrong shape or a coordinate that is not finite.
    """
    scene = make_scene(observed, recording=recording, frame=frame)
    agents, steps = scene.observed.shape[:2]
    if steps != model.config.obs_len:
        raise InputError(f"observed has {steps} steps; the model observes {model.config.obs_len}")
    padded = pad_scene(scene, int(bucket_of(agents)))
    forecast = _forecast_jitted(model.config, model.params, padded, jax.random.key(seed), samples)
    return to_world(np.asarray(forecast)[:, :agents], scene)
