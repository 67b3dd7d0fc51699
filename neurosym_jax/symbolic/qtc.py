"""Qualitative Trajectory Calculus: what two moving points do relative to each other, in signs.

A state of the pair (k, l) from one frame to the next has the symbols

- q1: k moves towards l (-), away from l (+), or neither (0);
- q2: l moves towards k (-), away from k (+), or neither (0);
- q3: k moves to the left (-) or right (+) of the line from k to l, or along it (0);
- q4: l moves to the left (-) or right (+) of the line from l to k, or along it (0).

QTC_B1 is (q1, q2), QTC_C1 all four: Van de Weghe, "Representing and Reasoning about Moving
Objects: A Qualitative Approach" (2004); Delafontaine, Cohn, Van de Weghe, "Implementing a
qualitative calculus to analyse moving point objects" (2011). Three conventions are in use:

- `distance` (the papers, and NeuroSyM: Mghames et al., 2023): q1 is the sign of
  |k1 - l0| - |k0 - l0|. The quantisation factor applies to q1 and q2 only, unless a
  `side_quantisation_factor` is given.
- `line` (QSRlib): q1 is the sign of the displacement's component along the line from l0 to k0, so
  that passing someone at a right angle is 0, not +. The quantisation factor applies to all symbols.
- `as_published` (NeuroSyM's released code): as `distance`, but the sides are unsigned: any movement
  off the line is +, and no side is ever -.

Both agents are taken at t-1, so T frames give T-1 states. The functions are pure, take any leading
axes, and work under `jit` and `vmap`; symbols are piecewise constant, so nothing can be learnt
through them (see `soft`). This is neither the rest of the family (see `calculi`), nor the algebra
of the states (`states`), nor their neighbourhoods (`cnd`).
"""

import functools
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError

__all__ = [
    "Convention",
    "both_ways",
    "compare",
    "every_pair",
    "frames",
    "length",
    "other_pairs",
    "pair_mask",
    "pairwise_qtc_c1",
    "qtc_b1",
    "qtc_c1",
    "side_factor",
    "states_of",
]

Convention = Literal["distance", "line", "as_published"]


def qtc_b1(
    k: ArrayLike,
    l: ArrayLike,  # noqa: E741 (the calculus calls the two points k and l)
    *,
    quantisation_factor: ArrayLike = 0.0,
    convention: Convention = "distance",
) -> Array:
    """QTC_B1 states (q1, q2) of the pair (k, l).

    Args:
        k: [..., T, 2] positions in metres.
        l: [..., T, 2] positions in metres; leading axes broadcast against those of `k`.
        quantisation_factor: metres per step up to which, inclusive, a movement counts as 0.
        convention: see the module; `as_published` is `distance` here, which has no sides.

    Returns:
        [..., T-1, 2] int8 in {-1, 0, 1}.

    Raises:
        InputError: for an unknown convention.
    """
    _refuse_unknown(convention)
    ways = both_ways(k, l)
    return states_of([_approach(*way, quantisation_factor, convention) for way in ways])


def qtc_c1(
    k: ArrayLike,
    l: ArrayLike,  # noqa: E741
    *,
    quantisation_factor: ArrayLike = 0.0,
    convention: Convention = "distance",
    side_quantisation_factor: ArrayLike | None = None,
) -> Array:
    """QTC_C1 states (q1, q2, q3, q4) of the pair (k, l).

    Args:
        k: [..., T, 2] positions in metres.
        l: [..., T, 2] positions in metres; leading axes broadcast against those of `k`.
        quantisation_factor: metres per step up to which, inclusive, a movement counts as 0.
        convention: see the module.
        side_quantisation_factor: the same for q3 and q4, metres per step across the line; None
            is `quantisation_factor` in the `line` convention and 0 in the others.

    Returns:
        [..., T-1, 4] int8 in {-1, 0, 1}.

    Raises:
        InputError: for an unknown convention.
    """
    sides = side_factor(quantisation_factor, convention, side_quantisation_factor)
    ways = both_ways(k, l)
    return states_of(
        [_approach(*way, quantisation_factor, convention) for way in ways]
        + [_side(*way, sides, convention) for way in ways]
    )


def pairwise_qtc_c1(
    positions: ArrayLike,
    valid: ArrayLike | None = None,
    *,
    quantisation_factor: ArrayLike = 0.0,
    convention: Convention = "distance",
    side_quantisation_factor: ArrayLike | None = None,
) -> Array:
    """QTC_C1 states of every ordered pair of one scene.

    Args:
        positions: [N, T, 2] metres.
        valid: [N] bool, False for padding; None for no padding.
        quantisation_factor: as for `qtc_c1`.
        convention: as for `qtc_c1`.
        side_quantisation_factor: as for `qtc_c1`.

    Returns:
        [N, N, T-1, 4] int8; entry (i, j) has agent i as k and agent j as l. An agent with itself
        and pairs with an agent that is not valid are 0.
    """
    observe = functools.partial(
        qtc_c1,
        quantisation_factor=quantisation_factor,
        convention=convention,
        side_quantisation_factor=side_quantisation_factor,
    )
    return every_pair(observe, positions, valid)


