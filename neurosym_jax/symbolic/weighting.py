"""Weights of the interaction of two agents, from the QTC_C1 state the pair was last observed in.

NeuroSyM (Mghames et al., 2023) multiplies what the pooling knows of a pair by alpha, looked up in a
table of the 81 states. A table is an argument here, so that one may be swapped, learnt or ablated;
four have names:

- `cnd`: 1 / N_Tr, N_Tr the neighbours of the state in the conceptual neighbourhood diagram of the
  theory. What the papers describe.
- `cnd_shipped`: the authors' own table, 1 / (2^nonzero 3^zero), which counts neighbours by
  continuity alone and staying as one of them; 4 decimals give it as they printed it.
- `ones`: nothing is weighted, at any step, observed or not: the neural part alone.
- `zeros`: no weight for anyone but oneself. What the released training was fed with the authors'
  table, because its reader took the first character of a label such as `0.0625`.

This is not the pooling that uses the weights (see `models.symbolic_pooling`).
"""

from typing import Any, Literal, NamedTuple, get_args

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import Convention, pair_mask, pairwise_qtc_c1
from neurosym_jax.symbolic.states import encode_state

__all__ = ["Weighting", "WeightingName", "alpha_from_states", "named_weighting", "pair_alpha"]

WeightingName = Literal["cnd", "cnd_shipped", "ones", "zeros"]
"""The weightings that the module describes."""


class Weighting(NamedTuple):
    """What a pair of different agents weighs; a pytree, so that it can be learnt."""

    table: Any
    """[81] weight of each QTC_C1 state, by its code (`states.encode_state`)."""
    unobserved: Any = 0.0
    """[] weight at the first step, when no state has been observed yet."""


def named_weighting(name: WeightingName, decimals: int | None = None) -> Weighting:
    """The weighting of this name, float64.

    Args:
        name: see the module.
        decimals: to which the table is rounded; None for the exact table.

    Raises:
        InputError: for an unknown name.
    """
    if name == "cnd":
        weighting = Weighting(alpha_table("c1", rule="dominance"))
    elif name == "cnd_shipped":
        weighting = Weighting(alpha_table("c1", rule="continuity", include_self=True))
    elif name == "ones":
        weighting = Weighting(np.ones(81), unobserved=1.0)
    elif name == "zeros":
        weighting = Weighting(np.zeros(81))
    else:
        names = ", ".join(get_args(WeightingName))
        raise InputError(f"unknown weighting {name!r}: there are {names}")
    if decimals is None:
        return weighting
    return weighting._replace(table=np.round(weighting.table, decimals))


def alpha_from_states(states: ArrayLike, table: ArrayLike) -> Array:
    """Weights [...] of QTC_C1 states [..., 4] in {-1, 0, 1}, from a table [81] by state code."""
    return jnp.asarray(table).at[encode_state(states)].get(mode="clip")


def pair_alpha(
    positions: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    weighting: WeightingName | Weighting = "cnd",
    quantisation_factor: ArrayLike = 0.0,
    convention: Convention = "distance",
    side_quantisation_factor: ArrayLike | None = None,
) -> Array:
    """Weights of the interactions of every ordered pair of one scene.

    The state observed from t-1 to t weights the interaction at t, so t = 0 has no state and weighs
    0 (with `ones`: 1). An agent with itself weighs 1 at every step, whatever the weighting. Pairs
    with an agent that is not valid weigh 0. So does everything in a scene of exactly one valid
    agent, who interacts with nobody: this is told from `valid`, not from the padded size.

    Args:
        positions: [N, T, 2] metres, T >= 1.
        valid: [N] bool, False for padding; None for no padding.
        weighting: a name, or a `Weighting` with one's own table.
        quantisation_factor: as for `qtc.qtc_c1`.
        convention: as for `qtc.qtc_c1`.
        side_quantisation_factor: as for `qtc.qtc_c1`.

    Returns:
        [N, N, T] weights in the floating type of `positions`; (i, j) is how much j matters to i.

    Raises:
        InputError: for an unknown weighting or convention.
    """
    positions = jnp.asarray(positions)
    if isinstance(weighting, str):
        weighting = named_weighting(weighting)
    states = pairwise_qtc_c1(
        positions,
        valid,
        quantisation_factor=quantisation_factor,
        convention=convention,
        side_quantisation_factor=side_quantisation_factor,
    )
    count = len(positions)
    dtype = jnp.result_type(positions, 0.0)
    observed = alpha_from_states(states, jnp.asarray(weighting.table, dtype))
    first = jnp.full((count, count, 1), weighting.unobserved, dtype)
    alpha = jnp.concatenate([first, observed], axis=-1)
    alpha = jnp.where(jnp.eye(count, dtype=bool)[..., None], 1, alpha)
    pairs = pair_mask(valid, count)
    return jnp.where((pairs & (pairs.sum() != 1))[..., None], alpha, 0)
