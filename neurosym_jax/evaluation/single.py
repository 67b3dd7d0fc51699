"""Errors of the one forecast that somebody would act on who can take but one.

That is the most central of the k samples, or the forecast of a model without noise.
"""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from neurosym_jax.evaluation.best_of_k import distances
from neurosym_jax.evaluation.distribution import apart
from neurosym_jax.evaluation.metric import Metric

__all__ = ["METRICS"]

Errors = Callable[[Array], Array]


def _of(error: Errors) -> Callable[[Array, Array, Array], tuple[Array, Array]]:
    def compute(forecast: Array, future: Array, valid: Array) -> tuple[Array, Array]:
        # The medoid: the sample of the whole scene with the least mean distance to the others.
        spread = jnp.where(valid[:, None], apart(forecast), 0).sum(axis=(1, 2))
        errors = error(distances(forecast, future, valid))
        return errors[spread.argmin()].sum(), valid.sum()

    return compute


def _ade(errors: Array) -> Array:
    return errors.mean(axis=-1)


def _fde(errors: Array) -> Array:
    return errors[..., -1]


_CENTRAL = "central: the one sample of the scene that is nearest to the others"
_NOISE_FREE = "noise-free: the forecast for a noise of zero"

METRICS = tuple(
    Metric(
        f"{title.replace('-', '_')}_{name}",
        f"{title} {name.upper()}",
        "m",
        _of(error),
        about,
        by_default=False,
        noise_free=noise_free,
    )
    for title, noise_free, about in (
        ("central", False, _CENTRAL),
        ("noise-free", True, _NOISE_FREE),
    )
    for error, name in ((_ade, "ade"), (_fde, "fde"))
)
