"""States of the Qualitative Trajectory Calculus: codes, text, converse and chains.

A state is a vector of m symbols in {-1, 0, 1} (int8), or `ABSENT` where QTC_BC drops a symbol. A
chain is a sequence of states [T, m] with a length beside it, because compiled programs have static
shapes: rows beyond the length are 0 and mean nothing.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError

__all__ = ["ABSENT", "collapse", "converse", "encode_state", "format_state", "validate"]

ABSENT = np.int8(2)
"""A symbol that the state does not have: q3 and q4 of a QTC_BC state of a pair far apart."""

_CHARACTERS = {-1: "-", 0: "0", 1: "+"}


def encode_state(states: ArrayLike) -> Array:
    """[...] int32 codes of states [..., m] in {-1, 0, 1}: base 3 of q + 1, q1 most significant."""
    states = jnp.asarray(states)
    code = jnp.zeros(states.shape[:-1], jnp.int32)
    for symbol in range(states.shape[-1]):
        code = 3 * code + states[..., symbol] + 1
    return code


def format_state(state: ArrayLike, separator: str = " ") -> str:
    """One state [m] as text, `"- 0 + -"`, without absent symbols. QSRlib separates by `,`.

    Raises:
        InputError: for a number that is no symbol.
    """
    symbols = [int(symbol) for symbol in np.asarray(state) if symbol != ABSENT]
    unknown = [symbol for symbol in symbols if symbol not in _CHARACTERS]
    if unknown:
        raise InputError(f"{unknown[0]} is not a QTC symbol: a state has -1, 0 and 1")
    return separator.join(_CHARACTERS[symbol] for symbol in symbols)


def converse(states: ArrayLike) -> Array:
    """States of the pair (l, k) from those of (k, l): [..., m], m from 2 to 6.

    q1 and q2 change places, and q3 and q4 where there are any (m > 3); the symbols that compare the
    two agents' speeds and angles (the third of QTC_B2, the fifth and sixth of QTC_C2) change sign.
    """
    states = jnp.asarray(states)
    order = (1, 0) if states.shape[-1] < 4 else (1, 0, 3, 2)
    swapped = states[..., jnp.array(order)]
    return jnp.concatenate([swapped, -states[..., len(order) :]], axis=-1)


def collapse(states: ArrayLike, length: ArrayLike | None = None) -> tuple[Array, Array]:
    """A chain without repetitions of the state before; absence is a value like others.

    Args:
        states: [T, m] int8.
        length: [] rows of `states` that count; None for all T.

    Returns:
        The chain [T, m] and its length [] int32.
    """
    states = jnp.asarray(states)
    counts = _within(states, length)
    changed = jnp.any(states[1:] != states[:-1], axis=1)
    keep = counts & jnp.concatenate([jnp.ones_like(counts[:1]), changed])
    at = jnp.cumsum(keep) - 1
    return _place(len(states), (at, keep, states)), keep.sum(dtype=jnp.int32)


def validate(states: ArrayLike, length: ArrayLike | None = None) -> tuple[Array, Array]:
    """A chain of QTC_B, QTC_C1 or QTC_BC1 made continuous, as QSRlib does after it collapses.

    Wherever a symbol skips 0, at most one state is inserted (Delafontaine, 2011): symbols that jump
    between - and + pass through 0; if a symbol has to leave its value for 0, all symbols that leave
    0 wait. Symbols that only one of the two states has are not looked at.

    Args:
        states: [T, m] int8, T >= 1.
        length: [] rows of `states` that count; None for all T.

    Returns:
        The chain [2T - 1, m] and its length [] int32.
    """
    states = jnp.asarray(states)
    before, after = states[:-1], states[1:]
    both = (before != ABSENT) & (after != ABSENT)
    p, c = jnp.where(both, before, 0), jnp.where(both, after, 0)
    middle = jnp.where(p * c == -1, 0, c)
    leaving = ((p != 0) & (middle == 0)).any(axis=-1, keepdims=True)
    middle = jnp.where(both, jnp.where(leaving & (p == 0), 0, middle), after)
    counts = _within(states, length)
    missing = (middle != after).any(axis=1) & counts[1:]
    at = jnp.cumsum(jnp.concatenate([jnp.zeros(1, int), 1 + missing]))
    chain = _place(2 * len(states) - 1, (at, counts, states), (at[1:] - 1, missing, middle))
    return chain, counts.sum(dtype=jnp.int32) + missing.sum(dtype=jnp.int32)


def _within(states: Array, length: ArrayLike | None) -> Array:
    """[T] bool: the rows of `states [T, m]` that count."""
    return jnp.arange(len(states)) < (len(states) if length is None else length)


def _place(size: int, *parts: tuple[Array, Array, Array]) -> Array:
    """[size, m] zeros in which, for each (at, keep, rows), the rows to keep are put at `at`."""
    chain = jnp.zeros((size, parts[0][2].shape[1]), parts[0][2].dtype)
    for at, keep, rows in parts:
        chain = chain.at[jnp.where(keep, at, size)].set(rows, mode="drop")
    return chain
