"""The table of weightings, with the built-in ones.

What they are is said in `weighting`, which also sees to it that alpha is 1 for an agent with itself
and 0 in padding.
"""

from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jax.typing import ArrayLike

from neurosym_jax.registry import Registry
from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import other_pairs
from neurosym_jax.symbolic.soft import soft_alpha, soft_qtc_c1
from neurosym_jax.symbolic.states import encode_state
from neurosym_jax.symbolic.transitions import (
    count_transitions,
    pair_codes,
    pair_states,
    transition_parameters,
)
from neurosym_jax.symbolic.weighting_kind import Parameters, Scenes, WeightingKind

if TYPE_CHECKING:
    from neurosym_jax.symbolic.weighting_config import WeightingConfig

__all__ = ["WEIGHTINGS", "alpha_from_states", "table_of", "to_the_wrong_pairs"]


def table_of(config: "WeightingConfig") -> np.ndarray:
    """[81] float64: the weight of each QTC_C1 state, by its code, before anything is learnt."""
    if "cnd_shipped" in (config.kind, config.table):
        table = alpha_table("c1", rule="continuity", include_self=True)
    else:
        table = alpha_table("c1", rule="dominance")
    return table if config.decimals is None else np.round(table, config.decimals)


def alpha_from_states(states: ArrayLike, table: ArrayLike) -> Array:
    """Weights [...] of QTC_C1 states [..., 4] in {-1, 0, 1}, from a table [81] by state code."""
    return jnp.asarray(table).at[encode_state(states)].get(mode="clip")


def _by_state(
    config: "WeightingConfig", parameters: Parameters, positions: Array, valid: ArrayLike | None
) -> Array:
    """`cnd`, `cnd_shipped`, `learned`, `quantised`: a table, by the states observed."""
    table = jnp.asarray(parameters.get("table", table_of(config)), positions.dtype)
    observed = alpha_from_states(pair_states(config, positions, valid), table)
    return _after_first(observed, parameters)


def _quantised(
    config: "WeightingConfig", parameters: Parameters, positions: Array, valid: ArrayLike | None
) -> Array:
    return (_soft if config.learned else _by_state)(config, parameters, positions, valid)


def _shuffled(
    config: "WeightingConfig", parameters: Parameters, positions: Array, valid: ArrayLike | None
) -> Array:
    observed = _by_state(config, parameters, positions, valid)[..., 1:]
    return _after_first(to_the_wrong_pairs(observed, positions[:, -1], valid), parameters)


def _after_first(observed: Array, parameters: Parameters) -> Array:
    """[N, N, T] from `observed [N, N, T-1]`: at the first step no state has been observed."""
    unobserved = jnp.asarray(parameters.get("unobserved", 0.0), observed.dtype)
    first = jnp.broadcast_to(unobserved, (*observed.shape[:2], 1))
    return jnp.concatenate([first, observed], axis=-1)


def _constant(value: float) -> WeightingKind:
    def weigh(config, parameters, positions, valid):
        return jnp.full((len(positions), *positions.shape[:2]), value, positions.dtype)

    return WeightingKind(weigh)


def _soft(
    config: "WeightingConfig", parameters: Parameters, positions: Array, valid: ArrayLike | None
) -> Array:
    """[N, N, T] by soft symbols, or by hard ones with soft gradients."""
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
    return _after_first(soft_alpha(probabilities, parameters.get("table", fixed)), parameters)


def _by_transitions(
    config: "WeightingConfig", parameters: Parameters, positions: Array, valid: ArrayLike | None
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


def to_the_wrong_pairs(observed: Array, last: Array, valid: ArrayLike | None) -> Array:
    """`observed [N, N, T-1]` of `shuffled`; nearness is that of the positions `last [N, 2]`.

    Each agent's weights are the same as before, in another order, which follows from the scene
    alone: neither rotation nor padding nor the order of the agents changes it.
    """
    count = len(last)
    others = other_pairs(valid, count)
    apart = jnp.square(last[:, None] - last[None]).sum(axis=-1)
    by_distance = jnp.argsort(jnp.where(others, apart, jnp.inf), axis=1)
    rank = jnp.argsort(by_distance, axis=1)
    of_others = jnp.maximum(others.sum(axis=1, keepdims=True), 1)
    source = jnp.take_along_axis(by_distance, (rank - 1) % of_others, axis=1)
    return jnp.take_along_axis(observed[..., ::-1], source[..., None], axis=1)


def _start_learned(config: "WeightingConfig", scenes: Scenes | None) -> Parameters:
    return {"table": table_of(config), "unobserved": 0.0} if config.learned else {}


def _start_quantised(config: "WeightingConfig", scenes: Scenes | None) -> Parameters:
    factor = config.quantisation_factor or 0.0
    return {"log_quantisation_factor": np.log(factor)} if config.learned else {}


def _start_soft(config: "WeightingConfig", scenes: Scenes | None) -> Parameters:
    if not config.learned:
        return {}
    return {
        **_start_quantised(config, scenes),
        "log_temperature": np.log(config.temperature),
        **_start_learned(config, scenes),
    }


def _start_transition(config: "WeightingConfig", scenes: Scenes | None) -> Parameters:
    counts = np.zeros((81, 81)) if scenes is None else count_transitions(config, scenes)
    return transition_parameters(counts)


WEIGHTINGS: Registry[WeightingKind] = Registry(
    "weighting",
    {
        "cnd": WeightingKind(_by_state, table=table_of),
        "cnd_shipped": WeightingKind(_by_state, table=table_of),
        "quantised": WeightingKind(
            _quantised,
            _start_quantised,
            table_of,
            learnable=True,
            learns_quantisation=True,
            quantisation_factor=0.05,
        ),
        "soft": WeightingKind(
            _soft,
            _start_soft,
            table_of,
            learnable=True,
            learns_quantisation=True,
            quantisation_factor=0.05,
        ),
        "learned": WeightingKind(_by_state, _start_learned, table_of, learnable=True, learned=True),
        "transition": WeightingKind(_by_transitions, _start_transition, learnable=True),
        "ones": _constant(1.0),
        "zeros": _constant(0.0),
        "shuffled": WeightingKind(_shuffled, table=table_of, quantisation_factor=0.05),
    },
)
