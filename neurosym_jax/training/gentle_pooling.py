"""How the poolings of SGAN and NeuroSyM are trained so that their units do not die.

Such a pooling ends in a layer of 512 inputs, a maximum over neighbours and a ReLU. A unit that is
never above 0 has no gradient and stays so. The layer's first values are large (positions are in
metres), so a loss shuts units at once, and one Adam step of size r moves a unit by up to 512 r
times its inputs. So the layer starts small and above 0, learns slowly, and a unit below 0 gets a
share of the gradients that raise it. Forecasts of given parameters do not change.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

__all__ = ["slowed", "started", "with_leak"]

SCALE, BIAS = 0.3, 0.5
"""Factor of the initial weights of the bottleneck's layer, and its initial biases."""
RATE = 0.05
"""Factor of the learning rate of the pooling's parameters."""
LEAK = 0.1
"""Share of the gradients that raise a unit, where the unit is below 0."""


def started(generator: Any) -> Any:
    """The variables `generator` with a small layer above 0 at the end of each pooling."""

    def start(pooling: Any) -> Any:
        layer = pooling["mlp"]["layer_1"]
        layer = {"kernel": SCALE * layer["kernel"], "bias": jnp.full_like(layer["bias"], BIAS)}
        return {**pooling, "mlp": {**pooling["mlp"], "layer_1": layer}}

    return _changed(generator, start)


def slowed(update: Any) -> Any:
    """Adam's `update` of the generator with the poolings' part at their own learning rate."""
    return _changed(update, lambda pooling: jax.tree.map(lambda leaf: RATE * leaf, pooling))


def with_leak(generator: Any) -> Any:
    """The variables `generator` for a loss, see `models.pool_net.bottleneck_relu`."""
    leak = {"pooling": {"leak": jnp.float32(LEAK)}}
    return {**generator, "training": {**leak, "decoder": leak}}


def _changed(tree: Any, change: Callable[[Any], Any]) -> Any:
    """`tree` with `change` of the parameters of each pooling that ends in such a layer."""
    if not isinstance(tree, dict):
        return tree
    return {
        name: change(part)
        if name == "pooling" and "layer_1" in part.get("mlp", ())
        else _changed(part, change)
        for name, part in tree.items()
    }
