"""The QTC calculi, and the one way to observe the states of pairs in them.

| name | symbols | |
|---|---|---|
| `b1` | q1 q2 | QTC_B1: towards, away |
| `b2` | q1 q2 q5 | QTC_B2: and relative speed |
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

__all__ = ["CALCULI", "Calculus", "observe", "state_index"]


@dataclasses.dataclass(frozen=True)
class Calculus:
    """One calculus of the family."""

    symbols: tuple[str, ...]
    """Names of its m symbols."""
    near_only: bool = False
    """Whether pairs that are apart have no q3 and q4."""

    @functools.cached_property
    def states(self) -> np.ndarray:
        """[S, m] int8, read-only: all states that moving points can be in, pairs apart first.

        There are 9 of `b1`, 27 of `b2`, 81 of `c1`, 209 of `c2` (305 with angles, `c2_angle`), 90
        of `bc1` and 236 of `bc2`. For `b1`, `b2` and `c1` the row of a state is its code
        (`states.encode_state`).
        """
        every = np.array(list(itertools.product((-1, 0, 1), repeat=len(self.symbols))), np.int8)
        found = every[_as_implied(every)]
        if self.near_only:
            apart = np.unique(np.delete(every, (2, 3), axis=1), axis=0)
            found = np.concatenate([np.insert(apart, (2, 2), ABSENT, axis=1), found])
        found.flags.writeable = False
        return found


def _as_implied(every: np.ndarray) -> np.ndarray:
    """[S] whether q5 and q6 are what q1 to q4 imply, where states [S, m] have all of these."""
    fits = np.ones(len(every), bool)
    for place, implied in ((4, implied_speed), (5, implied_angle)):
        if every.shape[1] > place:
            decided, value = implied(*every.T[:4])
            fits &= ~decided | (every[:, place] == value)
    return fits


CALCULI: Registry[Calculus] = Registry(
    "calculus",
    {
        "b1": Calculus(("q1", "q2")),
        "b2": Calculus(("q1", "q2", "q5")),
        "c1": Calculus(("q1", "q2", "q3", "q4")),
        "c2": Calculus(("q1", "q2", "q3", "q4", "q5")),
        "c2_angle": Calculus(("q1", "q2", "q3", "q4", "q5", "q6")),
        "bc1": Calculus(("q1", "q2", "q3", "q4"), near_only=True),
        "bc2": Calculus(("q1", "q2", "q3", "q4", "q5"), near_only=True),
    },
)


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
    chosen, values = CALCULI[calculus], Thresholds(**thresholds)  # pyright: ignore[reportArgumentType]
    states = observe_symbols(chosen.symbols, k, l, convention, values)
    return absent_when_apart(states, k, l, values) if chosen.near_only else states


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
