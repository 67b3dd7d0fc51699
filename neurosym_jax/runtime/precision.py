"""Products of matrices with all bits of float32, on every device.

By default a GPU or TPU multiplies float32 matrices in fewer bits: TF32 keeps 10 of 23.
That moves forecasts by millimetres, and would end the agreement with torch.
"""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax

__all__ = ["full_precision"]

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def full_precision(
    function: Callable[Arguments, Result],
) -> Callable[Arguments, Result]:
    """Make a function whose products of matrices keep all bits.

    Whoever sets `JAX_DEFAULT_MATMUL_PRECISION` or `jax.default_matmul_precision` gets
    what they set.
    """

    @functools.wraps(function)
    def with_all_bits(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        if jax.default_matmul_precision.value is not None:
            return function(*args, **kwargs)
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return with_all_bits
