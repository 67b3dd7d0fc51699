"""States of the Qualitative Trajectory Calculus: codes, text, converse, collapse and validation.

A state is a vector of m symbols in {-1, 0, 1} (int8), or `ABSENT` where QTC_BC drops a symbol; a
chain is a sequence of states [T, m]. This is the algebra on symbols, not how they are observed
(see `qtc`) nor which may follow which in theory (`cnd`).

Chains are of fixed size with a length beside them, because compiled programs have static shapes:
rows beyond the length are 0 and mean nothing.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError

__all__ = [
    "ABSENT",
    "between",
    "collapse",
    "converse",
    "decode_state",
    "encode_state",
    "format_state",
    "insert",
    "validate",
    "within",
]

ABSENT = np.int8(2)
"""A symbol that the state does not have: q3 and q4 of a QTC_BC state of a pair far apart."""

_CHARACTERS = {-1: "-", 0: "0", 1: "+"}


def encode_state(states: ArrayLike) -> Array:
    """[..., m] symbols in {-1, 0, 1} to [...] int32 codes: base 3 of q + 1, q1 most significant."""
    states = jnp.asarray(states)
    code = jnp.zeros(states.shape[:-1], jnp.int32)
    for symbol in range(states.shape[-1]):
        code = 3 * code + states[..., symbol] + 1
    return code


def decode_state(codes: ArrayLike, symbols: int = 4) -> Array:
    """[...] codes to [..., symbols] int8 in {-1, 0, 1}, the inverse of `encode_state`."""
    codes = jnp.asarray(codes)
    digits = [codes // 3**place % 3 - 1 for place in reversed(range(symbols))]
    return jnp.stack(digits, axis=-1).astype(jnp.int8)


def format_state(state: ArrayLike, separator: str = " ") -> str:
    """One state [m] as text, `"- 0 + -"`; absent symbols are left out. QSRlib separates by `,`.

    Raises:
        InputError: for what is no symbol.
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
    """A chain without repetitions of the state before; absence of a symbol is a value like others.

    Args:
        states: [T, m] int8.
        length: [] rows of `states` that count; None for all T.

    Returns:
        The chain [T, m] and its length [] int32.
    """
    states = jnp.asarray(states)
    counts = within(states, length)
    changed = jnp.any(states[1:] != states[:-1], axis=1)
    keep = counts & jnp.concatenate([jnp.ones_like(counts[:1]), changed])
    at = jnp.cumsum(keep) - 1
    return _place(len(states), states, [(at, keep, states)]), keep.sum(dtype=jnp.int32)


def validate(states: ArrayLike, length: ArrayLike | None = None) -> tuple[Array, Array]:
    """A chain made continuous: at most one state inserted wherever a symbol skips 0.

    As QSRlib inserts it (Delafontaine 2011), which looks at the chain given, not the one made:
    symbols that jump between - and + pass through 0; if a symbol has to leave its value for 0, all
    symbols that leave 0 wait. Only symbols present in both states are looked at. QSRlib collapses
    first and validates then.

    Args:
        states: [T, m] int8, T >= 1.
        length: [] rows of `states` that count; None for all T.

    Returns:
        The chain [2T - 1, m] and its length [] int32.
    """
    states = jnp.asarray(states)
    middle = between(states[:-1], states[1:])
    missing = jnp.any(middle != states[1:], axis=1)
    return insert(states, within(states, length), middle[:, None], missing[:, None])


def between(before: Any, after: Any, library: Any = jnp) -> Any:
    """[..., m] what `validate` puts between states [..., m]; `after` where nothing is missing.

    `library` is `numpy` for arrays of numpy.
    """
    where = library.where
    both = (before != ABSENT) & (after != ABSENT)
    p, c = where(both, before, 0), where(both, after, 0)
    middle = where(p * c == -1, 0, c)
    leaving = ((p != 0) & (middle == 0)).any(axis=-1, keepdims=True)
    middle = where(leaving & (p == 0), 0, middle)
    return where(both, middle, after)


def insert(states: Array, counts: Array, middle: Array, missing: Array) -> tuple[Array, Array]:
    """A chain with states put in.

    Args:
        states: [T, m].
        counts: [T] bool: the rows that count, the first of them.
        middle: [T-1, D, m] states between every two rows.
        missing: [T-1, D] which of them to put in.

    Returns:
        The chain [T + (T-1) D, m] and its length [] int32.
    """
    missing = missing & counts[1:, None]
    at = jnp.cumsum(jnp.concatenate([jnp.zeros(1, int), 1 + missing.sum(axis=1)]))
    places = at[:-1, None] + jnp.cumsum(missing, axis=1)
    symbols = states.shape[1]
    chain = _place(
        len(states) + missing.size,
        states,
        [(at, counts, states), (places.ravel(), missing.ravel(), middle.reshape(-1, symbols))],
    )
    return chain, counts.sum(dtype=jnp.int32) + missing.sum(dtype=jnp.int32)


def within(states: Array, length: ArrayLike | None) -> Array:
    """[T] bool: the rows that count."""
    return jnp.arange(len(states)) < (len(states) if length is None else length)


def _place(size: int, like: Array, parts: list[tuple[Array, Array, Array]]) -> Array:
    """[size, m] zeros with, for each (at, keep, rows), the kept rows put at `at`."""
    chain = jnp.zeros((size, like.shape[1]), like.dtype)
    for at, keep, rows in parts:
        chain = chain.at[jnp.where(keep, at, size)].set(rows, mode="drop")
    return chain
