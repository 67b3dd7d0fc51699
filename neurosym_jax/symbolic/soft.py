"""Differentiable QTC: how probable each symbol and state is, and what alpha is to be expected then.

A hard symbol (`qtc`) compares a margin d, metres that a step leads away from the other agent or to
the right of the line to it, with a threshold q. A soft one blurs the comparison by a logistic error
of scale `temperature`, T:

    p(+) = sigmoid((d - q) / T),    p(-) = sigmoid((-d - q) / T),    p(0) = 1 - p(+) - p(-)

As T goes to 0 the hard symbol gets probability 1, at a tie as well where q > 0; with q = 0 no
symbol is ever 0 and a tie is half -, half +. Margins along and across the line are lengths divided
by the pair's distance; within T of each other there is no line, and they are divided by T instead,
so that nothing jumps where two agents meet. Norms have gradient 0 where they are 0. So values and
gradients are finite everywhere, and outside of that distance each symbol is the hard one wherever
its margin lies ten temperatures from the threshold (probability > 0.9999).

The relative speed q5 has the difference of the steps' lengths as its margin; q6 and QTC_BC, which
compare angles and distances, have no soft form. Symbols are taken as independent. This is neither
the hard calculus, nor which weighting a model has (see `weighting`).
"""

from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.calculi import CALCULI, all_states
from neurosym_jax.symbolic.qtc import Convention, both_ways, qtc_c1, side_factor

__all__ = ["soft_alpha", "soft_qtc_c1", "soft_symbols", "state_probabilities"]


def soft_qtc_c1(
    k: ArrayLike,
    l: ArrayLike,  # noqa: E741 (the calculus calls the two points k and l)
    *,
    temperature: ArrayLike,
    quantisation_factor: ArrayLike = 0.0,
    convention: Convention = "distance",
    side_quantisation_factor: ArrayLike | None = None,
    straight_through: bool = False,
) -> Array:
    """Probabilities of the symbols of the pair (k, l); everything may be differentiated.

    Args:
        k: [..., T, 2] positions in metres.
        l: [..., T, 2] positions in metres; leading axes broadcast against those of `k`.
        temperature: metres per step, > 0.
        quantisation_factor: as for `qtc.qtc_c1`.
        convention: as for `qtc.qtc_c1`.
        side_quantisation_factor: as for `qtc.qtc_c1`.
        straight_through: give the hard symbols probability 1, with the gradients of the soft ones.

    Returns:
        [..., T-1, 4, 3] probabilities of (-, 0, +) for q1 to q4.
    """
    sides = side_factor(quantisation_factor, convention, side_quantisation_factor)
    ways = both_ways(k, l)
    approach = [_approach(*way, temperature, convention) for way in ways]
    beside = [_side(*way, temperature) for way in ways]
    soft = jnp.stack(
        [_probabilities(margin, quantisation_factor, temperature) for margin in approach]
        + [_probabilities(margin, sides, temperature) for margin in beside],
        axis=-2,
    )
    if convention == "as_published":
        # Its sides are never -: what would be is +.
        folded = jnp.stack(
            [jnp.zeros_like(soft[..., 0]), soft[..., 1], soft[..., 0] + soft[..., 2]], axis=-1
        )
        soft = jnp.concatenate([soft[..., :2, :], folded[..., 2:, :]], axis=-2)
    if not straight_through:
        return soft
    states = qtc_c1(
        k,
        l,
        quantisation_factor=quantisation_factor,
        convention=convention,
        side_quantisation_factor=side_quantisation_factor,
    )
    return jax.nn.one_hot(states + 1, 3, dtype=soft.dtype) + (soft - jax.lax.stop_gradient(soft))


def soft_symbols(
    calculus: str,
    k: ArrayLike,
    l: ArrayLike,  # noqa: E741
    *,
    temperature: ArrayLike,
    quantisation_factor: ArrayLike = 0.0,
    convention: Convention = "distance",
    side_quantisation_factor: ArrayLike | None = None,
) -> Array:
    """Probabilities of the symbols of a calculus; arguments as of `soft_qtc_c1`.

    Returns:
        [..., T-1, m, 3] probabilities of (-, 0, +) for each symbol.

    Raises:
        InputError: for an unknown calculus, or one that has other symbols than q1 to q5.
    """
    value, known = CALCULI[calculus], ("q1", "q2", "q3", "q4", "q5")
    if value.optional or not set(value.symbols) <= set(known):
        raise InputError(f"the calculus {calculus!r} has no soft form: {', '.join(value.symbols)}")
    positions = soft_qtc_c1(
        k,
        l,
        temperature=temperature,
        quantisation_factor=quantisation_factor,
        convention=convention,
        side_quantisation_factor=side_quantisation_factor,
    )
    speeds = [_length(x1 - x0, y1 - y0) for (x0, y0), (x1, y1), _ in both_ways(k, l)]
    speed = _probabilities(speeds[0] - speeds[1], quantisation_factor, temperature)
    every = jnp.concatenate([positions, speed[..., None, :]], axis=-2)
    return every[..., jnp.array([known.index(name) for name in value.symbols]), :]


