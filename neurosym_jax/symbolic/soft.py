"""Differentiable QTC_C1: the probability of each symbol, and the expected alpha.

A hard symbol (`qtc`) compares a margin d, metres that a step leads away from the other
agent or to the right of the line to it, with a threshold q. A soft one blurs the
comparison by a logistic error of scale `temperature`, T:

    p(+) = sigmoid((d - q) / T),    p(-) = sigmoid((-d - q) / T),    p(0) = 1 - p(+) - p(-)

As T goes to 0 the hard symbol gets probability 1, at a tie as well where q > 0; with q
= 0 no symbol is ever 0 and a tie is half -, half +. Margins along and across the line
are lengths divided by the pair's distance; within T of each other there is no line, and
they are divided by T instead, so that nothing jumps where two agents meet. Norms have
gradient 0 where they are 0. So values and gradients are finite everywhere, and outside
of that distance each symbol is the hard one wherever its margin lies ten temperatures
from the threshold (probability > 0.9999).

Symbols are taken as independent. Where a position is not there (NaN) no symbol has a
probability, so the expected alpha is 0, and gradients through it are 0.
"""

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import NotNegative, Positive
from neurosym_jax.errors import InputError
from neurosym_jax.runtime.programs import full_precision
from neurosym_jax.symbolic.qtc import (
    Convention,
    absent_steps,
    comparisons,
    observe,
    refuse_known,
    refuse_other_pair,
    side_factor,
)

__all__ = ["safe_root", "soft_alpha", "soft_symbols"]


def soft_symbols(
    k: ArrayLike,
    l: ArrayLike,
    *,
    temperature: ArrayLike,
    quantisation_factor: ArrayLike = 0.0,
    side_quantisation_factor: ArrayLike | None = None,
    convention: Convention = "distance",
    straight_through: bool = False,
) -> Array:
    """Probabilities [..., T-1, 4, 3] of (-, 0, +) for each QTC_C1 symbol of the pair (k, l).

    Positions [..., T, 2] and the other arguments are those of `qtc.observe`;
    `temperature` is in metres per step, > 0. The probabilities are differentiable in
    every array. `straight_through` gives the hard symbols probability 1, with the
    gradients of the soft ones.

    Raises:
        InputError: for positions of other shapes, a factor below 0, and a temperature
            that is not positive, where these are not traced.
    """
    refuse_other_pair(k, l)
    refuse_known(Positive, {"temperature": temperature})
    refuse_known(NotNegative, {"quantisation_factor": quantisation_factor})
    side = side_factor(quantisation_factor, convention, side_quantisation_factor)
    thresholds = (quantisation_factor, quantisation_factor, side, side)
    symbols = []
    points = [jnp.asarray(point, jnp.result_type(point, 0.0)) for point in (k, l)]
    # Filled, so that gradients of what is absent are 0.
    first, second = (jnp.where(jnp.isnan(point), 0, point) for point in points)

    def length(x: Array, y: Array) -> Array:
        return safe_root(x * x + y * y)

    compared = comparisons(first, second, convention, length)
    for (a, b, scale), threshold in zip(compared, thresholds):
        margin = a - b
        if scale is not None:
            margin = margin / jnp.maximum(scale, temperature)
        symbols.append(_probabilities(margin, threshold, temperature))
    soft = jnp.stack(symbols, axis=-2)
    if convention == "as_published":  # Its sides are never -: what would be is +.
        minus, zero, plus = jnp.moveaxis(soft[..., 2:, :], -1, 0)
        folded = jnp.stack([jnp.zeros_like(minus), zero, minus + plus], axis=-1)
        soft = jnp.concatenate([soft[..., :2, :], folded], axis=-2)
    soft = jnp.where(absent_steps(k, l)[..., None, None], 0, soft)
    if not straight_through:
        return soft
    hard = observe(
        k,
        l,
        "c1",
        convention=convention,
        quantisation_factor=quantisation_factor,
        side_quantisation_factor=side,
    )
    hard = jax.nn.one_hot(hard + 1, 3, dtype=soft.dtype)
    nothing = soft - jax.lax.stop_gradient(soft)  # It has the gradients.
    return hard + nothing


@full_precision
def soft_alpha(probabilities: ArrayLike, table: ArrayLike | None = None) -> Array:
    """Expected weights [...] of QTC_C1 states with independent symbols, see `soft_symbols`.

    `table` has [81] weights by state code; None is `cnd`, which depends on the number
    of zeros alone. Its expectation is then built symbol by symbol, to the same bits in
    any shape.

    Raises:
        InputError: for arrays of other shapes, such as hard states.
    """
    probabilities = jnp.asarray(probabilities)
    if probabilities.shape[-2:] != (4, 3):
        shape = list(probabilities.shape)
        raise InputError(f"probabilities must be [..., 4, 3] of symbols, not {shape}")
    if table is not None and jnp.size(table) != 81:
        raise InputError(f"table must be [81], not {list(jnp.shape(table))}")
    if table is None:
        present = (probabilities > 0).any(axis=(-1, -2))
        expected = _expected_by_zeros(probabilities[..., 1])
        return jnp.where(present, expected, 0)
    weights = jnp.asarray(table, probabilities.dtype).reshape(9, 9)
    q1, q2, q3, q4 = jnp.moveaxis(probabilities, -2, 0)
    weight_of_sides = _both(q1, q2) @ weights
    return (weight_of_sides * _both(q3, q4)).sum(axis=-1)


def _both(first: Array, second: Array) -> Array:
    """[..., 9] joint probabilities of two symbols from [..., 3] of each."""
    table = first[..., :, None] * second[..., None, :]
    return table.reshape(*first.shape[:-1], 9)


def _expected_by_zeros(zero: Array) -> Array:
    """[...] of `cnd`: 1 / (3^z + 2^(4-z) - 2) for z zeros, from p(0) of each symbol [..., 4]."""
    # count[z]: the probability of z zeros among the symbols so far.
    count = [jnp.ones_like(zero[..., 0])]
    for symbol in range(4):
        p = zero[..., symbol]
        others = [share * (1 - p) for share in count]
        zeros = [share * p for share in count]
        count = [others[0], *map(jnp.add, others[1:], zeros), zeros[-1]]
    expected = jnp.zeros(())
    for z, share in enumerate(count):
        expected = expected + share / (3**z + 2 ** (4 - z) - 2)
    return expected


def _probabilities(margin: Array, factor: ArrayLike, temperature: ArrayLike) -> Array:
    """[..., T-1, 3] of (-, 0, +) from a margin [T-1, ...], steps first as in `qtc.comparisons`."""
    margin = jnp.moveaxis(margin, 0, -1)
    not_plus = jax.nn.sigmoid((factor - margin) / temperature)
    not_minus = jax.nn.sigmoid((factor + margin) / temperature)
    # 1 - p(+) - p(-) without the cancellation: exactly 0 where the factor is.
    zero = not_plus * not_minus * -jnp.expm1(-2 * factor / temperature)
    return jnp.stack([1 - not_minus, zero, 1 - not_plus], axis=-1)


def safe_root(square: Array) -> Array:
    """[...] square root of `square` [...], its gradient zero at zero; NaN stays NaN."""
    zero = square == 0
    root = jnp.sqrt(jnp.where(zero, 1, square))
    return jnp.where(zero, 0, root)
