"""What a forecaster is: k futures of one scene.

Equal forecasters are equal to `jax.jit`, so they share compiled programs. Which ones there are,
`kinds` says; how the scenes of a test set are forecast at once is `batched`'s.
"""

import abc
import dataclasses
from typing import Any

from jax import Array

from neurosym_jax.forecasting.noise import NoiseSpec
from neurosym_jax.scene import Scene

__all__ = ["Forecaster", "TwoStageForecaster"]


@dataclasses.dataclass(frozen=True)
class Forecaster(abc.ABC):
    """A forecast of one scene, as a function of parameters, scene and noise."""

    pred_len: int

    @property
    def noise(self) -> NoiseSpec:
        """The noise it wants; the default is none, a deterministic forecast."""
        return NoiseSpec()

    @abc.abstractmethod
    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """Futures of one scene; a function that `jax.vmap` and `jax.jit` can take.

        Args:
            params: of the model.
            scene: of N slots; without `future` and `origin`.
            noise: [k, dim], or [k, N, dim] where `noise` says per agent; k = 1 for dim 0.

        Returns:
            [k, N, pred_len, 2] metres relative to the scene's origin.
        """

    def scene_bytes(self, samples: int, slots: int) -> float:
        """About what forecasting one scene takes in memory: futures, and states of its agents."""
        return 4.0 * samples * slots * (8 * self.pred_len + 256)


class TwoStageForecaster(Forecaster):
    """A forecaster that encodes a scene once and decodes it for each noise.

    Where decoding looks at no neighbour, an evaluation decodes the agents of many scenes as if they
    were one scene, without padding and by a single program.
    """

    @property
    def encoder(self) -> "TwoStageForecaster | None":
        """What encodes: equal ones share programs. None where `encode` has nothing to do."""
        return None

    @property
    def decodes_alone(self) -> bool:
        """Whether `decode` looks at no neighbour."""
        return True

    def encode(self, params: Any, scene: Scene) -> Any:
        """What is known of one scene before the noise: arrays [N, ...]."""
        return ()

    @abc.abstractmethod
    def decode(self, params: Any, context: Any, scene: Scene, noise: Array) -> Array:
        """See `forecast`; where it decodes alone, `scene` has no identity either."""

    def forecast(self, params: Any, scene: Scene, noise: Array) -> Array:
        """See `Forecaster.forecast`."""
        return self.decode(params, self.encode(params, scene), scene, noise)
