"""Networks with random weights, which numpy draws: nothing is compiled."""

import jax
import numpy as np

from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.parameters import nested_parameters


def drawing(std=None, seed=1):
    """A function from a shape to normal numbers, by default of the size that torch gives layers."""
    rng = np.random.default_rng(seed)
    return lambda shape: rng.normal(0, std or shape[0] ** -0.5, shape).astype(np.float32)


def random_params(network, *inputs, std=None, seed=1):
    """Parameters of a flax module that is called with these inputs."""
    shapes = jax.eval_shape(lambda key: network.init(key, *inputs), jax.random.key(0))
    draw = drawing(std, seed)
    return jax.tree.map(lambda leaf: draw(leaf.shape), shapes)


def random_model(config, dataset=None, std=None):
    """A model of this configuration."""
    shapes, draw = Model(config, {}).forecaster.shapes(), drawing(std)
    assert shapes is not None
    return Model(config, nested_parameters({name: draw(shapes[name]) for name in shapes}), dataset)
