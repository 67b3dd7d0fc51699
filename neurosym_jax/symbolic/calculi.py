"""The QTC calculi, and the one way to observe the states of pairs in them.

| name | symbols | |
|---|---|---|
| `b1` | q1 q2 | QTC_B1: towards, away |
| `b2` | q1 q2 q5 | QTC_B2: and relative speed |
| `b12_1d` | q1 q2 q5 | the same of points on one line |
| `c1` | q1 q2 q3 q4 | QTC_C1: and sides |
| `c2` | q1 q2 q3 q4 q5 | QTC_C2 without angles |
| `c2_angle` | q1 q2 q3 q4 q5 q6 | QTC_C2: and relative angle |
| `bc1` | `c1` near, `b1` apart | QTC_BC1 |
| `bc2` | `c2` near, `b2` apart | QTC_BC2 |

The symbols are defined in `qtc`. QTC_BC (Bellotto, Hanheide, Van de Weghe, 2013) drops q3 and q4 of
pairs that are apart; they are then `states.ABSENT`. The conceptual neighbourhood diagram of a
calculus (`cnd`) follows from its states.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.registry import Registry
from neurosym_jax.symbolic.qtc import (
    Convention,
    Thresholds,
    absent_when_apart,
    implied_angle,
    implied_speed,
    observe_symbols,
)
from neurosym_jax.symbolic.states import ABSENT

__all__ = ["CALCULI", "Calculus", "observe", "register_calculus", "state_index"]

Observe = Callable[[ArrayLike, ArrayLike, Convention, Thresholds], Array]


@dataclasses.dataclass(frozen=True)
class Calculus:
    """One calculus of the family."""

    symbols: tuple[str, ...]
    """Names of its m symbols."""
    observe: Observe
    """`(k [..., T, 2], l [..., T, 2], convention, thresholds) -> [..., T-1, m]` int8 states."""
    possible: Callable[[np.ndarray], np.ndarray] = lambda every: np.ones(len(every), bool)
    """[S] bool: which of the states [S, m] of symbols in {-1, 0, 1} moving points can be in."""
    optional: tuple[int, ...] = ()
    """Places of the symbols that are all `ABSENT` when a pair is apart."""

    @functools.cached_property
    def states(self) -> np.ndarray:
        """[S, m] int8, read-only: all states, those of pairs apart first, in order.

        There are 9 of `b1`, 27 of `b2` (17 on a line, `b12_1d`), 81 of `c1`, 209 of `c2` (305 with
        angles, `c2_angle`), 90 of `bc1` and 236 of `bc2`. For `b1`, `b2` and `c1` the row of a
        state is its code (`states.encode_state`).
        """
        symbols = len(self.symbols)
        every = np.array(list(itertools.product((-1, 0, 1), repeat=symbols)), np.int8)
        found = every[self.possible(every)]
        if self.optional:
            apart = np.unique(np.delete(every, self.optional, axis=1), axis=0)
            for place in self.optional:
                apart = np.insert(apart, place, ABSENT, axis=1)
            found = np.concatenate([apart, found])
        found.flags.writeable = False
        return found


def observe(
    k: ArrayLike,
    l: ArrayLike,
    calculus: str = "c1",
    *,
    convention: Convention = "distance",
    **thresholds: ArrayLike | None,
) -> Array:
    """States of the pair (k, l) at every step.

    All ordered pairs of a scene of positions [N, T, 2] are `observe(positions[:, None], positions)`
    [N, N, T-1, m], with agent i as k and agent j as l in entry (i, j).

    Args:
        k: [..., T, 2] positions in metres.
        l: [..., T, 2] positions in metres; leading axes broadcast against those of `k`.
        calculus: its name.
        convention: of q1 to q4, see `qtc`.
        **thresholds: see `qtc.Thresholds`.

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


def state_index(calculus: str, observed: ArrayLike) -> Array:
    """[...] int32 rows of the states `observed [..., m]` in a calculus's `states`; -1 for none."""
    rows = jnp.asarray(_rows(CALCULI[calculus]))
    return rows.at[_code(jnp.asarray(observed))].get(mode="fill", fill_value=-1)


@functools.cache
def _rows(calculus: Calculus) -> np.ndarray:
    """[4 ** m]: the row of a state by its `_code`, else -1."""
    rows = np.full(4 ** len(calculus.symbols), -1, np.int32)
    rows[_code(calculus.states)] = np.arange(len(calculus.states))
    return rows


def _code(observed: Any) -> Any:
    """[...] numbers of states [..., m], base 4 because a symbol can be absent."""
    code = 0
    for symbol in range(observed.shape[-1]):
        code = 4 * code + observed[..., symbol].astype(np.int32) + 1
    return code


def _qtc(
    symbols: str, possible: Callable[..., Any] | None = None, *, near_only: bool = False
) -> Calculus:
    """The calculus of some of q1 to q6; `near_only`: pairs that are apart have no q3 and q4."""
    names = tuple(symbols.split())

    def observe(k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds) -> Array:
        found = observe_symbols(names, k, l, convention, given)
        return absent_when_apart(found, k, l, given) if near_only else found

    return Calculus(names, observe, possible or _as_implied, (2, 3) if near_only else ())


def _as_implied(every: np.ndarray) -> np.ndarray:
    """[S] whether q5 and q6 are what q1 to q4 imply, where states [S, m] have all of these."""
    fits = np.ones(len(every), bool)
    for place, implied in ((4, implied_speed), (5, implied_angle)):
        if every.shape[1] > place:
            fits &= _agrees(every[:, place], *implied(*every.T[:4]))
    return fits


def _on_a_line(every: np.ndarray) -> np.ndarray:
    """[S] whether q5 is what q1 and q2 imply of points that move on one line."""
    q1, q2, q5 = every.T
    return _agrees(q5, *implied_speed(q1, q2, 0, 0))


def _agrees(symbol: np.ndarray, decided: np.ndarray, value: np.ndarray) -> np.ndarray:
    return ~decided | (symbol == value)


CALCULI: Registry[Calculus] = Registry(
    "calculus",
    {
        "b1": _qtc("q1 q2"),
        "b2": _qtc("q1 q2 q5"),
        "b12_1d": _qtc("q1 q2 q5", _on_a_line),
        "c1": _qtc("q1 q2 q3 q4"),
        "c2": _qtc("q1 q2 q3 q4 q5"),
        "c2_angle": _qtc("q1 q2 q3 q4 q5 q6"),
        "bc1": _qtc("q1 q2 q3 q4", near_only=True),
        "bc2": _qtc("q1 q2 q3 q4 q5", near_only=True),
    },
)


def register_calculus(name: str, calculus: Calculus, *, replace: bool = False) -> None:
    """Add a calculus; its states, diagram and chains follow.

    Raises:
        InputError: for a name that is taken or cannot be one.
    """
    CALCULI.register(name, calculus, replace=replace)
