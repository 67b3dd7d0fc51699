"""Conceptual neighbourhood diagrams: which QTC states can follow each other when points move.

Two states are neighbours under the `dominance` rule of the theory (Van de Weghe and De Maeyer,
"Conceptual neighbourhood diagrams for representing moving objects", 2005) if symbols change between
0 and another value only (continuity), and those that change all arrive at 0 or all leave it: a
value other than 0 holds over an interval, 0 may hold at an instant, so a symbol cannot leave 0 at
the very instant at which another one arrives there. The `continuity` rule, which NeuroSyM's
released table uses, drops the second condition: 1160 edges of QTC_C1 instead of 544. A state of
QTC_BC of a pair apart and one of a pair near are compared by the symbols that both have.

Tables are numpy arrays, made once, read-only, whose rows are those of `states(calculus)`; for `b1`,
`b2` and `c1` the row is the state's code (`states.encode_state`). These are diagrams of the theory,
not frequencies of transitions seen in data.
"""

import functools
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI, Calculus, all_states, state_index
from neurosym_jax.symbolic.states import ABSENT, between, insert, within

__all__ = ["Rule", "adjacency", "alpha_table", "states", "validate_in"]

Rule = Literal["dominance", "continuity"]


def states(calculus: str = "c1") -> np.ndarray:
    """All states of a calculus that moving points can be in, in order of their codes.

    There are 9 of `b1`, 27 of `b2` (17 on a line, `b12_1d`), 81 of `c1`, 209 of `c2` (305 with
    angles, `c2_angle`), 90 of `bc1` and 236 of `bc2`.

    Returns:
        [S, m] int8 in {-1, 0, 1} or `ABSENT`, read-only.

    Raises:
        InputError: for an unknown calculus.
    """
    return all_states(CALCULI[calculus])


def adjacency(calculus: str = "c1", rule: Rule = "dominance") -> np.ndarray:
    """[S, S] bool, symmetric, read-only: which states are neighbours; none is its own.

    Raises:
        InputError: for an unknown calculus or rule.
    """
    return _adjacency(CALCULI[calculus], rule)


@functools.cache
def _adjacency(calculus: Calculus, rule: Rule) -> np.ndarray:
    rows = all_states(calculus)
    return _frozen(_neighbours(rows[:, None], rows[None], rule))


def alpha_table(
    calculus: str = "c1", rule: Rule = "dominance", include_self: bool = False
) -> np.ndarray:
    """[S] float64, read-only: 1 / N_Tr of every state, N_Tr its number of neighbours.

    Mghames et al., "A Neuro-Symbolic Approach for Enhanced Human Motion Prediction" (2023): the
    more transitions a state has, the less it says. QTC_C1 states with 0, 1, 2, 3 or 4 zeros weigh
    1/15, 1/9, 1/11, 1/27, 1/80. The authors' table is `rule="continuity"` with `include_self=True`,
    staying in the state counted as a transition: 1 / (2^nonzero 3^zero).

    Raises:
        InputError: for an unknown calculus or rule.
    """
    return _alpha_table(CALCULI[calculus], rule, include_self)


@functools.cache
def _alpha_table(calculus: Calculus, rule: Rule, include_self: bool) -> np.ndarray:
    return _frozen(1 / (_adjacency(calculus, rule).sum(axis=1) + include_self))


def validate_in(
    calculus: str, chain: ArrayLike, length: ArrayLike | None = None
) -> tuple[Array, Array]:
    """A chain made continuous: wherever it jumps, the states of a way along the diagram are put in.

    The way is one on which symbols change least, and of those one of fewest states; where
    `states.validate` gives such a way, it is that. QTC_B and QTC_C1 are always so: at most one
    state is put in. In QTC_C2 not every combination of symbols is a state, and it can take more.

    Args:
        calculus: its name.
        chain: [T, m] int8, T >= 1, of states of the calculus.
        length: [] rows of `chain` that count; None for all T.

    Returns:
        The chain [T + (T-1) D, m] with room for the D states that can be missing between two, and
        its length [] int32.

    Raises:
        InputError: for an unknown calculus.
    """
    chain = jnp.asarray(chain)
    rows = state_index(calculus, chain)
    ways = jnp.asarray(_ways(CALCULI[calculus]))[rows[:-1], rows[1:]]
    every = jnp.asarray(states(calculus))
    return insert(chain, within(chain, length), every[ways], ways >= 0)


@functools.cache
def _ways(calculus: Calculus) -> np.ndarray:
    """[S, S, D] int16 rows of the states that `validate_in` puts between two, then -1."""
    from scipy.sparse.csgraph import shortest_path

    rows, edges = all_states(calculus).astype(int), _adjacency(calculus, "dominance")
    count = np.arange(len(rows))
    a, b = rows[:, None], rows[None]
    # Nobody parts and meets again on the way: that is dearer than any change of symbols.
    across = (a == ABSENT) != (b == ABSENT)
    change = np.where(across, 2 * a.shape[-1], abs(a - b)).sum(axis=-1)
    # Exact in binary: as much as each state costs, no number of them outweighs a change.
    cost = np.where(edges, change + 1 / 64, 0)
    total, before = shortest_path(cost, directed=False, return_predecessors=True)
    usual = _row_of(calculus, between(a, b, np))
    fits = edges[count[:, None], usual] & edges[usual, count] & (usual >= 0)
    fits &= cost[count[:, None], usual] + cost[usual, count] == total
    # The next state on the way from the one of the row to that of the column.
    following = np.where(fits, usual, before.T)
    np.fill_diagonal(following, count)
    ways, at = [], following
    while (at != count).any():
        ways.append(np.where(at == count, -1, at))
        at = following[at, count]
    return _frozen(np.stack(ways or [np.full(at.shape, -1)], axis=-1).astype(np.int16))


def _row_of(calculus: Calculus, found: np.ndarray) -> np.ndarray:
    known = {tuple(state): row for row, state in enumerate(all_states(calculus))}
    rows = [known.get(tuple(state), -1) for state in found.reshape(-1, found.shape[-1])]
    return np.array(rows).reshape(found.shape[:-1])


def _neighbours(a: np.ndarray, b: np.ndarray, rule: str) -> np.ndarray:
    """[...] whether states [..., m] are neighbours; staying is no transition."""
    if rule not in get_args(Rule):
        raise InputError(f"unknown rule {rule!r}: there are {', '.join(get_args(Rule))}")
    differ = ~(a == b).all(axis=-1)
    # A symbol that only one of them has is not compared.
    same = (a == b) | (a == ABSENT) | (b == ABSENT)
    allowed = differ & (same | (a * b == 0)).all(axis=-1)
    if rule == "continuity":
        return allowed
    arriving, leaving = (same | (b == 0)).all(axis=-1), (same | (a == 0)).all(axis=-1)
    return allowed & (arriving | leaving)


def _frozen(table: np.ndarray) -> np.ndarray:
    table.flags.writeable = False
    return table
