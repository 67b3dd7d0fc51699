"""Weightings that look alpha up by the QTC_C1 state of a pair: `cnd`, `cnd_shipped`, `learned`."""

import dataclasses
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import Whole
from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.weighting import Parameters, Scenes, SymbolicWeighting

__all__ = ["Cnd", "CndShipped", "Learned", "TableWeighting", "after_first"]


@dataclasses.dataclass(frozen=True)
class Cnd(SymbolicWeighting):
    """1 / N_Tr, N_Tr the number of neighbours of the state in the diagram of the theory.

    What the papers describe.
    """

    title = "cnd"

    def state_weights(self) -> np.ndarray:
        """See `Weighting.state_weights`."""
        return alpha_table("c1")

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        return after_first(self.observed(parameters, positions), parameters)

    def observed(self, parameters: Parameters, positions: Array) -> Array:
        """[N, N, T-1] weights of the states observed."""
        table = jnp.asarray(parameters.get("table", self.state_weights()), positions.dtype)
        return table.at[self.codes(parameters, positions)].get(mode="clip")


@dataclasses.dataclass(frozen=True)
class CndShipped(Cnd):
    """The authors' own table, 1 / (2^nonzero 3^zero).

    It counts neighbours by continuity alone, and staying in the state as one of them.
    """

    title = "cnd_shipped"
    decimals: Whole | None = None
    """Decimals to which the table is rounded; the authors printed theirs with 4."""

    def state_weights(self) -> np.ndarray:
        """See `Weighting.state_weights`."""
        table = alpha_table("c1", rule="continuity", include_self=True)
        return table if self.decimals is None else np.round(table, self.decimals)


@dataclasses.dataclass(frozen=True)
class TableWeighting(Cnd):
    """A weighting that uses, or starts from, one of the two tables."""

    table: Literal["cnd", "cnd_shipped"] = "cnd"
    """The weights of the states."""

    def state_weights(self) -> np.ndarray:
        """See `Weighting.state_weights`."""
        return (Cnd() if self.table == "cnd" else CndShipped()).state_weights()


@dataclasses.dataclass(frozen=True)
class Learned(TableWeighting):
    """81 free weights, one a state, and one for the first step; they start at the table and 0."""

    title = "learned"

    def start(self, scenes: Scenes | None = None) -> Parameters:
        """`table` [81] and `unobserved` []."""
        return {"table": self.state_weights(), "unobserved": 0.0}


def after_first(observed: Array, parameters: Parameters) -> Array:
    """[N, N, T] from `observed [N, N, T-1]`: at the first step no state has been observed."""
    unobserved = jnp.asarray(parameters.get("unobserved", 0.0), observed.dtype)
    first = jnp.broadcast_to(unobserved, (*observed.shape[:2], 1))
    return jnp.concatenate([first, observed], axis=-1)
