"""Qualitative Trajectory Calculus (QTC): the signs of how two points move relative to each other.

A state of the pair (k, l) describes one step, from one frame to the next, by these symbols:

- q1: k moves towards l (-), away from l (+), or neither (0);
- q2: l moves towards k (-), away from k (+), or neither (0);
- q3: k moves to the left (-) or right (+) of the line from k to l, or along it (0);
- q4: l moves to the left (-) or right (+) of the line from l to k, or along it (0);
- q5: k's step is shorter (-) or longer (+) than l's, or as long (0);
- q6: k's step makes a smaller (-) or larger (+) angle, of 0 to 90 degrees, with the line through
  k and l than l's step, or the same (0).

Van de Weghe, "Representing and Reasoning about Moving Objects: A Qualitative Approach" (2004);
Delafontaine, Cohn, Van de Weghe, "Implementing a qualitative calculus to analyse moving point
objects" (2011). Three conventions for q1 to q4 are in use:

- `distance` (the papers, and NeuroSyM: Mghames et al., 2023): q1 is the sign of
  |k1 - l0| - |k0 - l0|. The quantisation factor applies to q1 and q2 only, unless a
  `side_quantisation_factor` is given.
- `line` (QSRlib): q1 is the sign of the displacement's component along the line from l0 to k0, so
  passing someone at a right angle is 0, not +. The quantisation factor applies to all symbols.
- `as_published` (NeuroSyM's released code): as `distance`, but the sides are unsigned: any movement
  off the line is +, and no side is ever -.

Both agents are taken at t-1, so T frames give T-1 states. Symbols are piecewise constant, so no
gradient passes through them; `soft` has differentiable ones.
"""

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.states import ABSENT

__all__ = [
    "Convention",
    "Thresholds",
    "absent_when_apart",
    "implied_angle",
    "implied_speed",
    "observe_symbols",
    "other_pairs",
    "side_factor",
    "ways",
]

Convention = Literal["distance", "line", "as_published"]


class Thresholds(NamedTuple):
    """Where movements, angles and distances begin to count; inclusive, and may be traced."""

    quantisation_factor: ArrayLike = 0.0
    """Metres per step up to which q1, q2 and q5 are 0."""
    side_quantisation_factor: ArrayLike | None = None
    """Metres per step across the line up to which q3 and q4 are 0; None is `quantisation_factor`
    in the `line` convention and 0 in the others."""
    angle: ArrayLike = 0.0
    """Radians up to which two angles are equal (q6)."""
    near: ArrayLike = 1.22
    """Metres between k and l, at the end of a step, up to which QTC_BC has sides."""
    apart: ArrayLike | None = None
    """Metres beyond which QTC_BC has no sides; in between a pair keeps what it had, and starts
    without. None is `near`."""


def observe_symbols(
    names: Sequence[str], k: ArrayLike, l: ArrayLike, convention: Convention, given: Thresholds
) -> Array:
    """Symbols of the pair (k, l), of any of q1 to q6.

    Where q1 to q4 are all asked for, they decide q5 and q6 as far as they leave no choice, so that
    thresholds cannot make an impossible state: an agent without movement towards, away or to a side
    stands, and is the slower.

    Args:
        names: of m symbols, in order.
        k: [..., T, 2] metres.
        l: [..., T, 2] metres; leading axes broadcast.
        convention: see the module.
        given: thresholds.

    Returns:
        [..., T-1, m] int8 in {-1, 0, 1}.
    """
    sides = side_factor(given.quantisation_factor, convention, given.side_quantisation_factor)
    pair = ways(k, l)
    symbols: dict[str, Array] = {}
    for place, way in enumerate(pair):
        if f"q{place + 1}" in names:
            symbols[f"q{place + 1}"] = _approach(*way, given.quantisation_factor, convention)
        if f"q{place + 3}" in names:
            symbols[f"q{place + 3}"] = _side(*way, sides, convention)
    first = [symbols[name] for name in ("q1", "q2", "q3", "q4") if name in symbols]
    if "q5" in names:
        of_k, of_l = (length(x1 - x0, y1 - y0) for (x0, y0), (x1, y1), _ in pair)
        symbols["q5"] = compare(of_k, of_l, given.quantisation_factor)
        if len(first) == 4:
            symbols["q5"] = _unless(implied_speed(*first), symbols["q5"])
    if "q6" in names:
        symbols["q6"] = _unless(implied_angle(*first), _angle(pair, given.angle))
    return jnp.moveaxis(jnp.stack([symbols[name] for name in names]), (0, 1), (-1, -2))


def absent_when_apart(states: Array, k: ArrayLike, l: ArrayLike, given: Thresholds) -> Array:
    """`states [..., T-1, m]` with `ABSENT` for q3 and q4 while k and l [..., T, 2] are apart."""
    (_, (x, y), _), (_, (other_x, other_y), _) = ways(k, l)
    distance = length(x - other_x, y - other_y)
    joins = distance <= given.near
    parts = distance > (given.near if given.apart is None else given.apart)
    # The last step at which the distance decided, -1 if none has.
    step = jnp.arange(len(distance)).reshape(-1, *[1] * (distance.ndim - 1))
    decided = jax.lax.cummax(jnp.where(joins | parts, step, -1))
    newest = jnp.take_along_axis(joins, jnp.maximum(decided, 0), axis=0)
    apart = jnp.moveaxis(~(newest & (decided >= 0)), 0, -1)
    sides = jnp.where(apart[..., None], ABSENT, states[..., 2:4])
    return jnp.concatenate([states[..., :2], sides, states[..., 4:]], axis=-1)


