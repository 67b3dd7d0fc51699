"""The table of forecasters: SGAN's and NeuroSyM's generators, anchors, and baselines to beat.

A generator encodes once and decodes once for each noise. Constant velocity, plain and sampled:
Schöller et al., "What the Constant Velocity Model Can Teach Us About Pedestrian Motion Prediction"
(RA-L 2020).
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.forecasting.anchors import AnchorsForecaster, AnchorTableForecaster
from neurosym_jax.forecasting.forecaster import (
    Forecaster,
    NoiseSpec,
    TwoStageForecaster,
    with_weighting,
)
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.models.layers import LSTM
from neurosym_jax.models.sgan import Generator, Weigh
from neurosym_jax.plugins import Registry
from neurosym_jax.scene import AnyArray, Scene, make_scene

__all__ = ["FORECASTERS", "HEADING_STD", "ConstantVelocity", "ConstantVelocitySampled"]
__all__ += ["GeneratorForecaster", "decode_scene", "encode_scene", "interact_scene"]
__all__ += ["register_forecaster"]

HEADING_STD = math.radians(25.0)
"""Standard deviation of the sampled heading, radians (Schöller et al.)."""


@dataclasses.dataclass(frozen=True)
class GeneratorForecaster(TwoStageForecaster):
    """A `Generator`: encoding and pooling once, then one decoding for each noise."""

    config: GeneratorConfig

    Config: ClassVar[type] = GeneratorConfig

    @property
    def title(self) -> str:
        """The pooling's title, the cell unless an LSTM, and the weighting."""
        cell, weighting = self.config.cell, self.config.weighting
        parts = [self.config.pooling.title]
        parts += [] if isinstance(cell, LSTM) else [cell.title]
        parts += [] if weighting is None else [weighting.name]
        return ", ".join(parts)

    @functools.partial(jax.jit, static_argnums=0)
    def initial(self, key: Array) -> Any:
        """See `Forecaster.initial`."""
        config = self.config
        scene = make_scene(np.zeros((1, config.obs_len, 2)))
        pairs = (1,) if "alpha_rows" in config.pooling.inputs else (1, 1)
        alpha = np.zeros((*pairs, config.obs_len))
        weigh = (lambda *_: alpha) if config.symbolic else None
        params = Generator(config).init(key, scene, np.zeros((1, config.noise_dim)), alpha, weigh)
        return with_weighting(params, config.weighting)

    @property
    def noise(self) -> NoiseSpec:
        """The config's."""
        config = self.config
        return NoiseSpec(config.noise_dim, config.noise_mix_type == "ped", config.noise_type)

    @property
    def state_size(self) -> int:
        """Gates and cell, and the perceptron before the first step; measured: 360 for SGAN's."""
        config = self.config
        return 8 * config.decoder_h_dim + config.mlp_dim + config.encoder_h_dim

    @property
    def sees_neighbours(self) -> bool:
        """Whether it has a pooling."""
        return self.config.pools

    @property
    def encoder(self) -> "GeneratorForecaster | None":
        """Encoding does not depend on the horizon; without pooling it is part of `decode`."""
        if not self.config.pools:
            return None
        return GeneratorForecaster(dataclasses.replace(self.config, pred_len=1))

    @property
    def decodes_alone(self) -> bool:
        """Unless it pools at every step."""
        return not self.config.pool_every_timestep

    def encode(self, params: Any, scene: Scene) -> Any:
        """Context `[N, C]`, see `encode_scene`."""
        return encode_scene(self.config, params, scene) if self.config.pools else ()

    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """See `TwoStageForecaster.decode`."""
        if not self.config.pools:
            context = encode_scene(self.config, params, scene)
        return decode_scene(self.config, params, context, scene, noise)


def encode_scene(
    config: GeneratorConfig, params: Any, scene: Scene, alpha: Array | None = None
) -> Any:
    """Context `[N, C]` of one scene: encoding, symbols and alpha (NeuroSyM), pooling.

    `alpha [N, N, obs_len]` replaces that of the config's weighting.
    """
    hidden = Generator(config).apply(params, scene.displacement, method=Generator.observe)
    return interact_scene(config, params, hidden, scene, alpha)


