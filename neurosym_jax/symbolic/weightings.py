"""The table of weightings, and how a plugin adds one (`register_weighting`)."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import component_from_text
from neurosym_jax.plugins import Registry
from neurosym_jax.symbolic.state_weightings import (
    Cnd,
    CndShipped,
    Learned,
    Quantised,
    Shuffled,
    Soft,
)
from neurosym_jax.symbolic.weighting import Parameters, Weighting, initial_parameters

__all__ = ["WEIGHTINGS", "Ones", "Zeros", "make_weighting", "register_weighting"]


@dataclasses.dataclass(frozen=True)
class Ones(Weighting):
    """1 for every pair at every step, observed or not: the neural part alone."""

    title = "ones"

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        return jnp.ones((positions.shape[0], *positions.shape[:2]), positions.dtype)


@dataclasses.dataclass(frozen=True)
class Zeros(Weighting):
    """0 for every pair, except of an agent for itself.

    The released training had these weights with the authors' table, because its reader took the
    first character of a label such as `0.0625`.
    """

    title = "zeros"

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        return jnp.zeros((positions.shape[0], *positions.shape[:2]), positions.dtype)


BUILT_IN = (Cnd, CndShipped, Quantised, Soft, Learned, Ones, Zeros, Shuffled)

WEIGHTINGS: Registry[type[Weighting]] = Registry(
    "weighting", {each.title: each for each in BUILT_IN}
)


class FunctionWeighting(Weighting):
    """A weighting by a function `(positions [N, T, 2], valid [N], **parameters) -> [N, N, T]`."""

    function: ClassVar[Callable[..., Array]]
    initial: ClassVar[Mapping[str, Any]]

    def start(self) -> Parameters:
        """The parameters that `register_weighting` was given."""
        return self.initial

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        present = jnp.ones(positions.shape[0], bool) if valid is None else jnp.asarray(valid)
        return type(self).function(positions, present, **parameters)

    def __reduce__(self):
        # Its class is in no module: another process finds it by its name.
        return _registered, (self.title,)


def _registered(name: str) -> Weighting:
    return WEIGHTINGS[name]()


def register_weighting(name: str, *, replace: bool = False, **start: Any) -> Callable[[Any], Any]:
    """Register the decorated function or class as a weighting.

    A function is `(positions [N, T, 2], valid [N], **parameters) -> alpha [N, N, T]`; a class is a
    `Weighting`, a frozen dataclass whose fields are its options. Weights of an agent for itself, in
    padding and alone are set afterwards (`Weighting.alpha`).

    `start` are initial values of a function's learnable parameters; `replace` replaces another
    weighting of this name.
    """

    def register(weighting: Any) -> Any:
        found = weighting
        if not isinstance(weighting, type):
            own = {"function": staticmethod(weighting), "initial": start}
            found = type(name, (FunctionWeighting,), own)
        WEIGHTINGS.register(name, found, replace=replace)
        found.title = name
        return weighting

    return register


def make_weighting(
    weighting: Weighting | str = "cnd", parameters: Parameters | None = None
) -> Callable[..., Array]:
    """A function `(positions [N, T, 2], valid [N] or None) -> alpha [N, N, T]`, see `alpha`.

    `weighting` is an instance, or text such as `soft,temperature=0.05`; `parameters` are trained
    ones, by default the initial ones.
    """
    chosen: Weighting = (
        component_from_text(weighting, WEIGHTINGS, "weighting")
        if isinstance(weighting, str)
        else weighting
    )
    given = initial_parameters(chosen) if parameters is None else parameters

    def weigh(positions: ArrayLike, valid: ArrayLike | None = None) -> Array:
        return chosen.alpha(given, positions, valid)

    return weigh
