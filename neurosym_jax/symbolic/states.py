"""States of qualitative calculi, chains of them, and which can follow each other.

A state is a vector of m symbols (int8), QTC's in {-1, 0, 1}. Those that QTC_BC drops
are `ABSENT`, and all of them where a position is not there. `qtc` says what symbols
mean. Tables are read-only; their rows are those of `all_states`.

Conceptual neighbourhood diagrams say which states can follow each other when points
move. Two states are neighbours by the `dominance` rule of the theory (Van de Weghe and
De Maeyer, "Conceptual neighbourhood diagrams for representing moving objects", 2005) if
symbols change only between 0 and another value (continuity), and those that change all
arrive at 0 or all leave it: a value other than 0 holds over an interval, 0 may hold at
an instant, so no symbol can leave 0 at the very instant at which another one arrives
there. The `continuity` rule, which NeuroSyM's released table uses, drops the second
condition: 1160 edges of QTC_C1 instead of 544. A QTC_BC state of a pair apart and one
of a pair near are compared by the symbols that both have.
"""

import functools
from typing import Annotated, Literal

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import Rule, refuse
from neurosym_jax.errors import InputError

__all__ = [
    "ABSENT",
    "DISTANCES",
    "Calculus",
    "Distances",
    "NeighbourRule",
    "adjacency",
    "all_states",
]
__all__ += [
    "alpha_table",
    "collapse",
    "encode_state",
    "format_state",
    "state_index",
    "state_texts",
    "validate",
]

ABSENT = np.int8(2)
"""A symbol that the state does not have: q3 and q4 of a QTC_BC state of a pair far apart, or all
symbols of a pair with a position that is not there."""
DISTANCES = (0.45, 1.2, 3.6, 7.6)
"""Metres between people at which intimate, personal, social and public distance end (Hall, "The
Hidden Dimension", 1966)."""

Distances = Annotated[
    tuple[float, ...],
    Rule(
        "be positive and increase",
        lambda value: bool(value) and bool((np.diff((0, *value)) > 0).all()),
    ),
]
Calculus = Literal["b1", "c1", "bc1", "argd", "mos"]
NeighbourRule = Literal["dominance", "continuity"]


@functools.cache
def all_states(
    calculus: Calculus = "c1", distances: tuple[float, ...] = DISTANCES
) -> np.ndarray:
    """[S, m] int8, read-only: the 9 states of `b1`, 81 of `c1`, or 90 of `bc1`, pairs apart first.

    `argd` has one for each of its `distances`, the nearest first, and one beyond; `mos`
    has 4.

    Raises:
        InputError: for an unknown calculus.
    """
    refuse(Calculus, {"calculus": calculus})
    if calculus == "argd":
        return _read_only(np.arange(-len(distances), 1, dtype=np.int8)[:, None])
    if calculus == "mos":
        return _read_only(np.indices((2, 2)).astype(np.int8).reshape(2, 4).T)
    states = np.indices([3] * (2 if calculus == "b1" else 4)).astype(np.int8) - 1
    states = states.reshape(len(states), -1).T
    if calculus == "bc1":
        far_states = np.pad(all_states("b1"), [(0, 0), (0, 2)], constant_values=ABSENT)
        states = np.concatenate([far_states, states])
    return _read_only(states)


def _read_only(table: np.ndarray) -> np.ndarray:
    table.flags.writeable = False
    return table


def encode_state(states: ArrayLike) -> Array:
    """[...] int32 codes of states [..., m] in {-1, 0, 1}: base 3 of q + 1, q1 most significant.

    An absent state has the code after the last, 3^m.
    """
    states = jnp.asarray(states)
    code = jnp.zeros(states.shape[:-1], jnp.int32)
    for symbol in range(states.shape[-1]):
        code = 3 * code + states[..., symbol].astype(jnp.int32) + 1
    return jnp.where(states[..., 0] == ABSENT, 3 ** states.shape[-1], code)


def state_index(
    calculus: Calculus, states: ArrayLike, distances: tuple[float, ...] = DISTANCES
) -> Array:
    """[...] int32 rows of states [..., m] in `all_states`; those of `b1` and `c1` are codes.

    An absent state has the number of states, the row after the last.
    """
    states = jnp.asarray(states)
    if calculus in ("b1", "c1"):
        return encode_state(states)
    first = states[..., 0].astype(jnp.int32)
    if calculus == "argd":
        row = first + len(distances)
    elif calculus == "mos":
        row = 2 * first + states[..., 1]
    else:
        near = encode_state(states) + 9
        row = jnp.where(states[..., 2] == ABSENT, encode_state(states[..., :2]), near)
    return jnp.where(first == ABSENT, len(all_states(calculus, distances)), row)


