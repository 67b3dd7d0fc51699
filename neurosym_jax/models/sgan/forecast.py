"""The generator as functions of one scene: initialisation, encoding, pooling, decoding."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.forecasting.forecaster import with_weighting
from neurosym_jax.models.sgan.config import GeneratorConfig
from neurosym_jax.models.sgan.network import Generator, Weigh
from neurosym_jax.scene import Scene, make_scene

__all__ = ["decode_scene", "encode_scene", "init_generator", "interact_scene"]


@functools.partial(jax.jit, static_argnums=0)
def init_generator(config: GeneratorConfig, key: Array) -> Any:
    """New parameters, as SGAN draws them, and those of the weighting; consumes `key`."""
    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    pairs = (1,) if "alpha_rows" in config.pooling.inputs else (1, 1)
    alpha = np.zeros((*pairs, config.obs_len))
    weigh = (lambda *_: alpha) if config.symbolic else None
    params = Generator(config).init(
        key, scene, np.zeros((1, config.noise_dim)), alpha, weigh
    )
    return with_weighting(params, config.weighting)


def encode_scene(config: GeneratorConfig, params: Any, scene: Scene) -> Any:
    """Context `[N, C]` of one scene: encoding, symbols and alpha (NeuroSyM), pooling."""
    hidden = Generator(config).apply(
        params, scene.displacement, method=Generator.observe
    )
    return interact_scene(config, params, hidden, scene)


def interact_scene(
    config: GeneratorConfig,
    params: Any,
    hidden: Any,
    scene: Scene,
    method: Callable[..., Any] = Generator.interact,
) -> Any:
    """The part of `encode_scene` that looks at neighbours, after the encoding `hidden [N, H]`.

    `method` is the generator's `interact`, or its `pool` for the pooled vectors.
    """
    weigh, alpha = _weighting(config, params), scene.alpha
    if alpha is None and weigh is not None:
        alpha = weigh(jnp.asarray(scene.observed), jnp.asarray(scene.valid))
    return Generator(config).apply(params, hidden, scene, alpha, method=method)


def decode_scene(
    config: GeneratorConfig, params: Any, context: Array, scene: Scene, noise: Array
) -> Array:
    """`[k, N, pred_len, 2]` metres relative to the scene's origin; see `Forecaster.forecast`."""
    weigh = _weighting(config, params)

    def decode(noise: Array) -> Any:
        inputs = (context, scene, noise, weigh)
        return Generator(config).apply(params, *inputs, method=Generator.decode)

    if config.pool_every_timestep:
        # One sample after the other: arrays of all samples' pairs do not stay in the
        # cache.
        displacement: Any = jax.lax.map(decode, noise)
    else:
        displacement = jax.vmap(decode)(noise)
    return jnp.asarray(scene.observed)[None, :, -1, None] + jnp.cumsum(
        displacement, axis=-2
    )


def _weighting(config: GeneratorConfig, params: Any) -> Weigh | None:
    """The config's weighting with its trained parameters; None for a model without symbols."""
    weighting = config.weighting
    if weighting is None:
        return None
    learned = params.get("weighting", {})
    return functools.partial(weighting.alpha, learned, period=config.period)
