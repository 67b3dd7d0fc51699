"""How the built-in weightings come to alpha; what they are is said in `weighting`.

Here alpha is not yet 1 for an agent with itself nor 0 in padding: `weighting.scene_alpha` sees to
that for every weighting.
"""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import pair_mask
from neurosym_jax.symbolic.soft import soft_alpha, soft_qtc_c1
from neurosym_jax.symbolic.states import encode_state
from neurosym_jax.symbolic.transitions import pair_codes, pair_states
from neurosym_jax.symbolic.weighting_config import WeightingConfig

__all__ = ["Parameters", "alpha_from_states", "built_in_alpha", "table_of"]

Parameters = Mapping[str, Any]
"""What a weighting learns or estimates, by name; it lies in `params["weighting"]` of a model."""


def table_of(config: WeightingConfig) -> np.ndarray:
    """[81] float64: the weight of each QTC_C1 state, by its code, before anything is learnt."""
    if config.kind in ("ones", "zeros"):
        return np.full(81, float(config.kind == "ones"))
    if "cnd_shipped" in (config.kind, config.table):
        table = alpha_table("c1", rule="continuity", include_self=True)
    else:
        table = alpha_table("c1", rule="dominance")
    return table if config.decimals is None else np.round(table, config.decimals)


def alpha_from_states(states: ArrayLike, table: ArrayLike) -> Array:
    """Weights [...] of QTC_C1 states [..., 4] in {-1, 0, 1}, from a table [81] by state code."""
    return jnp.asarray(table).at[encode_state(states)].get(mode="clip")


def built_in_alpha(
    config: WeightingConfig, parameters: Parameters, positions: Array, valid: ArrayLike | None
) -> Array:
    """[N, N, T] weights of `positions [N, T, 2]`; parameters as `weighting.initial_parameters`."""
    if config.kind == "transition":
        return _by_transitions(config, parameters, positions, valid)
    table = parameters.get("table", table_of(config))
    if config.kind == "soft" or (config.kind == "quantised" and config.learned):
        observed = _soft(config, parameters, positions)
    else:
        states = pair_states(config, positions, valid)
        observed = alpha_from_states(states, jnp.asarray(table, positions.dtype))
    if config.kind == "shuffled":
        observed = _to_the_wrong_pairs(observed, positions[:, -1], valid)
    unobserved = parameters.get("unobserved", float(config.kind == "ones"))
    first = jnp.broadcast_to(jnp.asarray(unobserved, observed.dtype), (*observed.shape[:2], 1))
    return jnp.concatenate([first, observed], axis=-1)


def _soft(config: WeightingConfig, parameters: Parameters, positions: Array) -> Array:
    """[N, N, T-1] by soft symbols, or by hard ones with soft gradients."""
    factor, temperature = config.quantisation_factor or 0.0, config.temperature
    if "log_quantisation_factor" in parameters:
        factor = jnp.exp(parameters["log_quantisation_factor"])
    if "log_temperature" in parameters:
        temperature = jnp.exp(parameters["log_temperature"])
    probabilities = soft_qtc_c1(
        positions[:, None],
        positions[None],
        temperature=temperature,
        quantisation_factor=factor,
        convention=config.convention,
        side_quantisation_factor=config.side_quantisation_factor,
        straight_through=config.kind == "quantised",
    )
    fixed = config.table if config.decimals is None else table_of(config)
    return soft_alpha(probabilities, parameters.get("table", fixed))


def _by_transitions(
    config: WeightingConfig, parameters: Parameters, positions: Array, valid: ArrayLike | None
) -> Array:
    """[N, N, T]: 0, then P(q_1), P(q_2 | q_1) and so on."""
    given = {name: jnp.asarray(value, positions.dtype) for name, value in parameters.items()}
    if not config.learned:
        given = lax.stop_gradient(given)
    codes = pair_codes(config, positions, valid)
    first = given["state"].at[codes[..., :1]].get(mode="clip")
    later = given["transition"].at[codes[..., :-1], codes[..., 1:]].get(mode="clip")
    alpha = jnp.concatenate([jnp.zeros_like(first), first, later], axis=-1)
    return alpha[..., : positions.shape[1]]  # A single step has neither.


def _to_the_wrong_pairs(observed: Array, last: Array, valid: ArrayLike | None) -> Array:
    """`observed [N, N, T-1]` of `shuffled`; nearness is that of the positions `last [N, 2]`.

    Each agent's weights are the same as before, in another order, which follows from the scene
    alone: neither rotation nor padding nor the order of the agents changes it.
    """
    count = len(last)
    others = pair_mask(valid, count) & ~jnp.eye(count, dtype=bool)
    apart = jnp.square(last[:, None] - last[None]).sum(axis=-1)
    by_distance = jnp.argsort(jnp.where(others, apart, jnp.inf), axis=1)
    rank = jnp.argsort(by_distance, axis=1)
    of_others = jnp.maximum(others.sum(axis=1, keepdims=True), 1)
    source = jnp.take_along_axis(by_distance, (rank - 1) % of_others, axis=1)
    return jnp.take_along_axis(observed[..., ::-1], source[..., None], axis=1)
