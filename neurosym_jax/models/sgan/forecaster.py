"""The family of SGAN and NeuroSyM: a generator encodes a scene once, and decodes each noise."""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from neurosym_jax.forecasting.forecaster import (
    NoiseSpec,
    TwoStageForecaster,
    with_weighting,
)
from neurosym_jax.models.sgan.config import POOLINGS, GeneratorConfig
from neurosym_jax.models.sgan.layers import LSTM
from neurosym_jax.models.sgan.network import Generator, Weigh
from neurosym_jax.models.sgan.pooling import NO_FORECAST
from neurosym_jax.models.sgan.recipe import RECIPES
from neurosym_jax.scene import Scene, make_scene

__all__ = ["GeneratorForecaster", "decode_scene", "encode_scene", "init_generator"]
__all__ += ["interact_scene"]


@dataclasses.dataclass(frozen=True)
class GeneratorForecaster(TwoStageForecaster):
    """A `Generator`: encoding and pooling once, then one decoding for each noise."""

    config: GeneratorConfig

    Config: ClassVar[type] = GeneratorConfig
    configs: ClassVar[Mapping[str, Any]] = {
        "sgan": GeneratorConfig(),
        "neurosym": GeneratorConfig(pooling=POOLINGS["as_described"]()),
    }
    recipes: ClassVar[Mapping[str, Any]] = RECIPES

    @property
    def model(self) -> str:
        """`neurosym` if its pooling weights pairs, else `sgan`."""
        weighted = self.config.pooling.inputs & {"alpha", "alpha_rows"}
        return "neurosym" if weighted else "sgan"

    @property
    def variant(self) -> str:
        """The model, its pooling and weighting."""
        pooling, weighting = POOLINGS.name_of(self.config.pooling), self.config.weighting
        if weighting is None:
            return f"sgan_{pooling}"
        return f"neurosym_{pooling.removeprefix('neurosym_')}_{weighting.name}"

    @property
    def title(self) -> str:
        """The pooling's title, the cell unless an LSTM, and the weighting."""
        cell, weighting = self.config.cell, self.config.weighting
        parts = [self.config.pooling.title]
        parts += [] if isinstance(cell, LSTM) else [cell.title]
        parts += [] if weighting is None else [weighting.name]
        return ", ".join(parts)

    @property
    def unfit(self) -> str:
        """See `pooling.NO_FORECAST`."""
        rows = "alpha_rows" in self.config.pooling.inputs
        return f"{POOLINGS.name_of(self.config.pooling)} {NO_FORECAST}" if rows else ""

    def init(self, key: Array) -> Any:
        """See `Forecaster.init`."""
        return init_generator(self.config, key)

    @property
    def noise(self) -> NoiseSpec:
        """The config's."""
        config = self.config
        return NoiseSpec(config.noise_dim, config.noise_mix_type == "ped", config.noise_type)

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

    def best_of(self, recipe: Any) -> int:
        """The recipe's."""
        return recipe.best_k

    def init_state(self, recipe: Any, key: Array) -> Any:
        """See `step.init_state`: a recipe may have a discriminator."""
        from neurosym_jax.models.sgan.step import init_state

        return init_state(self.config, recipe, key)

    def rounds(self, windows: Any, recipe: Any, key: Array) -> Callable[..., tuple[Any, Any]]:
        """A round is one compiled call, see `step.train_steps`."""
        from neurosym_jax.models.sgan.step import generator_rounds

        return generator_rounds(self.config, windows, recipe, key)


@functools.partial(jax.jit, static_argnums=0)
def init_generator(config: GeneratorConfig, key: Array) -> Any:
    """New parameters, as SGAN draws them, and those of the weighting; consumes `key`."""
    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    pairs = (1,) if "alpha_rows" in config.pooling.inputs else (1, 1)
    alpha = np.zeros((*pairs, config.obs_len))
    weigh = (lambda *_: alpha) if config.symbolic else None
    params = Generator(config).init(key, scene, np.zeros((1, config.noise_dim)), alpha, weigh)
    return with_weighting(params, config.weighting)


def encode_scene(config: GeneratorConfig, params: Any, scene: Scene) -> Any:
    """Context `[N, C]` of one scene: encoding, symbols and alpha (NeuroSyM), pooling."""
    hidden = Generator(config).apply(params, scene.displacement, method=Generator.observe)
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
        given = (context, scene, noise, weigh)
        return Generator(config).apply(params, *given, method=Generator.decode)

    if config.pool_every_timestep:
        # One sample after the other: arrays of all samples' pairs do not stay in the cache.
        displacement: Any = jax.lax.map(decode, noise)
    else:
        displacement = jax.vmap(decode)(noise)
    return jnp.asarray(scene.observed)[:, -1, None] + jnp.cumsum(displacement, axis=-2)


def _weighting(config: GeneratorConfig, params: Any) -> Weigh | None:
    """The config's weighting with its trained parameters; None for a model without symbols."""
    weighting = config.weighting
    if weighting is None:
        return None
    learned = params.get("weighting", {})
    return functools.partial(weighting.alpha, learned, period=config.period)
