"""QTC_C1: states, their diagram of neighbours and its weights, and the symbols of pairs
of tracks.
"""

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from neurosym_jax.configuration import NotNegative, Rule, refuse
from neurosym_jax.errors import InputError

__all__ = [
    "ABSENT",
    "DISTANCES",
    "Calculus",
    "Convention",
    "Distances",
    "NeighbourRule",
    "absent_steps",
    "adjacency",
    "all_states",
    "alpha_table",
    "collapse",
    "comparisons",
    "encode_state",
    "format_state",
    "observe",
    "other_pairs",
    "refuse_known",
    "refuse_other_pair",
    "side_factor",
    "state_index",
    "state_texts",
    "validate",
]


# States of qualitative calculi, chains of them, and which can follow each other.
#
# A state is a vector of m symbols (int8), QTC's in {-1, 0, 1}. Those that QTC_BC drops
# are `ABSENT`, and all of them where a position is not there. `qtc` says what symbols
# mean. Tables are read-only; their rows are those of `all_states`.
#
# Conceptual neighbourhood diagrams say which states can follow each other when points
# move. Two states are neighbours by the `dominance` rule of the theory (Van de Weghe and
# De Maeyer, "Conceptual neighbourhood diagrams for representing moving objects", 2005) if
# symbols change only between 0 and another value (continuity), and those that change all
# arrive at 0 or all leave it: a value other than 0 holds over an interval, 0 may hold at
# an instant, so no symbol can leave 0 at the very instant at which another one arrives
# there. The `continuity` rule, which NeuroSyM's released table uses, drops the second
# condition: 1160 edges of QTC_C1 instead of 544. A QTC_BC state of a pair apart and one
# of a pair near are compared by the symbols that both have.

ABSENT = np.int8(2)
"""A symbol that the state does not have: q3 and q4 of a QTC_BC state of a pair far apart, or all
symbols of a pair with a position that is not there."""
DISTANCES = (0.45, 1.2, 3.6, 7.6)
"""Metres between people at which intimate, personal, social and public distance end (Hall, "The
Hidden Dimension", 1966)."""


def _increase(value: tuple[float, ...]) -> bool:
    """Whether there are numbers, and each is larger than 0 and the one before."""
    return bool(value) and bool((np.diff((0, *value)) > 0).all())


Distances = Annotated[tuple[float, ...], Rule("be positive and increase", _increase)]
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
        return _read_only(_combinations((0, 1), 2))
    if calculus == "b1":
        return _read_only(_combinations((-1, 0, 1), 2))
    states = _combinations((-1, 0, 1), 4)
    if calculus == "bc1":
        towards = all_states("b1")
        no_sides = np.full_like(towards, ABSENT)
        far_states = np.concatenate([towards, no_sides], axis=1)
        states = np.concatenate([far_states, states])
    return _read_only(states)


def _combinations(values: Sequence[int], symbols: int) -> np.ndarray:
    """[S, symbols] int8: all states of so many symbols, the last of which changes first."""
    return np.array(list(itertools.product(values, repeat=symbols)), np.int8)


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
        far = encode_state(states[..., :2])
        near = encode_state(states) + 9
        row = jnp.where(states[..., 2] == ABSENT, far, near)
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
        within = [f"<= {distance:g} m" for distance in distances]
        return [*within, f"> {distances[-1]:g} m"]
    if calculus == "mos":
        return ["s s", "s m", "m s", "m m"]  # They stand, or move.
    return [format_state(state, "") for state in all_states(calculus)]


def collapse(states: ArrayLike) -> np.ndarray:
    """The chain `states [T, m]` without repetitions of the state before; absence is a value."""
    states = np.asarray(states)
    is_new = np.ones(len(states), bool)
    is_new[1:] = (states[1:] != states[:-1]).any(axis=1)
    return states[is_new]