def format_state(state: ArrayLike, separator: str = " ") -> str:
    """One QTC state [m] as text, `"- 0 + -"`, without absent symbols. QSRlib separates by `,`."""
    symbols = [int(symbol) for symbol in np.asarray(state) if symbol != ABSENT]
    return separator.join("-0+"[symbol + 1] for symbol in symbols)


def state_texts(
    calculus: Calculus = "c1", distances: tuple[float, ...] = DISTANCES
) -> list[str]:
    """The S states of a calculus as text, such as `-+0+`, `<= 1.2 m` or `m s`, by their rows."""
    if calculus == "argd":
        return [
            *(f"<= {distance:g} m" for distance in distances),
            f"> {distances[-1]:g} m",
        ]
    if calculus == "mos":
        return [
            " ".join("sm"[symbol] for symbol in state) for state in all_states("mos")
        ]
    return [format_state(state, "") for state in all_states(calculus)]


def collapse(states: ArrayLike) -> np.ndarray:
    """The chain `states [T, m]` without repetitions of the state before; absence is a value."""
    states = np.asarray(states)
    return states[
        np.append(True, (states[1:] != states[:-1]).any(axis=1))[: len(states)]
    ]


def validate(states: ArrayLike) -> np.ndarray:
    """A chain `[T, m]` made continuous, as QSRlib does (Delafontaine, 2011).

    Wherever a symbol skips 0, at most one state is inserted: symbols that jump between
    - and + pass through 0; if a symbol has to leave its value for 0, all symbols that
    leave 0 wait. Symbols that only one of the two states has are not compared.
    """
    states = np.asarray(states)
    before, after = states[:-1], states[1:]
    shared = (before != ABSENT) & (after != ABSENT)
    p, c = np.where(shared, before, 0), np.where(shared, after, 0)
    middle = np.where(p * c == -1, 0, c)
    leaving = ((p != 0) & (middle == 0)).any(axis=1, keepdims=True)
    middle = np.where(shared, np.where(leaving & (p == 0), 0, middle), after).astype(
        states.dtype
    )
    at = np.flatnonzero((middle != after).any(axis=1))
    return np.insert(states, at + 1, middle[at], axis=0)


@functools.cache
def adjacency(
    calculus: Calculus = "c1", rule: NeighbourRule = "dominance"
) -> np.ndarray:
    """[S, S] bool, symmetric: which states are neighbours; none is its own.

    Those of `argd`, at its default distances, are the next nearer and the next farther
    one, for distances change continuously (Clementini, Di Felice, Hernandez,
    "Qualitative representation of positional information", 1997).

    Raises: InputError: for an unknown calculus or rule, and `mos`, of which no diagram
        is published.
    """
    refuse(NeighbourRule, {"rule": rule})
    if calculus == "mos":
        raise InputError(
            "mos has no published neighbourhood diagram: use b1, c1, bc1 or argd"
        )
    states = all_states(calculus)
    if calculus == "argd":
        return _read_only(abs(states - states.T) == 1)
    a, b = states[:, None], states[None]
    # A symbol that only one of them has is not compared; staying is no transition.
    same = (a == b) | (a == ABSENT) | (b == ABSENT)
    table = ~(a == b).all(axis=-1) & (same | (a * b == 0)).all(axis=-1)
    if rule == "dominance":
        table &= (same | (b == 0)).all(axis=-1) | (same | (a == 0)).all(axis=-1)
    return _read_only(table)


@functools.cache
def alpha_table(
    calculus: Calculus = "c1",
    rule: NeighbourRule = "dominance",
    include_self: bool = False,
) -> np.ndarray:
    """[S] float64: 1 / N_Tr of every state, N_Tr its number of neighbours.

    Mghames et al., "A Neuro-Symbolic Approach for Enhanced Human Motion Prediction"
    (2023): the more transitions a state has, the less it says. QTC_C1 states with 0, 1,
    2, 3 or 4 zeros weigh 1/15, 1/9, 1/11, 1/27, 1/80. The authors' table is
    `rule="continuity"` with `include_self=True`, which counts staying in the state as a
    transition: 1 / (2^nonzero 3^zero).
    """
    table = 1 / (adjacency(calculus, rule).sum(axis=1) + include_self)
    return _read_only(table)
