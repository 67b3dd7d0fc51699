"""The QTC family: what a calculus is, and the states of pairs in it.

A calculus is a value: which symbols it has, how they are observed, which states there are. The
package's are in `built_in_calculi`, `register_calculus` adds one; its conceptual neighbourhood
diagram and its chains (`cnd`) follow from its states. Observation is pure and works under `jit` and
`vmap`.
"""

import functools
import itertools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.built_in_calculi import CALCULI
from neurosym_jax.symbolic.calculus import Calculus, Thresholds
from neurosym_jax.symbolic.qtc import Convention, every_pair
from neurosym_jax.symbolic.states import ABSENT

__all__ = [
    "CALCULI",
    "Calculus",
    "Thresholds",
    "all_states",
    "observe",
    "observe_pairs",
    "register_calculus",
    "state_index",
]


def register_calculus(name: str, calculus: Calculus, *, replace: bool = False) -> None:
    """Add a calculus, which then has its states, diagram and chains like the others.

    Raises:
        InputError: for a name that is taken or cannot be one.
    """
    CALCULI.register(name, calculus, replace=replace)


def observe(
    calculus: str,
    k: ArrayLike,
    l: ArrayLike,  # noqa: E741 (the calculus calls the two points k and l)
    *,
    convention: Convention = "distance",
    **thresholds: ArrayLike | None,
) -> Array:
    """States of the pair (k, l).

    Args:
        calculus: its name.
        k: [..., T, 2] positions in metres.
        l: [..., T, 2] positions in metres; leading axes broadcast against those of `k`.
        convention: of q1 to q4, see `qtc`.
        **thresholds: see `Thresholds`.

    Returns:
        [..., T-1, m] int8 in {-1, 0, 1}, or `ABSENT`.

    Raises:
        InputError: for an unknown calculus, convention or threshold.
    """
    if unknown := thresholds.keys() - set(Thresholds._fields):
        known = ", ".join(Thresholds._fields)
        raise InputError(f"unknown threshold {min(unknown)!r}: there are {known}")
    given: Any = thresholds
    return CALCULI[calculus].observe(k, l, convention, Thresholds(**given))


def observe_pairs(
    calculus: str,
    positions: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    convention: Convention = "distance",
    **thresholds: ArrayLike | None,
) -> Array:
    """States of every ordered pair of one scene.

    Args:
        calculus: its name.
        positions: [N, T, 2] metres.
        valid: [N] bool, False for padding; None for no padding.
        convention: see `observe`.
        **thresholds: see `observe`.

    Returns:
        [N, N, T-1, m] int8; entry (i, j) has agent i as k and agent j as l. An agent with itself
        and pairs with an agent that is not valid are 0.

    Raises:
        InputError: as `observe`.
    """
    how = functools.partial(observe, calculus, convention=convention, **thresholds)
    return every_pair(how, positions, valid)


@functools.cache
def all_states(calculus: Calculus) -> np.ndarray:
    """[S, m] int8, read-only: the states there are, those of pairs apart first, in order."""
    symbols = len(calculus.symbols)
    every = np.array(list(itertools.product((-1, 0, 1), repeat=symbols)), np.int8)
    states = every[calculus.possible(every)]
    if calculus.optional:
        apart = np.delete(every, calculus.optional, axis=1)
        apart = np.unique(apart, axis=0)
        for place in calculus.optional:
            apart = np.insert(apart, place, ABSENT, axis=1)
        states = np.concatenate([apart, states])
    states.flags.writeable = False
    return states


def state_index(calculus: str, states: ArrayLike) -> Array:
    """[...] int32 rows of `states [..., m]` among those of the calculus; -1 for what is none."""
    value = CALCULI[calculus]
    return jnp.asarray(_rows(value)).at[_code(jnp.asarray(states))].get(mode="fill", fill_value=-1)


@functools.cache
def _rows(calculus: Calculus) -> np.ndarray:
    """[4 ** m]: the row of a state by its code, else -1."""
    rows = np.full(4 ** len(calculus.symbols), -1, np.int32)
    states = all_states(calculus).astype(np.int32)
    rows[_code(states)] = np.arange(len(states))
    return rows


def _code(states: Any) -> Any:
    """[...] numbers of states [..., m], base 4 because a symbol can be absent."""
    code = 0
    for symbol in range(states.shape[-1]):
        code = 4 * code + states[..., symbol].astype(np.int32) + 1
    return code
