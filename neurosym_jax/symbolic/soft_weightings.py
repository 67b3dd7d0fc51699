"""Weightings of symbols with a threshold: `quantised`, hard, and `soft`, differentiable."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import NotNegative, Positive
from neurosym_jax.errors import InputError
from neurosym_jax.symbolic.soft import soft_alpha, soft_symbols
from neurosym_jax.symbolic.state_weightings import TableWeighting, after_first
from neurosym_jax.symbolic.weighting import Parameters, Scenes

__all__ = ["Quantised", "Soft"]


@dataclasses.dataclass(frozen=True)
class Quantised(TableWeighting):
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

    def start(self, scenes: Scenes | None = None) -> Parameters:
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
        """[N, N, T] expected weights of soft symbols."""
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
        expected = soft_alpha(probabilities, parameters.get("table"))
        return after_first(expected, parameters)


@dataclasses.dataclass(frozen=True)
class Soft(Quantised):
    """The expectation of `cnd` where symbols fade into each other over `temperature`, see `soft`.

    Training can change the threshold, the temperature and the table.
    """

    title = "soft"

    def start(self, scenes: Scenes | None = None) -> Parameters:
        """`log_quantisation_factor` [], `log_temperature` [], `table` [81], `unobserved` []."""
        if not self.learned:
            return {}
        own = {"log_temperature": np.log(self.temperature), "table": self.state_weights()}
        return {**super().start(scenes), **own, "unobserved": 0.0}

    def weigh(self, parameters: Parameters, positions: Array, valid: ArrayLike | None) -> Array:
        """See `Weighting.weigh`."""
        return self.softly(parameters, positions)