def validate(states: ArrayLike) -> np.ndarray:
    """A chain `[T, m]` made continuous, as QSRlib does (Delafontaine, 2011).

    Wherever a symbol skips 0, at most one state is inserted: symbols that jump between
    - and + pass through 0; if a symbol has to leave its value for 0, all symbols that
    leave 0 wait. Symbols that only one of the two states has are not compared.
    """
    states = np.asarray(states)
    before, after = states[:-1], states[1:]
    shared = (before != ABSENT) & (after != ABSENT)
    p = np.where(shared, before, 0)
    c = np.where(shared, after, 0)
    middle = np.where(p * c == -1, 0, c)
    leaving = ((p != 0) & (middle == 0)).any(axis=1, keepdims=True)
    middle = np.where(leaving & (p == 0), 0, middle)
    middle = np.where(shared, middle, after).astype(states.dtype)
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

    Raises:
        InputError: for an unknown calculus or rule, and `mos`, of which no diagram is
            published.
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
    differ = (a != b).any(axis=-1)
    is_continuous = (same | (a * b == 0)).all(axis=-1)
    table = differ & is_continuous
    if rule == "dominance":
        all_to_zero = (same | (b == 0)).all(axis=-1)
        all_from_zero = (same | (a == 0)).all(axis=-1)
        table &= all_to_zero | all_from_zero
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


# What two points do relative to each other, as signs: the Qualitative Trajectory
# Calculus (QTC).
#
# A state of the pair (k, l) describes one step, from one frame to the next, by four
# symbols:
#
# - q1: k moves towards l (-), away from l (+), or neither (0);
# - q2: l moves towards k (-), away from k (+), or neither (0);
# - q3: k moves to the left (-) or right (+) of the line from k to l, or along it (0);
# - q4: l moves to the left (-) or right (+) of the line from l to k, or along it (0).
#
# Three calculi of the family can be observed: `b1`, QTC_B1, is q1 and q2; `c1`, QTC_C1,
# all four; `bc1`, QTC_BC1 (Bellotto, Hanheide, Van de Weghe, 2013), is `c1` for pairs
# that are near each other and `b1` for others, whose q3 and q4 are `ABSENT`. So can two
# calculi that QSRlib has beside QTC:
#
# - `argd`, argument distance: minus the number of distances within which the pair is
# after a step;
# - `mos`, moving or stationary: 1 for a point that moves and 0 for one that stands, of k
# and of l.
#
# A state needs both points before and after the step. Where a coordinate is NaN all its
# symbols are `ABSENT`.
#
# Van de Weghe, "Representing and Reasoning about Moving Objects: A Qualitative Approach"
# (2004); Delafontaine, Cohn, Van de Weghe, "Implementing a qualitative calculus to
# analyse moving point objects" (2011). Three conventions are in use:
#
# - `distance` (the papers, and NeuroSyM: Mghames et al., 2023): q1 is the sign of
#   |k1 - l0| - |k0 - l0|. The quantisation factor applies to q1 and q2 only, unless a
#   `side_quantisation_factor` is given.
# - `line` (QSRlib): q1 is the sign of the displacement's component along the line from l0
#   to k0, so passing someone at a right angle is 0, not +. The quantisation factor
#   applies to all symbols.
# - `as_published` (NeuroSyM's released code): as `distance`, but the sides are unsigned:
#   any movement off the line is +, and no side is ever -.
#
# Both agents are taken at t-1, so T frames give T-1 states. Symbols are piecewise
# constant, so no gradient passes through them; `soft` has differentiable ones.

Convention = Literal["distance", "line", "as_published"]


