"""Weights of the interaction of two agents: `(positions [N, T, 2], valid [N]) -> alpha [N, N, T]`.

NeuroSyM (Mghames et al., 2023) multiplies what the pooling knows of a pair by alpha, looked up by
the QTC_C1 state that the pair was last observed in. Which weighting is a value, `WeightingConfig`;
`scene_alpha` is the one place where a scene's alpha is computed, `make_weighting` the same as a
function of one's own to call. The kinds:

- `cnd`: 1 / N_Tr, N_Tr the neighbours of the state in the conceptual neighbourhood diagram of the
  theory. What the papers describe.
- `cnd_shipped`: the authors' own table, 1 / (2^nonzero 3^zero), which counts neighbours by
  continuity alone and staying as one of them; 4 decimals give it as they printed it.
- `quantised`: `cnd` of symbols that are 0 below 5 cm a step.
- `learned`: 81 free weights, one a state, and one for the first step; they start at the table.
- `ones`: nothing is weighted, at any step, observed or not: the neural part alone.
- `zeros`: no weight for anyone but oneself. What the released training was fed with the authors'
  table, because its reader took the first character of a label such as `0.0625`.

This is not the pooling that uses the weights (see `models.symbolic_pooling`).
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import pair_mask, pairwise_qtc_c1
from neurosym_jax.symbolic.states import encode_state
from neurosym_jax.symbolic.weighting_config import KINDS, WeightingConfig, own_weighting

__all__ = [
    "Weighting",
    "alpha_from_states",
    "initial_parameters",
    "make_weighting",
    "scene_alpha",
    "table_of",
]

Weighting = Callable[..., Array]
"""`(positions [N, T, 2] metres, valid [N] or None) -> alpha [N, N, T]`."""

Parameters = Mapping[str, Any]
"""What a weighting learns or estimates, by name; it lies in `params["weighting"]` of a model."""


def make_weighting(
    config: WeightingConfig | str = "cnd", parameters: Parameters | None = None
) -> Weighting:
    """The weighting as a function of a scene; `config` may be a kind by name.

    Raises:
        InputError: for an unknown kind.
    """
    chosen = WeightingConfig(config) if isinstance(config, str) else config
    given = initial_parameters(chosen) if parameters is None else parameters

    def weigh(positions: ArrayLike, valid: ArrayLike | None = None) -> Array:
        return scene_alpha(chosen, given, positions, valid)

    return weigh


def initial_parameters(config: WeightingConfig) -> dict[str, Any]:
    """What the weighting has to learn, where it starts, float32; empty where there is nothing."""
    if config.kind not in KINDS:
        start = own_weighting(config.kind).start
    elif config.kind == "learned" and config.learned:
        start = {"table": table_of(config), "unobserved": 0.0}
    else:
        start = {}
    return {name: np.asarray(value, np.float32) for name, value in start.items()}


def scene_alpha(
    config: WeightingConfig,
    parameters: Parameters,
    positions: ArrayLike,
    valid: ArrayLike | None = None,
) -> Array:
    """Weights of the interactions of every ordered pair of one scene.

    The state observed from t-1 to t weights the interaction at t, so t = 0 has no state and weighs
    0 (with `ones`: 1). An agent with itself weighs 1 at every step, whatever the weighting. Pairs
    with an agent that is not valid weigh 0. So does everything in a scene of exactly one valid
    agent, who interacts with nobody: this is told from `valid`, not from the padded size.

    Args:
        config: the weighting.
        parameters: as `initial_parameters(config)`, or what they were learnt to be.
        positions: [N, T, 2] metres, T >= 1.
        valid: [N] bool, False for padding; None for no padding.

    Returns:
        [N, N, T] weights in the floating type of `positions`; (i, j) is how much j matters to i.
    """
    positions = jnp.asarray(positions, jnp.result_type(positions, 0.0))
    count = len(positions)
    if config.kind in KINDS:
        alpha = _built_in(config, parameters, positions, valid)
    else:
        present = jnp.ones(count, bool) if valid is None else jnp.asarray(valid)
        alpha = own_weighting(config.kind).weigh(positions, present, **parameters)
    alpha = jnp.where(jnp.eye(count, dtype=bool)[..., None], 1, alpha.astype(positions.dtype))
    pairs = pair_mask(valid, count)
    return jnp.where((pairs & (pairs.sum() != 1))[..., None], alpha, 0)


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


def _built_in(
    config: WeightingConfig, parameters: Parameters, positions: Array, valid: ArrayLike | None
) -> Array:
    """[N, N, T] of the kinds that are a table, before self, padding and solitude are seen to."""
    states = pairwise_qtc_c1(
        positions,
        valid,
        quantisation_factor=config.quantisation_factor or 0.0,
        convention=config.convention,
        side_quantisation_factor=config.side_quantisation_factor,
    )
    table = parameters.get("table", table_of(config))
    unobserved = parameters.get("unobserved", float(config.kind == "ones"))
    observed = alpha_from_states(states, jnp.asarray(table, positions.dtype))
    return _with_first_step(observed, unobserved)


def _with_first_step(observed: Array, unobserved: ArrayLike) -> Array:
    """[N, N, T] from the weights [N, N, T-1] of states, and of the step before any of them."""
    first = jnp.broadcast_to(jnp.asarray(unobserved, observed.dtype), (*observed.shape[:2], 1))
    return jnp.concatenate([first, observed], axis=-1)
