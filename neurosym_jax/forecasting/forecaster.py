"""What a forecaster is: k futures of one scene; `forecasters` has the table.

Equal forecasters are equal to `jax.jit`, so they share compiled programs.
"""

import abc
import dataclasses
from collections.abc import Mapping
from typing import Any, ClassVar

from jax import Array

from neurosym_jax.configuration import Checked, Count, Positive
from neurosym_jax.forecasting.noise import NoiseSpec
from neurosym_jax.scene import Scene

__all__ = ["Distribution", "Forecaster", "Lengths", "TwoStageForecaster"]


Distribution = tuple[Array, Array | None]
"""Samples [k, N, pred_len, 2] of a scene and their probabilities [k]; None where all have the
same."""


@dataclasses.dataclass(frozen=True)
class Lengths(Checked):
    """The configuration of a forecaster that needs nothing else."""

    obs_len: Count = 8
    """Observed time steps."""
    pred_len: Count = 8
    """Time steps to forecast."""
    period: Positive = 0.4
    """Seconds between time steps."""


@dataclasses.dataclass(frozen=True)
class Forecaster(abc.ABC):
    """A forecast of one scene, as a function of parameters, scene and noise."""

    config: Any
    """Of type `Config`."""

    Config: ClassVar[type] = Lengths
    """A frozen dataclass with at least the fields of `Lengths`."""

    @property
    def title(self) -> str:
        """What tables call it; by default the name of the class."""
        return type(self).__name__

    @property
    def pred_len(self) -> int:
        """Time steps that are forecast."""
        return self.config.pred_len

    @property
    def noise(self) -> NoiseSpec:
        """The noise it takes; by default none, a deterministic forecast."""
        return NoiseSpec()

    @property
    def sees_neighbours(self) -> bool:
        """Whether a forecast should depend on who else is in the scene."""
        return True

    def shapes(self) -> Mapping[str, tuple[int, ...]] | None:
        """Shapes of the parameters by path, to check a model's folder by; None for no check."""
        return None

    @abc.abstractmethod
    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """Futures [k, N, pred_len, 2] of one scene, metres relative to its origin.

        A function for `jax.vmap` and `jax.jit`. The scene has N slots, and neither `future` nor
        `origin`; `noise` is [k, dim], or [k, N, dim] where it is per agent; k = 1 for dim 0.
        """

    def prepared(self, scene: Scene) -> Scene:
        """The padded `scene` of a single forecast, with what is best computed on the host."""
        return scene

    def distribution(self, params: Any, scene: Scene, noise: Array) -> Distribution:
        """`forecast`, and the probabilities [k] of its samples; None where all have the same."""
        return self.forecast(params, scene, noise), None

    def count(self, samples: int) -> int:
        """Number of samples it makes where `samples` are asked for: one without noise.

        Raises:
            InputError: where it cannot make as many.
        """
        return samples if self.noise.dim else 1


class TwoStageForecaster(Forecaster):
    """A forecaster that encodes a scene once and decodes it for each noise.

    Where decoding looks at no neighbour, an evaluation decodes the agents of many scenes as one
    scene, without padding and by one program.
    """

    @property
    def decodes_alone(self) -> bool:
        """Whether `decode` looks at no neighbour."""
        return True

    def encode(self, params: Any, scene: Scene) -> Any:
        """The context of one scene, which does not depend on the noise: arrays [N, ...] if any."""
        return ()

    @abc.abstractmethod
    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """As `forecast`, given the context [N, ...]; if `decodes_alone`, without identity."""

    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """See `Forecaster.forecast`."""
        return self.decode(params, self.encode(params, scene), scene, noise)