def observe(
    k: ArrayLike,
    l: ArrayLike,
    calculus: Calculus = "c1",
    *,
    convention: Convention = "distance",
    quantisation_factor: ArrayLike = 0.0,
    side_quantisation_factor: ArrayLike | None = None,
    near: ArrayLike = 1.22,
    distances: tuple[float, ...] = DISTANCES,
) -> Array:
    """States [..., T-1, m] int8 of the pair (k, l) at every step; QTC's in {-1, 0, 1} or `ABSENT`.

    All ordered pairs of a scene of positions [N, T, 2] are `observe(positions[:, None],
    positions)` [N, N, T-1, m], with agent i as k and agent j as l in entry (i, j).
    Thresholds are inclusive, and may be traced.

    Args:
        k, l: [..., T, 2] positions in metres; leading axes broadcast.
        calculus: `b1`, `c1`, `bc1`, `argd` or `mos`, see the module.
        convention: see the module.
        quantisation_factor: metres per step up to which q1 and q2, or a symbol of
            `mos`, are 0.
        side_quantisation_factor: metres per step across the line up to which q3 and q4
            are 0; None is `quantisation_factor` in the `line` convention and 0 in the
            others.
        near: metres between k and l, at the end of a step, up to which `bc1` has sides.
        distances: metres, increasing, at which `argd` passes from one state to the
            next.

    Raises:
        InputError: for an unknown calculus or convention, positions of other shapes, a
            factor below 0, and distances that do not increase.
    """
    refuse(Calculus, {"calculus": calculus})
    refuse(Distances, {"distances": distances})
    refuse_known(NotNegative, {"quantisation_factor": quantisation_factor})
    if isinstance(k, list | tuple):
        k = np.asarray(k)
    if isinstance(l, list | tuple):
        l = np.asarray(l)
    refuse_other_pair(k, l)
    if calculus == "argd":
        symbols = [_distance_symbol(k, l, distances)]
    elif calculus == "mos":
        moving = _moving(k, l, quantisation_factor)
        symbols = [moves.astype(jnp.int8) for moves in moving]
    else:
        factors = quantisation_factor, side_quantisation_factor
        symbols = _qtc_symbols(k, l, calculus, convention, factors, near)
    states = jnp.moveaxis(jnp.stack(symbols), (0, 1), (-1, -2))
    return jnp.where(absent_steps(k, l)[..., None], ABSENT, states)


def refuse_known(hint: Any, values: Mapping[str, ArrayLike | None]) -> None:
    """Refuse the least number of each array [...] that does not fit `hint`, unless it is traced.

    Raises:
        InputError: naming the first.
    """
    for name, value in values.items():
        if value is not None and not isinstance(value, Tracer):
            refuse(hint, {name: np.min(np.asarray(value))})


def refuse_other_pair(k: ArrayLike, l: ArrayLike) -> None:
    """Refuse what are not positions [..., T, 2] of a pair.

    Raises:
        InputError: with both shapes.
    """
    k_shape = np.shape(k)
    l_shape = np.shape(l)
    if k_shape[-1:] != (2,) or k_shape[-2:] != l_shape[-2:]:
        shapes = f"{list(k_shape)} and {list(l_shape)}"
        raise InputError(f"positions must be [..., T, 2] of one length, not {shapes}")


def _qtc_symbols(
    k: ArrayLike,
    l: ArrayLike,
    calculus: Calculus,
    convention: Convention,
    factors: tuple[ArrayLike, ArrayLike | None],
    near: ArrayLike,
) -> list[Array]:
    """Each symbol of a QTC calculus [T-1, ...]; `factors` are the two quantisation factors."""
    quantisation_factor, side_quantisation_factor = factors
    side = side_factor(quantisation_factor, convention, side_quantisation_factor)
    q1, q2, q3, q4 = comparisons(k, l, convention, _length)
    towards = [_compare(*pair, quantisation_factor) for pair in (q1, q2)]
    if calculus == "b1":
        return towards
    sides = [_compare(*pair, side) for pair in (q3, q4)]
    if convention == "as_published":
        sides = [abs(side) for side in sides]
    if calculus == "bc1":
        far = _distance_after(k, l) > near
        sides = [jnp.where(far, ABSENT, side) for side in sides]
    return towards + sides


def _distance_after(k: ArrayLike, l: ArrayLike) -> Array:
    """[T-1, ...] metres between the pair after each step."""
    (_, k_after, _), (_, l_after, _) = _ways(k, l)
    return _length(k_after[0] - l_after[0], k_after[1] - l_after[1])


def _distance_symbol(k: ArrayLike, l: ArrayLike, distances: tuple[float, ...]) -> Array:
    """[T-1, ...] int8: minus the number of distances that the pair is within after each step."""
    length = _distance_after(k, l)
    count: Any = jnp.int8(0)
    for distance in distances:
        count = count + (length <= distance).astype(jnp.int8)
    return -count


def _moving(
    k: ArrayLike, l: ArrayLike, quantisation_factor: ArrayLike
) -> tuple[Array, ...]:
    """[T-1, ...] bool of k and of l: whether it moves farther than the factor, metres per step."""
    moving = []
    for (x0, y0), (x1, y1), _ in _ways(k, l):
        length = _length(x1 - x0, y1 - y0)
        moving.append(length > quantisation_factor)
    return tuple(jnp.broadcast_arrays(*moving))


