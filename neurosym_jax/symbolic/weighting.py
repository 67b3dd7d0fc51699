"""Weightings: how much agent j matters to agent i at each step, alpha [N, N, T].

NeuroSyM (Mghames et al., 2023) multiplies the features of a pair by alpha, looked up by
the QTC_C1 state that the pair was last observed in. A weighting is a frozen dataclass:
its fields are its options, and equal weightings share compiled programs. What it learns
is in the model's parameters, `params["weighting"]`. The built-in ones are in
`weightings`.
"""

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from neurosym_jax.configuration import Checked, differences
from neurosym_jax.symbolic.qtc import observe
from neurosym_jax.symbolic.states import encode_state

__all__ = ["Parameters", "Weighting", "initial_parameters", "is_constant"]

Parameters = Mapping[str, Any]
"""Arrays that a weighting learns, by name."""


@dataclasses.dataclass(frozen=True)
class Weighting(Checked, abc.ABC):
    """A weighting; a subclass has its options as fields and overrides `weigh`."""

    title: ClassVar[str] = ""
    """The name by which it is registered, in text forms and tables."""

    @abc.abstractmethod
    def weigh(
        self, parameters: Parameters, positions: Array, valid: Array, period: float
    ) -> Array:
        """[N, N, T] weights of all ordered pairs of one scene, see `alpha` for the arguments.

        Positions that are not there are zeros here; `alpha` takes the weights of their
        pairs away.
        """

    def start(self) -> Parameters:
        """Parameters before training."""
        return {}

    def thresholds(self, parameters: Parameters, period: float) -> dict[str, Any]:
        """Arguments of `qtc.observe` at steps of `period` seconds."""
        return {}

    def codes(
        self, parameters: Parameters, positions: ArrayLike, *, period: float = 0.4
    ) -> Array:
        """[N, N, T-1] codes of the QTC_C1 states of all ordered pairs of `positions [N, T, 2]`."""
        positions, thresholds = (
            jnp.asarray(positions),
            self.thresholds(parameters, period),
        )
        return encode_state(observe(positions[:, None], positions, **thresholds))

    def alpha(
        self,
        parameters: Parameters,
        positions: ArrayLike,
        valid: ArrayLike | None = None,
        *,
        period: float = 0.4,
    ) -> Array:
        """Weights of the interactions of every ordered pair of one scene.

        The state observed from t-1 to t weights the interaction at t, so t = 0 has no
        state and weighs 0 unless a weighting defines it. An agent weighs 1 for itself;
        pairs with padding weigh 0, and so does a single valid agent, whatever the
        padded size. Where a position is not there (NaN), now or at the step before, the
        pair has no state and weighs 0; gradients through it are 0.

        Args:
            parameters: as `start()`, or trained.
            positions: [N, T, 2] metres, T >= 1.
            valid: [N] bool, False for padding; None for no padding.
            period: seconds between steps, by which thresholds in m/s become metres.

        Returns:
            [N, N, T]; (i, j) is how much j matters to i.
        """
        positions = jnp.asarray(positions, jnp.result_type(positions, 0.0))
        present = (
            jnp.ones(positions.shape[0], bool) if valid is None else jnp.asarray(valid)
        )
        missing = jnp.isnan(positions).any(axis=-1)
        filled = jnp.where(missing[..., None], 0, positions)
        alpha = self.weigh(parameters, filled, present, period).astype(positions.dtype)
        alpha = jnp.where(jnp.eye(positions.shape[0], dtype=bool)[..., None], 1, alpha)
        missing |= jnp.pad(missing[:, :-1], [(0, 0), (1, 0)])
        steps = present[:, None] & ~missing
        pairs = steps[:, None] & steps[None] & (present.sum() != 1)
        return jnp.where(pairs, alpha, 0)

    @property
    def name(self) -> str:
        """Its title and the options that differ from their defaults: `soft,temperature=0.1`."""
        return ",".join([self.title, *differences(self)])


def initial_parameters(weighting: Weighting | None) -> dict[str, np.ndarray]:
    """Parameters of the weighting before training, float32; empty for None."""
    start = {} if weighting is None else weighting.start()
    return {name: np.asarray(value, np.float32) for name, value in start.items()}


def is_constant(alpha: np.ndarray) -> bool:
    """Whether `alpha [N, N, T]` is the same for all pairs at all steps but the first."""
    others = alpha[~np.eye(len(alpha), dtype=bool)][:, 1:]
    return others.size > 0 and np.ptp(others) == 0
