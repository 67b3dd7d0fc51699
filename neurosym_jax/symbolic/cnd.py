"""Conceptual neighbourhood diagrams: which QTC states can follow each other when points move.

Two states are neighbours by the `dominance` rule of the theory (Van de Weghe and De Maeyer,
"Conceptual neighbourhood diagrams for representing moving objects", 2005) if symbols change only
between 0 and another value (continuity), and those that change all arrive at 0 or all leave it: a
value other than 0 holds over an interval, 0 may hold at an instant, so no symbol can leave 0 at the
very instant at which another one arrives there. The `continuity` rule, which NeuroSyM's released
table uses, drops the second condition: 1160 edges of QTC_C1 instead of 544. A QTC_BC state of a
pair apart and one of a pair near are compared by the symbols that both have.

Tables are read-only numpy arrays, made once; their rows are those of `CALCULI[calculus].states`.
These are diagrams of the theory, not frequencies of transitions in data (`transition`).
"""

import functools
from typing import Literal, get_args

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI, Calculus, state_index
from neurosym_jax.symbolic.states import ABSENT, encode_state, place_rows, within

__all__ = ["Rule", "adjacency", "alpha_from_states", "alpha_table", "validate"]

Rule = Literal["dominance", "continuity"]


def adjacency(calculus: str = "c1", rule: Rule = "dominance") -> np.ndarray:
    """[S, S] bool, symmetric, read-only: which states are neighbours; none is its own.

    Raises:
        InputError: for an unknown calculus or rule.
    """
    return _adjacency(CALCULI[calculus], rule)


@functools.cache
def _adjacency(calculus: Calculus, rule: Rule) -> np.ndarray:
    if rule not in get_args(Rule):
        raise InputError(f"unknown rule {rule!r}: there are {', '.join(get_args(Rule))}")
    a, b = calculus.states[:, None], calculus.states[None]
    # A symbol that only one of them has is not compared; staying is no transition.
    same = (a == b) | (a == ABSENT) | (b == ABSENT)
    table = ~(a == b).all(axis=-1) & (same | (a * b == 0)).all(axis=-1)
    if rule == "dominance":
        table &= (same | (b == 0)).all(axis=-1) | (same | (a == 0)).all(axis=-1)
    return _frozen(table)


def alpha_table(
    calculus: str = "c1", rule: Rule = "dominance", include_self: bool = False
) -> np.ndarray:
    """[S] float64, read-only: 1 / N_Tr of every state, N_Tr its number of neighbours.

    Mghames et al., "A Neuro-Symbolic Approach for Enhanced Human Motion Prediction" (2023): the
    more transitions a state has, the less it says. QTC_C1 states with 0, 1, 2, 3 or 4 zeros weigh
    1/15, 1/9, 1/11, 1/27, 1/80. The authors' table is `rule="continuity"` with `include_self=True`,
    which counts staying in the state as a transition: 1 / (2^nonzero 3^zero).

    Raises:
        InputError: for an unknown calculus or rule.
    """
    return _alpha_table(CALCULI[calculus], rule, include_self)


@functools.cache
def _alpha_table(calculus: Calculus, rule: Rule, include_self: bool) -> np.ndarray:
    return _frozen(1 / (_adjacency(calculus, rule).sum(axis=1) + include_self))


def alpha_from_states(states: ArrayLike, table: ArrayLike) -> Array:
    """[...] weights of QTC_C1 states [..., 4] in {-1, 0, 1}, from a table [81] by state code."""
    return jnp.asarray(table).at[encode_state(states)].get(mode="clip")


def validate(
    chain: ArrayLike, length: ArrayLike | None = None, calculus: str = "c1"
) -> tuple[Array, Array]:
    """A chain made continuous: wherever it jumps, states of a way along the diagram are inserted.

    The way is one on which symbols change least, and of those one of fewest states. In QTC_B,
    QTC_C1 and QTC_BC1 this inserts what QSRlib inserts (Delafontaine, 2011), at most one state;
    QSRlib collapses first and validates then. In QTC_C2 not every combination of symbols is a
    state, and a way can take more.

    Args:
        chain: [T, m] int8, T >= 1, of states of the calculus.
        length: [] rows of `chain` that count; None for all T.
        calculus: its name.

    Returns:
        The chain [T + (T-1) D, m] with room for the D states that can be missing between two, and
        its length [] int32.

    Raises:
        InputError: for an unknown calculus.
    """
    value, chain = CALCULI[calculus], jnp.asarray(chain)
    rows, counts = state_index(calculus, chain), within(chain, length)
    ways = jnp.asarray(_ways(value))[rows[:-1], rows[1:]]
    missing = (ways >= 0) & counts[1:, None]
    # Each row comes after those before it and the states inserted between them.
    at = jnp.cumsum(jnp.concatenate([jnp.zeros(1, int), 1 + missing.sum(axis=1)]))
    places = at[:-1, None] + jnp.cumsum(missing, axis=1)
    inserted = jnp.asarray(value.states)[ways].reshape(-1, chain.shape[1])
    parts = [(at, counts, chain), (places.ravel(), missing.ravel(), inserted)]
    found = place_rows(len(chain) + missing.size, parts)
    return found, counts.sum(dtype=jnp.int32) + missing.sum(dtype=jnp.int32)


@functools.cache
def _ways(calculus: Calculus) -> np.ndarray:
    """[S, S, D] int16 rows of the states that `validate` inserts between two, then -1."""
    from scipy.sparse.csgraph import shortest_path

    rows, edges = calculus.states.astype(int), _adjacency(calculus, "dominance")
    count = np.arange(len(rows))
    a, b = rows[:, None], rows[None]
    # A pair does not part and meet again on the way: that is dearer than any change of symbols.
    across = (a == ABSENT) != (b == ABSENT)
    change = np.where(across, 2 * a.shape[-1], abs(a - b)).sum(axis=-1)
    # Exact in binary; no number of states on the way outweighs a change.
    cost = np.where(edges, change + 1 / 64, 0)
    total, before = shortest_path(cost, directed=False, return_predecessors=True)
    usual = _row_of(calculus, _qsrlib_between(a, b))
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


def _qsrlib_between(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """[..., m] what QSRlib inserts between states [..., m]; `after` where nothing is missing.

    Symbols that jump between - and + pass through 0; if a symbol has to leave its value for 0, all
    symbols that leave 0 wait. Symbols that only one of the states has are not looked at.
    """
    both = (before != ABSENT) & (after != ABSENT)
    p, c = np.where(both, before, 0), np.where(both, after, 0)
    middle = np.where(p * c == -1, 0, c)
    leaving = ((p != 0) & (middle == 0)).any(axis=-1, keepdims=True)
    return np.where(both, np.where(leaving & (p == 0), 0, middle), after)


def _row_of(calculus: Calculus, found: np.ndarray) -> np.ndarray:
    """[...] rows of states [..., m], -1 for none."""
    known = {tuple(state): row for row, state in enumerate(calculus.states)}
    rows = [known.get(tuple(state), -1) for state in found.reshape(-1, found.shape[-1])]
    return np.array(rows).reshape(found.shape[:-1])


def _frozen(table: np.ndarray) -> np.ndarray:
    table.flags.writeable = False
    return table