def other_pairs(valid: ArrayLike | None, count: int) -> Array:
    """[N, N] bool: pairs of two different agents, both `valid` [N]; None is all valid."""
    others = ~jnp.eye(count, dtype=bool)
    if valid is None:
        return others
    valid = jnp.asarray(valid)
    return others & valid[:, None] & valid[None]


def side_factor(
    quantisation_factor: ArrayLike, convention: str, given: ArrayLike | None
) -> ArrayLike:
    """The quantisation factor [] of q3 and q4 (see `Thresholds`), from the one given.

    Raises:
        InputError: for an unknown convention.
    """
    if convention not in get_args(Convention):
        raise InputError(
            f"unknown QTC convention {convention!r}: there are {', '.join(get_args(Convention))}"
        )
    if given is not None:
        return given
    return quantisation_factor if convention == "line" else 0.0


def ways(k: ArrayLike, l: ArrayLike) -> list[tuple[Any, Any, Any]]:
    """(Mover before, mover after, other before) of k [..., T, 2] moving, then of l.

    Each is (x, y) of [T-1, ...]: with steps first, all pairs of a scene are computed along agents
    and not along the few steps, which vectorises and takes a quarter of the time.
    """
    points = [jnp.asarray(each, jnp.result_type(each, 0.0)) for each in (k, l)]
    axes = max(each.ndim for each in points)
    frames = []
    for each in points:
        each = each.reshape((1,) * (axes - each.ndim) + each.shape)
        x, y = jnp.moveaxis(each, (-1, -2), (0, 1))
        frames.append(((x[:-1], y[:-1]), (x[1:], y[1:])))
    (k0, k1), (l0, l1) = frames
    return [(k0, k1, l0), (l0, l1, k0)]


def _approach(before: Any, after: Any, other: Any, factor: ArrayLike, convention: str) -> Array:
    """q1 if the mover is k."""
    (x0, y0), (x1, y1), (x, y) = before, after, other
    if convention == "line":
        line_x, line_y = x - x0, y - y0
        threshold = factor * length(line_x, line_y)
        return compare(-(x1 - x0) * line_x, (y1 - y0) * line_y, threshold)
    return compare(length(x1 - x, y1 - y), length(x0 - x, y0 - y), factor)


def _side(before: Any, after: Any, other: Any, factor: ArrayLike, convention: str) -> Array:
    """q3 if the mover is k."""
    (x0, y0), (x1, y1), (x, y) = before, after, other
    line_x, line_y = x - x0, y - y0
    threshold = factor * length(line_x, line_y)
    side = compare((x1 - x0) * line_y, (y1 - y0) * line_x, threshold)
    return abs(side) if convention == "as_published" else side


def _angle(pair: list[tuple[Any, Any, Any]], threshold: ArrayLike) -> Array:
    """q6 where both move, by sin(a - b) = sin a cos b - cos a sin b, times the lengths."""
    (kx, ky), _, (lx, ly) = pair[0]
    line = lx - kx, ly - ky
    across, along, steps = [], [], []
    for (x0, y0), (x1, y1), _ in pair:
        x, y = x1 - x0, y1 - y0
        across.append(abs(x * line[1] - y * line[0]))
        along.append(abs(x * line[0] + y * line[1]))
        steps.append(length(x, y))
    square = line[0] * line[0] + line[1] * line[1]
    scaled = jnp.sin(threshold) * steps[0] * steps[1] * square
    return compare(across[0] * along[1], across[1] * along[0], scaled)


def compare(a: Array, b: Array, threshold: ArrayLike) -> Array:
    """Sign of a - b [...] where it exceeds the threshold, else 0, as int8.

    Sums are compared instead of a difference because compilers fuse `p*q - r*s` into a multiply-add
    that rounds one product only. Two equal products would then differ by a rounding error, and
    exact ties, such as all agents walking on one line, would be lost.
    """
    return (a > b + threshold).astype(jnp.int8) - (b > a + threshold).astype(jnp.int8)


def length(x: Array, y: Array) -> Array:
    """[...] length of (x, y), that of (y, x) even if a compiler fuses a product and the sum."""
    long, short = jnp.maximum(abs(x), abs(y)), jnp.minimum(abs(x), abs(y))
    return jnp.sqrt(long * long + short * short)


# What q1 to q4 imply, for arrays of numpy and of jax alike.


def implied_speed(q1: Any, q2: Any, q3: Any, q4: Any) -> tuple[Any, Any]:
    """Whether q1 to q4 decide q5, and its value: who stands is the slower, unless both do."""
    k_stands, l_stands = (q1 == 0) & (q3 == 0), (q2 == 0) & (q4 == 0)
    return k_stands | l_stands, l_stands * 1 - k_stands * 1


def implied_angle(q1: Any, q2: Any, q3: Any, q4: Any) -> tuple[Any, Any]:
    """Whether q1 to q4 decide q6, and its value; it is 0 if an agent stands.

    An angle is 0 without sideways movement and a right one without approach.
    """
    stands, _ = implied_speed(q1, q2, q3, q4)
    of_k, of_l = (q1 == 0) * 1 - (q3 == 0) * 1, (q2 == 0) * 1 - (q4 == 0) * 1
    known = (of_k != 0) | (of_l != 0)
    # Two right angles, and two of 0, are equal; with one of them the other is in between.
    return stands | known, ((of_k > of_l) * 1 - (of_k < of_l) * 1) * ~stands


def _unless(implied: tuple[Any, Any], symbol: Array) -> Array:
    decided, value = implied
    return jnp.where(decided, value.astype(jnp.int8), symbol)
