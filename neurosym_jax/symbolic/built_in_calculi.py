"""The table of calculi, with the built-in ones.

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

q1 to q4 are those of `qtc`. q5 compares the steps' lengths, - where k's is the shorter. q6 compares
the angles, of 0 to 90 degrees, between each step and the line through both agents, - where k's is
the smaller, and is 0 if somebody stands (Van de Weghe, 2004). Where q1 to q4 leave no choice of q5
and q6 they are what those say, so that thresholds cannot make an impossible state: an agent with no
movement towards, away or to a side stands, and is the slower. QTC_BC (Bellotto, Hanheide, Van de
Weghe, 2013) drops q3 and q4, which are then `states.ABSENT`, of pairs that are apart.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.registry import Registry
from neurosym_jax.symbolic.calculus import Calculus, Observe, Thresholds
from neurosym_jax.symbolic.qtc import Convention, compare, frames, length, qtc_b1, qtc_c1, states_of
from neurosym_jax.symbolic.states import ABSENT

__all__ = ["CALCULI"]


def _b1(k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds) -> Array:  # noqa: E741
    return qtc_b1(k, l, quantisation_factor=given.quantisation_factor, convention=convention)


def _c1(k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds) -> Array:  # noqa: E741
    return qtc_c1(
        k,
        l,
        quantisation_factor=given.quantisation_factor,
        convention=convention,
        side_quantisation_factor=given.side_quantisation_factor,
    )


def _b2(k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds) -> Array:  # noqa: E741
    return _joined(_b1(k, l, convention, given), _speed(k, l, given))


def _c2(k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds) -> Array:  # noqa: E741
    states = _c1(k, l, convention, given)
    forced, value = _forced_speed(states)
    return _joined(states, _unless(forced, value, _speed(k, l, given)))


def _c2_angle(k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds) -> Array:  # noqa: E741
    states = _c2(k, l, convention, given)
    forced, value = _forced_angle(states)
    return _joined(states, _unless(forced, value, _angle(k, l, given)))


def _unless_apart(near: Observe) -> Observe:
    """`near`, whose q3 and q4 are `ABSENT` while the pair is apart."""

    def bc(k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds) -> Array:  # noqa: E741
        states = near(k, l, convention, given)
        (_, (x, y)), (_, (other_x, other_y)) = frames(k, l)
        distance = length(x - other_x, y - other_y)
        joins = distance <= given.near
        parts = distance > (given.near if given.apart is None else given.apart)
        # The newest step at which the distance decided; none has not yet been near.
        step = jnp.arange(len(distance)).reshape(-1, *[1] * (distance.ndim - 1))
        decided = jax.lax.cummax(jnp.where(joins | parts, step, -1))
        newest = jnp.take_along_axis(joins, jnp.maximum(decided, 0), axis=0)
        apart = jnp.moveaxis(~(newest & (decided >= 0)), 0, -1)
        sides = jnp.where(apart[..., None], ABSENT, states[..., 2:4])
        return jnp.concatenate([states[..., :2], sides, states[..., 4:]], axis=-1)

    return bc


def _speed(k: ArrayLike, l: ArrayLike, given: Thresholds) -> Array:  # noqa: E741
    """q5 [..., T-1, 1] as observed."""
    of_k, of_l = (length(x1 - x0, y1 - y0) for (x0, y0), (x1, y1) in frames(k, l))
    return states_of([compare(of_k, of_l, given.quantisation_factor)])


def _angle(k: ArrayLike, l: ArrayLike, given: Thresholds) -> Array:  # noqa: E741
    """q6 [..., T-1, 1] as observed, where both move.

    sin(a - b) = sin a cos b - cos a sin b: the products are compared, times the lengths.
    """
    moves = frames(k, l)
    ((kx, ky), _), ((lx, ly), _) = moves
    line = lx - kx, ly - ky
    across, along, steps = [], [], []
    for (x0, y0), (x1, y1) in moves:
        x, y = x1 - x0, y1 - y0
        across.append(abs(x * line[1] - y * line[0]))
        along.append(abs(x * line[0] + y * line[1]))
        steps.append(length(x, y))
    square = line[0] * line[0] + line[1] * line[1]
    threshold = jnp.sin(given.angle) * steps[0] * steps[1] * square
    return states_of([compare(across[0] * along[1], across[1] * along[0], threshold)])


def _unless(forced: Array, value: Array, symbol: Array) -> Array:
    return jnp.where(forced[..., None], value[..., None].astype(jnp.int8), symbol)


def _joined(states: Array, symbol: Array) -> Array:
    return jnp.concatenate([states, symbol], axis=-1)


# What q1 to q4 say of the others, for arrays of numpy and of jax alike.


def _standing(states: Any) -> tuple[Any, Any]:
    q1, q2, q3, q4 = (states[..., symbol] == 0 for symbol in range(4))
    return q1 & q3, q2 & q4


def _slower(k_stands: Any, l_stands: Any) -> tuple[Any, Any]:
    """Whether q5 is forced, and what it is: who stands is the slower, unless both do."""
    return k_stands | l_stands, l_stands * 1 - k_stands * 1


def _forced_speed(states: Any) -> tuple[Any, Any]:
    return _slower(*_standing(states))


def _forced_angle(states: Any) -> tuple[Any, Any]:
    """Whether q6 is forced, and what it is.

    An angle is 0 without sideways movement and a right one without approach.
    """
    k, l = _standing(states)  # noqa: E741
    rank_k, rank_l = ((states[..., i] == 0) * 1 - (states[..., i + 2] == 0) * 1 for i in (0, 1))
    known = (rank_k != 0) | (rank_l != 0)
    difference = ((rank_k > rank_l) * 1 - (rank_k < rank_l) * 1) * ~(k | l)
    # Two right angles, and two of 0, are equal; with one of them the other is in between.
    return k | l | known, difference


def _fits(symbol: Any, forced: tuple[Any, Any]) -> Any:
    return ~forced[0] | (symbol == forced[1])


def _possible_on_a_line(every: np.ndarray) -> np.ndarray:
    return _fits(every[:, 2], _slower(every[:, 0] == 0, every[:, 1] == 0))


def _possible_c2(every: np.ndarray) -> np.ndarray:
    return _fits(every[:, 4], _forced_speed(every))


def _possible_c2_angle(every: np.ndarray) -> np.ndarray:
    return _possible_c2(every) & _fits(every[:, 5], _forced_angle(every))


_SIDES = ("q1", "q2", "q3", "q4")

CALCULI: Registry[Calculus] = Registry(
    "calculus",
    {
        "b1": Calculus(("q1", "q2"), _b1),
        "b2": Calculus(("q1", "q2", "q5"), _b2),
        "b12_1d": Calculus(("q1", "q2", "q5"), _b2, _possible_on_a_line),
        "c1": Calculus(_SIDES, _c1),
        "c2": Calculus((*_SIDES, "q5"), _c2, _possible_c2),
        "c2_angle": Calculus((*_SIDES, "q5", "q6"), _c2_angle, _possible_c2_angle),
        "bc1": Calculus(_SIDES, _unless_apart(_c1), optional=(2, 3)),
        "bc2": Calculus((*_SIDES, "q5"), _unless_apart(_c2), _possible_c2, optional=(2, 3)),
    },
)
