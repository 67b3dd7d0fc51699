"""Networks with random weights, which numpy draws: nothing is compiled."""

import jax
import numpy as np

from neurosym_jax.models.forecast import Model
from neurosym_jax.models.forecaster import forecaster_of


def drawing(std=None, seed=1):
    """A function from a shape to normal numbers, by default of the size that torch gives layers."""
    rng = np.random.default_rng(seed)
    return lambda shape: rng.normal(0, std or (shape or (1,))[0] ** -0.5, shape).astype(
        np.float32
    )


def random_params(network, *inputs, std=None, seed=1):
    """Parameters of a flax module that is called with these inputs."""
    shapes = jax.eval_shape(lambda key: network.init(key, *inputs), jax.random.key(0))
    draw = drawing(std, seed)
    return jax.tree.map(lambda leaf: draw(leaf.shape), shapes)


def random_model(config, dataset=None, std=None):
    """A model of this configuration."""
    forecaster, draw = forecaster_of(config), drawing(std)
    params = jax.tree.map(lambda leaf: draw(leaf.shape), forecaster.shapes())
    return Model(config, params, dataset, forecaster.key)
