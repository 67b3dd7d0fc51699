"""A network small enough to compile in a second, and a ROS 1 node without ROS."""

import contextlib
import functools
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.forecast import Model
from neurosym_jax.models import Generator
from neurosym_jax.online.predictor import Predictor
from neurosym_jax.online.tcpros.xmlrpc import SlaveServer
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


@pytest.fixture
def forecast_node(model):
    """`forecast_node(**options)` is our node, with a master that knows nobody."""
    pytest.importorskip("rosbags", reason="rosbags is not installed")
    from neurosym_jax.online.ros1 import ForecastNode, Ros1Options

    with contextlib.ExitStack() as stack:

        def make(**options: Any) -> ForecastNode:
            master = SlaveServer("127.0.0.1", {})
            stack.callback(master.close)
            uri = f"http://127.0.0.1:{master.server_address[1]}"
            predictor = Predictor({"SGAN": model()}, samples=2, max_people=4)
            node = ForecastNode(predictor, Ros1Options((), master=uri, **options), print)
            stack.callback(node.close)
            return node

        yield make
