"""Conceptual neighbourhood diagrams: which QTC states can follow each other when points move.

Two states are neighbours under the `dominance` rule of the theory (Van de Weghe and De Maeyer,
"Conceptual neighbourhood diagrams for representing moving objects", 2005) if symbols change between
0 and another value only (continuity), and those that change all arrive at 0 or all leave it: a
value other than 0 holds over an interval, 0 may hold at an instant, so a symbol cannot leave 0 at
the very instant at which another one arrives there. The `continuity` rule, which NeuroSyM's
released table uses, drops the second condition: 1160 edges of QTC_C1 instead of 544.

Tables are numpy arrays, made once, read-only, whose rows are those of `states(calculus)`; for `b1`,
`b2` and `c1` the row is the state's code (`states.encode_state`). These are diagrams of the theory,
not frequencies of transitions seen in data.
"""

import functools
import itertools
from collections.abc import Callable
from typing import Any, Literal, get_args

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError

__all__ = [
    "Calculus",
    "Rule",
    "adjacency",
    "alpha_table",
    "is_transition",
    "states",
]

Calculus = Literal["b1", "b2", "b12_1d", "c1", "c2", "c2_angle"]
Rule = Literal["dominance", "continuity"]


@functools.cache
def states(calculus: Calculus = "c1") -> np.ndarray:
    """All states of a calculus that moving points can be in, in order of their codes.

    - `b1` [9, 2]: q1, q2. `c1` [81, 4]: q1 to q4.
    - `b2` [27, 3]: q1, q2 and the relative speed (- when k is the slower). `b12_1d` [17, 3]: the
      same on a line, where an agent that neither approaches nor leaves stands still.
    - `c2` [209, 5]: q1 to q4 and the relative speed; an agent without a movement of any kind stands
      still, which fixes the speed symbol. `c2_angle` [305, 6]: also the relative angle between
      velocity and the undirected reference line (- when k's is the smaller), 0 if someone stands.

    Returns:
        [S, m] int8 in {-1, 0, 1}, read-only.

    Raises:
        InputError: for an unknown calculus.
    """
    if calculus not in _CALCULI:
        raise InputError(f"unknown calculus {calculus!r}: there are {', '.join(_CALCULI)}")
    symbols, possible = _CALCULI[calculus]
    every = np.array(list(itertools.product((-1, 0, 1), repeat=symbols)), np.int8)
    return _frozen(every[possible(every)])


@functools.cache
def adjacency(calculus: Calculus = "c1", rule: Rule = "dominance") -> np.ndarray:
    """[S, S] bool, symmetric, read-only: which states are neighbours; none is its own."""
    rows = states(calculus)
    return _frozen(_neighbours(rows[:, None], rows[None], rule))


@functools.cache
def alpha_table(
    calculus: Calculus = "c1", rule: Rule = "dominance", include_self: bool = False
) -> np.ndarray:
    """[S] float64, read-only: 1 / N_Tr of every state, N_Tr its number of neighbours.

    Mghames et al., "A Neuro-Symbolic Approach for Enhanced Human Motion Prediction" (2023): the
    more transitions a state has, the less it says. QTC_C1 states with 0, 1, 2, 3 or 4 zeros weigh
    1/15, 1/9, 1/11, 1/27, 1/80. The authors' table is `rule="continuity"` with `include_self=True`,
    staying in the state counted as a transition: 1 / (2^nonzero 3^zero).
    """
    return _frozen(1 / (adjacency(calculus, rule).sum(axis=1) + include_self))


def is_transition(a: ArrayLike, b: ArrayLike, rule: Rule = "dominance") -> Array:
    """Whether states `a` and `b` [..., m] are neighbours, [...] bool; staying is no transition.

    Raises:
        InputError: for an unknown rule.
    """
    return _neighbours(jnp.asarray(a), jnp.asarray(b), rule)


def _neighbours(a: Any, b: Any, rule: str) -> Any:
    """`is_transition` for arrays of numpy and of jax alike."""
    if rule not in get_args(Rule):
        raise InputError(f"unknown rule {rule!r}: there are {', '.join(get_args(Rule))}")
    same = a == b
    allowed = ~same.all(axis=-1) & (a * b != -1).all(axis=-1)
    if rule == "continuity":
        return allowed
    arriving, leaving = (same | (b == 0)).all(axis=-1), (same | (a == 0)).all(axis=-1)
    return allowed & (arriving | leaving)


def _frozen(table: np.ndarray) -> np.ndarray:
    table.flags.writeable = False
    return table


def _all(every: np.ndarray) -> np.ndarray:
    return np.ones(len(every), bool)


def _on_a_line(every: np.ndarray) -> np.ndarray:
    k, l, speed = every.T  # noqa: E741
    return _speed_fits(k == 0, l == 0, speed)


def _speed_possible(every: np.ndarray) -> np.ndarray:
    return _speed_fits(*_standing(every), every[:, 4])


def _angle_possible(every: np.ndarray) -> np.ndarray:
    """An angle to the line is 0 without sideways movement, a right one without approach."""
    rank_k, rank_l = ((every[:, i] == 0) * 1 - (every[:, i + 2] == 0) for i in (0, 1))
    forced = np.where(np.logical_or(*_standing(every)), 0, np.sign(rank_k - rank_l))
    free = ~np.logical_or(*_standing(every)) & (rank_k == 0) & (rank_l == 0)
    return _speed_possible(every) & (free | (every[:, 5] == forced))


def _standing(every: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    k, l = ((every[:, [i, i + 2]] == 0).all(axis=1) for i in (0, 1))  # noqa: E741
    return k, l


def _speed_fits(k_stands: np.ndarray, l_stands: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Who stands is the slower of the two unless both do; if nobody does, any speed will do."""
    forced = l_stands * 1 - k_stands * 1
    return (~k_stands & ~l_stands) | (speed == forced)


_CALCULI: dict[str, tuple[int, Callable[[np.ndarray], np.ndarray]]] = {
    "b1": (2, _all),
    "b2": (3, _all),
    "b12_1d": (3, _on_a_line),
    "c1": (4, _all),
    "c2": (5, _speed_possible),
    "c2_angle": (6, _angle_possible),
}
