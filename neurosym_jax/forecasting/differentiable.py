"""The forecast as a pure function, to differentiate."""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.forecasting.anchors import apply_anchors
from neurosym_jax.forecasting.networks import decode_scene, encode_scene
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import Scene

__all__ = ["forecast"]


def forecast(
    config: Any,
    params: Any,
    observed: ArrayLike,
    noise: ArrayLike | None = None,
    alpha: ArrayLike | None = None,
    *,
    valid: ArrayLike | None = None,
) -> Array:
    """k futures of one scene as a pure function, to differentiate by all but `config` and `valid`.

    It computes what `predict` does in the same coordinates, but nothing is padded, checked or moved
    to the host. Reverse mode only: the gradient of pooling is written by hand (`models.pool_net`).
    Symbols with a hard threshold have a gradient of zero by positions; the weightings `soft` and
    `quantised` (straight through) have another.

    Args:
        config: `Model.config` of a generator or of anchors.
        params: `Model.params`; those of a weighting, such as thresholds, are `params["weighting"]`.
        observed: [N, obs_len, 2] metres. Map coordinates lose precision in float32 before this
            function sees them: subtract an origin, or use x64.
        noise: [k, noise_dim], or [k, N, noise_dim] where it is per agent; anchors take none and
            forecast all their samples.
        alpha: [N, N, obs_len], of which anchors use the last step; default: the model's own.
        valid: [N] bool, False for padding; default: no padding.

    Returns:
        [k, N, pred_len, 2] metres, in the frame of `observed`.
    """
    observed = jnp.asarray(observed)
    last = observed[:, -1]
    present = jnp.ones(len(last), bool) if valid is None else jnp.asarray(valid)
    # For precision only: a network sees differences of positions.
    origin = jax.lax.stop_gradient(present @ last / jnp.maximum(present.sum(), 1))
    steps = jnp.diff(observed, axis=1, prepend=observed[:, :1])
    scene = Scene(observed - origin, steps, present, identity=jnp.zeros(2, jnp.uint32), origin=None)
    given = None if alpha is None else jnp.asarray(alpha)
    if isinstance(config, GeneratorConfig):
        context = encode_scene(config, params, scene, given)
        return decode_scene(config, params, context, scene, jnp.asarray(noise)) + origin
    return apply_anchors(config, params, jnp.asarray(scene.observed), present, given)[0] + origin