def absent_steps(k: ArrayLike, l: ArrayLike) -> Array:
    """[..., T-1] bool: a point of the pair is not there before or after a step."""
    steps = []
    for point in _same_rank(k, l):
        missing = jnp.isnan(point).any(axis=-1)
        steps.append(missing[..., :-1] | missing[..., 1:])
    return steps[0] | steps[1]


def other_pairs(valid: ArrayLike) -> Array:
    """[N, N] bool: pairs of two different agents, both `valid` [N]."""
    valid = jnp.asarray(valid)
    different = ~jnp.eye(valid.shape[0], dtype=bool)
    return different & valid[:, None] & valid[None]


def side_factor(
    quantisation_factor: ArrayLike, convention: str, side: ArrayLike | None
) -> ArrayLike:
    """The quantisation factor [] of q3 and q4, `side` or by convention.

    Raises:
        InputError: for an unknown convention, and a factor below 0 that is not traced.
    """
    refuse(Convention, {"convention": convention})
    refuse_known(NotNegative, {"side_quantisation_factor": side})
    default = quantisation_factor if convention == "line" else 0.0
    return default if side is None else side


def comparisons(
    k: ArrayLike,
    l: ArrayLike,
    convention: Convention,
    length: Callable[[Array, Array], Array],
) -> list[tuple[Array, Array, Array | None]]:
    """(a, b, scale) [T-1, ...] of q1 to q4: the sign is that of a - b, metres times `scale`.

    Without a scale a and b are metres. Positions are those of `observe`, and `length`
    is of (x, y).
    """
    towards, sides = [], []
    for (x0, y0), (x1, y1), (x, y) in _ways(k, l):
        line_x = x - x0
        line_y = y - y0
        scale = length(line_x, line_y)
        if convention == "line":
            towards.append((-(x1 - x0) * line_x, (y1 - y0) * line_y, scale))
        else:
            after = length(x1 - x, y1 - y)
            before = length(x0 - x, y0 - y)
            towards.append((after, before, None))
        sides.append(((x1 - x0) * line_y, (y1 - y0) * line_x, scale))
    return towards + sides


def _ways(k: ArrayLike, l: ArrayLike) -> list[tuple[Any, Any, Any]]:
    """(Mover before, mover after, other before) of k [..., T, 2] moving, then of l.

    Each is (x, y) of [T-1, ...]: with steps first, all pairs of a scene are computed
    along agents and not along the few steps, which vectorises and takes a quarter of
    the time.
    """
    before, after = [], []
    for point in _same_rank(k, l):
        x, y = jnp.moveaxis(point, (-1, -2), (0, 1))
        before.append((x[:-1], y[:-1]))
        after.append((x[1:], y[1:]))
    k_before, l_before = before
    k_after, l_after = after
    return [(k_before, k_after, l_before), (l_before, l_after, k_before)]


def _same_rank(k: ArrayLike, l: ArrayLike) -> list[Array]:
    """k and l [..., T, 2] as arrays of numbers with equally many axes."""
    points = [jnp.asarray(point, jnp.result_type(point, 0.0)) for point in (k, l)]
    axes = max(point.ndim for point in points)
    padded = []
    for point in points:
        ones = (1,) * (axes - point.ndim)
        padded.append(point.reshape(ones + point.shape))
    return padded


def _compare(a: Array, b: Array, scale: Array | None, factor: ArrayLike) -> Array:
    """Sign of a - b [...] where it exceeds the factor, else 0, as int8; see `comparisons`.

    Sums are compared instead of a difference because compilers fuse `p*q - r*s` into a
    multiply-add that rounds one product only. Two equal products would then differ by a
    rounding error, and exact ties, such as all agents walking on one line, would be
    lost.
    """
    threshold = factor if scale is None else factor * scale
    is_plus = a > b + threshold
    is_minus = b > a + threshold
    return is_plus.astype(jnp.int8) - is_minus.astype(jnp.int8)


def _length(x: Array, y: Array) -> Array:
    """[...] length of (x, y), that of (y, x) even if a compiler fuses a product and the sum."""
    long = jnp.maximum(abs(x), abs(y))
    short = jnp.minimum(abs(x), abs(y))
    return jnp.sqrt(long * long + short * short)