def every_pair(
    observe: Callable[[Array, Array], Array], positions: ArrayLike, valid: ArrayLike | None
) -> Array:
    """`observe(k, l)` of every ordered pair of `positions [N, T, 2]`: [N, N, T-1, m] int8.

    0 of an agent with itself, and of pairs with one that is not `valid [N]`.
    """
    positions = jnp.asarray(positions)
    states = observe(positions[:, None], positions[None])
    others = other_pairs(valid, len(positions))
    return jnp.where(others[..., None, None], states, jnp.int8(0))


def pair_mask(valid: ArrayLike | None, count: int) -> Array:
    """[N, N] bool: pairs of valid agents, each with itself included; `valid` [N] or None."""
    if valid is None:
        return jnp.ones((count, count), bool)
    valid = jnp.asarray(valid)
    return valid[:, None] & valid[None]


def other_pairs(valid: ArrayLike | None, count: int) -> Array:
    """[N, N] bool: pairs of two valid agents; `valid` [N] or None."""
    return pair_mask(valid, count) & ~jnp.eye(count, dtype=bool)


def side_factor(
    quantisation_factor: ArrayLike, convention: str, given: ArrayLike | None
) -> ArrayLike:
    """The quantisation factor of q3 and q4 [...], see `qtc_c1`; `given` is it, or None.

    Raises:
        InputError: for an unknown convention.
    """
    _refuse_unknown(convention)
    if given is not None:
        return given
    return quantisation_factor if convention == "line" else 0.0


def _refuse_unknown(convention: str) -> None:
    if convention not in get_args(Convention):
        raise InputError(
            f"unknown QTC convention {convention!r}: there are {', '.join(get_args(Convention))}"
        )


def both_ways(k: ArrayLike, l: ArrayLike):  # noqa: E741
    """(Mover before, mover after, other before), each [T-1, ...], for k moving, then for l."""
    (k0, k1), (l0, l1) = frames(k, l)
    return (k0, k1, l0), (l0, l1, k0)


def frames(k: ArrayLike, l: ArrayLike):  # noqa: E741
    """The earlier and the later frame of every step of k, and of l [..., T, 2].

    Each as (x, y) of [T-1, ...]: steps come first so that what is computed of all pairs of a scene
    runs along agents, not along the few steps, which vectorises and takes a quarter of the time.
    """
    points = [jnp.asarray(each, jnp.result_type(each, 0.0)) for each in (k, l)]
    axes = max(each.ndim for each in points)
    found = []
    for each in points:
        each = each.reshape((1,) * (axes - each.ndim) + each.shape)
        x, y = jnp.moveaxis(each, (-1, -2), (0, 1))
        found.append(((x[:-1], y[:-1]), (x[1:], y[1:])))
    return found


def states_of(symbols: Sequence[Array]) -> Array:
    """States [..., T-1, m] of m symbols [T-1, ...]."""
    return jnp.moveaxis(jnp.stack(symbols), (0, 1), (-1, -2))


def _approach(before, after, other, factor: ArrayLike, convention: str) -> Array:
    """q1 if `before` and `after` are k's positions and `other` is l's, as int8."""
    (x0, y0), (x1, y1), (x, y) = before, after, other
    if convention == "line":
        line_x, line_y = x - x0, y - y0
        threshold = factor * length(line_x, line_y)
        return compare(-(x1 - x0) * line_x, (y1 - y0) * line_y, threshold)
    return compare(length(x1 - x, y1 - y), length(x0 - x, y0 - y), factor)


def _side(before, after, other, factor: ArrayLike, convention: str) -> Array:
    """q3 if `before` and `after` are k's positions and `other` is l's, as int8."""
    (x0, y0), (x1, y1), (x, y) = before, after, other
    line_x, line_y = x - x0, y - y0
    threshold = factor * length(line_x, line_y)
    side = compare((x1 - x0) * line_y, (y1 - y0) * line_x, threshold)
    return abs(side) if convention == "as_published" else side


def compare(a: Array, b: Array, threshold: ArrayLike) -> Array:
    """Sign of a - b [...] where it exceeds the threshold, else 0, as int8.

    Sums are compared instead of a difference because compilers fuse `p*q - r*s` into a multiply-add
    of higher precision in one product only, and two equal products then differ by a rounding error:
    exact ties, such as everyone walking on the same line, would be lost.
    """
    return (a > b + threshold).astype(jnp.int8) - (b > a + threshold).astype(jnp.int8)


def length(x: Array, y: Array) -> Array:
    """[...] length of (x, y)."""
    return jnp.sqrt(x * x + y * y)
