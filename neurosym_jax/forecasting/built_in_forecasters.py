"""The forecasters that the package brings, as a plugin would register its own."""

import functools
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.forecasting.baselines import ConstantVelocity, ConstantVelocitySampled
from neurosym_jax.forecasting.kinds import register_forecaster
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.models.pooling import POOLINGS
from neurosym_jax.scene import make_scene

__all__ = []


def _generator_title(config: GeneratorConfig) -> str:
    pooling, weighting = POOLINGS[config.pooling], config.weighting
    title = pooling.label
    if weighting is not None and pooling.of_pairs:
        title += f", {weighting.name}"
    return f"{title}, beside constant velocity" if config.beside_velocity else title


def _generator_shapes(config: GeneratorConfig) -> Mapping[str, tuple[int, ...]]:
    from neurosym_jax.symbolic.weighting import initial_parameters

    params: Any = _fresh.eval_shape(config, jax.random.key(0))
    if parameters := initial_parameters(config.weighting):
        params = {**params, "weighting": parameters}
    leaves = jax.tree_util.tree_leaves_with_path(params)
    return {jax.tree_util.keystr(at, simple=True, separator="/"): leaf.shape for at, leaf in leaves}


@functools.partial(jax.jit, static_argnums=0)
def _fresh(config: GeneratorConfig, key: jax.Array) -> Any:
    """New parameters; compiled only so that its shapes are traced once a configuration."""
    from neurosym_jax.models import Generator

    scene = make_scene(np.zeros((1, config.obs_len, 2)))
    pairs = (1, 1) if POOLINGS[config.pooling].of_pairs else (1,)
    alpha = np.zeros((*pairs, config.obs_len))
    weigh = (lambda *_: alpha) if config.symbolic else None
    return Generator(config).init(key, scene, np.zeros((1, config.noise_dim)), alpha, weigh)


register_forecaster(
    "generator",
    GeneratorForecaster,
    config=GeneratorConfig,
    title=_generator_title,
    shapes=_generator_shapes,
)
register_forecaster(
    "constant_velocity",
    lambda config: ConstantVelocity(config.pred_len),
    title="constant velocity",
)
register_forecaster(
    "constant_velocity_sampled",
    lambda config: ConstantVelocitySampled(config.pred_len),
    title="constant velocity, sampled",
)
