"""The forecast as a pure function of everything that it depends on, to be differentiated through.

It is what `predict` computes, in the same physical coordinates, without what a robot or a table
needs around it: the noise is given, nothing is padded, checked or moved to the host, so `jax.grad`,
`jax.vmap` and `jax.jit` take it as it is.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.forecasting.networks import decode_scene, encode_scene
from neurosym_jax.models.config import GeneratorConfig
from neurosym_jax.scene import Scene

__all__ = ["forecast"]


def forecast(
    config: GeneratorConfig,
    params: Any,
    observed: ArrayLike,
    noise: ArrayLike,
    alpha: ArrayLike | None = None,
    *,
    valid: ArrayLike | None = None,
) -> Array:
    """k futures of one scene; differentiable by everything but `config` and `valid`.

    Reverse mode only: the gradient of pooling is written by hand (see `models.pairs`). Symbols with
    a hard threshold have a gradient of zero by positions; the weightings `soft` and `quantised`
    (straight through) have another.

    Args:
        config: of the generator, `Model.config`.
        params: `Model.params`; what a weighting has learned, its thresholds among them, lies in
            `params["weighting"]`.
        observed: [N, obs_len, 2] metres. Coordinates of a map lose precision in float32 before
            this function sees them: subtract an origin, or use x64.
        noise: [k, noise_dim], or [k, N, noise_dim] where the config says per agent ("ped").
        alpha: [N, N, obs_len] weight of each pair's step; default: the model's own weighting.
        valid: [N] bool, False for padding; default: no padding.

    Returns:
        [k, N, pred_len, 2] metres, in the frame of `observed`.
    """
    observed, noise = jnp.asarray(observed), jnp.asarray(noise)
    last = observed[:, -1]
    present = jnp.ones(len(last), bool) if valid is None else jnp.asarray(valid)
    # For precision only: a network sees differences of positions.
    origin = jax.lax.stop_gradient(present @ last / jnp.maximum(present.sum(), 1))
    steps = jnp.diff(observed, axis=1, prepend=observed[:, :1])
    scene = Scene(observed - origin, steps, present, identity=jnp.zeros(2, jnp.uint32), origin=None)
    given = None if alpha is None else jnp.asarray(alpha)
    context = encode_scene(config, params, scene, given)
    return decode_scene(config, params, context, scene, noise) + origin