def state_probabilities(calculus: str, probabilities: ArrayLike) -> Array:
    """How probable each state is if the symbols are independent, but for those that others force.

    Of a state in which k stands, say, q5 is given by q1 to q4, as in the hard calculus.

    Args:
        calculus: its name.
        probabilities: [..., m, 3] of (-, 0, +) for each symbol, see `soft_symbols`.

    Returns:
        [..., S] in the order of `cnd.states(calculus)`, adding up to 1.

    Raises:
        InputError: for an unknown calculus, or one whose symbols can be absent.
    """
    value, probabilities = CALCULI[calculus], jnp.asarray(probabilities)
    if value.optional:
        raise InputError(f"the calculus {calculus!r} has no soft form: symbols can be absent")
    states = all_states(value).astype(int)
    joint = jnp.ones((), probabilities.dtype)
    alike = np.ones((len(states), len(states)), bool)
    for symbol, of_states in enumerate(states.T):
        equal = of_states[:, None] == of_states
        # Where no state with the same symbols before has another one here, it is forced.
        forced = ~(alike & ~equal).any(axis=1)
        joint = joint * jnp.where(forced, 1, probabilities[..., symbol, of_states + 1])
        alike &= equal
    return joint


def soft_alpha(
    probabilities: ArrayLike, table: Literal["cnd", "cnd_shipped"] | ArrayLike = "cnd"
) -> Array:
    """The expected weight of a state whose symbols are independent.

    Both named tables look at the number of zeros alone. `cnd_shipped`, 1 / (2^nonzero 3^zero), is
    a product over symbols, and so is its expectation: prod (1/2 - p0 / 6). For `cnd` the
    distribution of the number of zeros is made, symbol by symbol.

    Args:
        probabilities: [..., 4, 3] of (-, 0, +), see `soft_qtc_c1`.
        table: a name, or [81] weights by state code.

    Returns:
        [...] weights.
    """
    probabilities = jnp.asarray(probabilities)
    if isinstance(table, str):
        zero = probabilities[..., 1]
        if table == "cnd_shipped":
            return jnp.prod(1 / 2 - zero / 6, axis=-1)
        return _expected_by_zeros(zero)
    q1, q2, q3, q4 = jnp.moveaxis(probabilities, -2, 0)
    approaches, sides = _both(q1, q2), _both(q3, q4)
    weights = jnp.asarray(table, probabilities.dtype).reshape(9, 9)
    return (approaches @ weights * sides).sum(axis=-1)


def _both(first: Array, second: Array) -> Array:
    """[..., 9] probabilities of two symbols from [..., 3] of each."""
    return (first[..., :, None] * second[..., None, :]).reshape(*first.shape[:-1], 9)


def _expected_by_zeros(zero: Array) -> Array:
    """[...] of `cnd`: 1 / (3^z + 2^(4-z) - 2) for z zeros, from p(0) of each symbol [..., 4]."""
    # count[z]: the probability of z zeros among the symbols so far.
    count = [jnp.ones_like(zero[..., 0])]
    for symbol in range(4):
        p = zero[..., symbol]
        stay, more = [of * (1 - p) for of in count], [of * p for of in count]
        count = [stay[0], *(a + b for a, b in zip(stay[1:], more)), more[-1]]
    return sum((of / (3**z + 2 ** (4 - z) - 2) for z, of in enumerate(count)), jnp.zeros(()))


def _probabilities(margin: Array, factor: ArrayLike, temperature: ArrayLike) -> Array:
    """[..., T-1, 3] of (-, 0, +) from a margin [T-1, ...], steps first as in `qtc.frames`."""
    margin = jnp.moveaxis(margin, 0, -1)
    not_plus = jax.nn.sigmoid((factor - margin) / temperature)
    not_minus = jax.nn.sigmoid((factor + margin) / temperature)
    # 1 - p(+) - p(-) without the cancellation: exactly 0 where the factor is.
    zero = not_plus * not_minus * -jnp.expm1(-2 * factor / temperature)
    return jnp.stack([1 - not_minus, zero, 1 - not_plus], axis=-1)


def _approach(before, after, other, temperature: ArrayLike, convention: str) -> Array:
    """Metres away from `other`, of q1 if the positions are k's and `other` is l's."""
    (x0, y0), (x1, y1), (x, y) = before, after, other
    if convention == "line":
        away = -((x1 - x0) * (x - x0) + (y1 - y0) * (y - y0))
        return away / jnp.maximum(_length(x - x0, y - y0), temperature)
    return _length(x1 - x, y1 - y) - _length(x0 - x, y0 - y)


def _side(before, after, other, temperature: ArrayLike) -> Array:
    """Metres to the right of the line to `other`, of q3."""
    (x0, y0), (x1, y1), (x, y) = before, after, other
    right = (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
    return right / jnp.maximum(_length(x - x0, y - y0), temperature)


def _length(x: Array, y: Array) -> Array:
    """The norm, with gradient 0 where it is 0."""
    square = x * x + y * y
    stands = square == 0
    return jnp.where(stands, 0, jnp.sqrt(jnp.where(stands, 1, square)))
