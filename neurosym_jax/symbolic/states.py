"""States of the Qualitative Trajectory Calculus: codes, text, and chains as QSRlib makes them.

A state is a vector of m symbols in {-1, 0, 1} (int8), or `ABSENT` where QTC_BC drops a symbol.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError

__all__ = ["ABSENT", "collapse", "encode_state", "format_state", "validate"]

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


def collapse(states: ArrayLike) -> np.ndarray:
    """The chain `states [T, m]` without repetitions of the state before; absence is a value."""
    states = np.asarray(states)
    return states[np.append(True, (states[1:] != states[:-1]).any(axis=1))[: len(states)]]


def validate(states: ArrayLike) -> np.ndarray:
    """A chain `[T, m]` of QTC_B, QTC_C1 or QTC_BC1 made continuous, as QSRlib does.

    Wherever a symbol skips 0, at most one state is inserted (Delafontaine, 2011): symbols that jump
    between - and + pass through 0; if a symbol has to leave its value for 0, all symbols that leave
    0 wait. Symbols that only one of the two states has are not compared.
    """
    states = np.asarray(states)
    before, after = states[:-1], states[1:]
    both = (before != ABSENT) & (after != ABSENT)
    p, c = np.where(both, before, 0), np.where(both, after, 0)
    middle = np.where(p * c == -1, 0, c)
    leaving = ((p != 0) & (middle == 0)).any(axis=1, keepdims=True)
    middle = np.where(both, np.where(leaving & (p == 0), 0, middle), after).astype(states.dtype)
    at = np.flatnonzero((middle != after).any(axis=1))
    return np.insert(states, at + 1, middle[at], axis=0)