def interact_scene(
    config: GeneratorConfig,
    params: Any,
    hidden: Any,
    scene: Scene,
    alpha: Array | None = None,
    method: Callable[..., Any] = Generator.interact,
) -> Any:
    """The part of `encode_scene` that looks at neighbours, after the encoding `hidden [N, H]`.

    `method` is the generator's `interact`, or its `pool` for the pooled vectors.
    """
    weigh = _weighting(config, params)
    if alpha is None and weigh is not None:
        alpha = weigh(jnp.asarray(scene.observed), jnp.asarray(scene.valid))
    return Generator(config).apply(params, hidden, scene, alpha, method=method)


def decode_scene(
    config: GeneratorConfig, params: Any, context: Array, scene: Scene, noise: Array
) -> Array:
    """`[k, N, pred_len, 2]` metres relative to the scene's origin; see `Forecaster.forecast`."""
    weigh = _weighting(config, params)

    def decode(noise: Array) -> Any:
        given = (context, scene, noise, weigh)
        return Generator(config).apply(params, *given, method=Generator.decode)

    if config.pool_every_timestep:
        # One sample after the other: arrays of all samples' pairs do not stay in the cache.
        displacement: Any = jax.lax.map(decode, noise)
    else:
        displacement = jax.vmap(decode)(noise)
    return jnp.asarray(scene.observed)[None, :, -1, None] + jnp.cumsum(displacement, axis=-2)


def _weighting(config: GeneratorConfig, params: Any) -> Weigh | None:
    """The config's weighting with its trained parameters; None for a model without symbols."""
    if config.weighting is None:
        return None
    learned = params.get("weighting", {})
    return functools.partial(config.weighting.alpha, learned, period=config.period)


@dataclasses.dataclass(frozen=True)
class ConstantVelocity(TwoStageForecaster):
    """Every agent repeats its last observed step: one forecast."""

    @property
    def title(self) -> str:
        """What tables call it."""
        return "constant velocity"

    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """`[k, N, pred_len, 2]`, the same for every sample; `params` and `context` are empty."""
        step = jnp.broadcast_to(scene.displacement[:, -1], (len(noise), *scene.valid.shape, 2))
        return _extrapolate(scene.observed[:, -1], step, self.pred_len)


@dataclasses.dataclass(frozen=True)
class ConstantVelocitySampled(TwoStageForecaster):
    """Constant velocity, each agent's heading turned by its own Gaussian angle in each sample."""

    @property
    def title(self) -> str:
        """What tables call it."""
        return "constant velocity, sampled"

    @property
    def noise(self) -> NoiseSpec:
        """One standard normal number for each agent."""
        return NoiseSpec(dim=1, per_agent=True)

    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """`[k, N, pred_len, 2]`; `params` and `context` are empty."""
        angle = HEADING_STD * noise[..., 0]
        cos, sin = jnp.cos(angle), jnp.sin(angle)
        x, y = scene.displacement[:, -1, 0], scene.displacement[:, -1, 1]
        step = jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        return _extrapolate(scene.observed[:, -1], step, self.pred_len)


def _extrapolate(position: AnyArray, step: Array, pred_len: int) -> Array:
    """`position [N, 2]` moved by 1 .. pred_len times `step [k, N, 2]`: [k, N, pred_len, 2]."""
    steps = jnp.arange(1, pred_len + 1, dtype=position.dtype)
    return jnp.asarray(position)[:, None] + steps[:, None] * step[..., None, :]


FORECASTERS: Registry[type[Forecaster]] = Registry(
    "forecaster",
    {
        "generator": GeneratorForecaster,
        "anchors": AnchorsForecaster,
        "anchor_table": AnchorTableForecaster,
        "constant_velocity": ConstantVelocity,
        "constant_velocity_sampled": ConstantVelocitySampled,
    },
)

register_forecaster = FORECASTERS.register
