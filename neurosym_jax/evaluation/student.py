"""Student's t by formula: SciPy, which has it, takes a quarter of a second to import."""

import functools
import math

__all__ = ["half_interval", "two_sided_p"]

NORMAL = 1.959963984540054
"""Half of the 95 % interval of a standard normal variable."""


def two_sided_p(t: float, freedom: float) -> float:
    """Two-sided p value of Student's t, with any positive number of degrees of freedom.

    The regularised incomplete beta function I_x(freedom / 2, 1 / 2) at x = freedom /
    (freedom + t^2), see section 26.7 of Abramowitz and Stegun. NaN where the freedom is
    not known.
    """
    if not freedom > 0 or math.isnan(t):
        return math.nan
    if math.isinf(freedom):
        return math.erfc(abs(t) / math.sqrt(2))
    a = freedom / 2
    b = 0.5
    x = freedom / (freedom + t * t)
    if x in (0.0, 1.0):
        return x
    scale = math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    front = math.exp(scale + a * math.log(x) + b * math.log1p(-x))
    # The fraction converges fast on this side; the other side is its complement.
    if x < (a + 1) / (a + b + 2):
        return front * _beta_fraction(a, b, x) / a
    return 1 - front * _beta_fraction(b, a, 1 - x) / b


def _beta_fraction(a: float, b: float, x: float) -> float:
    """The continued fraction of the incomplete beta function, 26.5.8 there, by Lentz's method."""
    ratio = 1.0
    inverse = 1 / (1 - (a + b) * x / (a + 1))
    value, step = inverse, 0
    change = math.inf
    while abs(change - 1) > 1e-15 and step < 100_000:
        step += 1
        end = a + 2 * step
        even = step * (b - step) * x / ((end - 1) * end)
        odd = -(a + step) * (a + b + step) * x / (end * (end + 1))
        for numerator in (even, odd):
            inverse = 1 / (1 + numerator * inverse)
            ratio = 1 + numerator / ratio
            change = ratio * inverse
            value *= change
    return value


@functools.cache
def half_interval(freedom: float) -> float:
    """Half of the 95 % interval of Student's t: its two-sided p value is 0.05."""
    if not freedom > 0:
        return math.nan
    if math.isinf(freedom):
        return NORMAL
    scale = math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2)
    scale -= math.log(freedom * math.pi) / 2
    # Tails are heavier than a normal variable's, and p is convex: Newton's method comes
    # from below.
    half, step = NORMAL, math.inf
    while abs(step) > 1e-14 * half:
        power = (freedom + 1) / 2 * math.log1p(half * half / freedom)
        density = math.exp(scale - power)
        step = (two_sided_p(half, freedom) - 0.05) / (2 * density)
        # Beside the root the sign of what is left is rounding.
        if step <= 0:
            break
        half += step
    return half
