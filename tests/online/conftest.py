"""A network small enough to compile in a second."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.forecast import Model
from neurosym_jax.models import Generator
from neurosym_jax.scene import make_scene


@pytest.fixture(scope="session")
def model() -> Callable[..., Model]:
    """`model(pooling, noise_mix_type)`: random weights; it observes 4 steps and forecasts 3."""

    @functools.cache
    def make(pooling: Any = "pool_net", noise_mix_type: Any = "global") -> Model:
        config = GeneratorConfig(
            pooling=pooling,
            noise_mix_type=noise_mix_type,
            obs_len=4,
            pred_len=3,
            pool_hidden_dim=16,
        )
        scene, alpha = make_scene(np.zeros((1, 4, 2))), np.zeros((1, 1, 4))
        noise = np.zeros(config.noise_dim)
        shapes = jax.eval_shape(Generator(config).init, jax.random.key(0), scene, noise, alpha)
        rng = np.random.default_rng(1)
        params = jax.tree.map(
            lambda leaf: rng.normal(0, leaf.shape[0] ** -0.5, leaf.shape).astype(np.float32), shapes
        )
        return Model(config, params)

    return make
