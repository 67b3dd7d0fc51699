"""Weightings that look alpha up by the QTC_C1 state of a pair, hard or soft.

A table gives each of the 81 states a weight: `cnd` the theory's, `cnd_shipped` the authors',
`learned` 81 free ones. `quantised` has symbols that are 0 below a threshold, `soft` the expectation
over symbols that fade into each other, and `shuffled`, a control, gives weights to the wrong pairs.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import NotNegative, Positive, Whole
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.cnd import alpha_table
from neurosym_jax.symbolic.qtc import other_pairs
from neurosym_jax.symbolic.soft import soft_alpha, soft_symbols
from neurosym_jax.symbolic.weighting import Parameters, SymbolicWeighting

__all__ = ["Cnd", "CndShipped", "Learned", "Quantised", "Shuffled", "Soft", "to_wrong_pairs"]


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
        return _after_first(self.observed(parameters, positions), parameters)

    def observed(self, parameters: Parameters, positions: Array) -> Array:
        """[N, N, T-1] weights of the states observed in positions [N, T, 2]."""
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
class Learned(Cnd):
    """81 free weights, one a state, and one for the first step; they start at `cnd` and 0."""

    title = "learned"

    def start(self) -> Parameters:
        """`table` [81] and `unobserved` []."""
        return {"table": self.state_weights(), "unobserved": 0.0}


@dataclasses.dataclass(frozen=True)
class Quantised(Cnd):
    """`cnd` of symbols that are 0 below 5 cm a step.

    A learned threshold has straight-through gradients: symbols are hard, their gradients those of
    soft ones.
    """

    title = "quantised"
    quantisation_factor: NotNegative = 0.05
    temperature: Positive = 0.02
    """Metres a step over which a symbol fades into the next, in gradients of the threshold."""
    learned: bool = False
    """Whether training changes the threshold."""

    def __post_init__(self):
        """Refuse a threshold that cannot be learned."""
        super().__post_init__()
        if self.learned and not self.quantisation_factor:
            raise InputError("a quantisation_factor of 0 cannot be learned: its logarithm is")

    def start(self) -> Parameters:
        """`log_quantisation_factor` [] if learned."""
        return {"log_quantisation_factor": np.log(self.quantisation_factor)} if self.learned else {}

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        if not self.learned:
            return super().weigh(parameters, positions, valid)
        return self.softly(parameters, positions, straight_through=True)

    def softly(
        self, parameters: Parameters, positions: Array, straight_through: bool = False
    ) -> Array:
        """[N, N, T] expected weights of soft symbols of positions [N, T, 2]."""
        temperature = self.temperature
        if "log_temperature" in parameters:
            temperature = jnp.exp(parameters["log_temperature"])
        probabilities = soft_symbols(
            positions[:, None],
            positions,
            temperature=temperature,
            straight_through=straight_through,
            **self.thresholds(parameters),
        )
        return _after_first(soft_alpha(probabilities, parameters.get("table")), parameters)


@dataclasses.dataclass(frozen=True)
class Soft(Quantised):
    """The expectation of `cnd` where symbols fade into each other over `temperature`, see `soft`.

    Training can change the threshold, the temperature and the table.
    """

    title = "soft"

    def start(self) -> Parameters:
        """`log_quantisation_factor` [], `log_temperature` [], `table` [81], `unobserved` []."""
        if not self.learned:
            return {}
        own = {"log_temperature": np.log(self.temperature), "table": self.state_weights()}
        return {**super().start(), **own, "unobserved": 0.0}

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        return self.softly(parameters, positions)


@dataclasses.dataclass(frozen=True)
class Shuffled(Cnd):
    """The weights of `quantised` with the wrong pairs, and the last step first.

    Each neighbour of an agent gets those of the next nearer one, the nearest those of the farthest:
    the same weights in the same scene, without their meaning.
    """

    title = "shuffled"
    quantisation_factor: NotNegative = 0.05

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        observed = self.observed(parameters, positions)
        return _after_first(to_wrong_pairs(observed, positions[:, -1], valid), parameters)


def to_wrong_pairs(observed: Array, last: Array, valid: ArrayLike | None) -> Array:
    """`observed [N, N, T-1]` of `shuffled`, by the last positions `last [N, 2]`.

    Each agent keeps its weights in another order, which follows from the scene alone: neither
    rotation nor padding nor the order of the agents changes it.
    """
    others = other_pairs(valid, last.shape[0])
    apart = jnp.square(last[:, None] - last[None]).sum(axis=-1)
    by_distance = jnp.argsort(jnp.where(others, apart, jnp.inf), axis=1)
    rank = jnp.argsort(by_distance, axis=1)
    of_others = jnp.maximum(others.sum(axis=1, keepdims=True), 1)
    source = jnp.take_along_axis(by_distance, (rank - 1) % of_others, axis=1)
    return jnp.take_along_axis(observed[..., ::-1], source[..., None], axis=1)


def _after_first(observed: Array, parameters: Parameters) -> Array:
    """[N, N, T] from `observed [N, N, T-1]`: at the first step no state has been observed."""
    unobserved = jnp.asarray(parameters.get("unobserved", 0.0), observed.dtype)
    first = jnp.broadcast_to(unobserved, (*observed.shape[:2], 1))
    return jnp.concatenate([first, observed], axis=-1)
