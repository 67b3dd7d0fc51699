"""A trained model, and the forecast of one scene with it."""

import dataclasses
from typing import Any

import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.config import GeneratorConfig
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.networks import GeneratorForecaster
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.scene import make_scene

__all__ = ["Model", "predict"]


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A generator's configuration and parameters, and what is known of where they came from."""

    config: GeneratorConfig
    params: dict[str, Any]
    scene: str | None = None
    """The benchmark scene left out of its training, where known."""

    @property
    def name(self) -> str:
        """What kind of model this is."""
        weighting = self.config.weighting and self.config.weighting.name
        return {
            "none": "SGAN, no pooling",
            "pool_net": "SGAN",
            "social": "SGAN, social pooling",
            "as_described": f"NeuroSyM, {weighting}",
            "neurosym_ros": f"NeuroSyM (robot package), {weighting}",
            "neurosym_ijcnn": "NeuroSyM (IJCNN release)",
        }[self.config.pooling]

    @property
    def forecaster(self) -> GeneratorForecaster:
        """The forecaster of this model's parameters."""
        return GeneratorForecaster(self.config)


def predict(
    model: Model,
    observed: ArrayLike,
    *,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    frame: int = 0,
) -> np.ndarray:
    """Forecast one scene in the caller's own frame.

    Args:
        model: see `load_model`.
        observed: [N, obs_len, 2] metres.
        samples: number of futures.
        seed: with `recording` and `frame`, determines the noise.
        recording: name of the recording.
        frame: index of the first observed step in the recording.

    Returns:
        [samples, N, pred_len, 2] float64 metres.

    Raises:
        InputError: for a wrong shape, a coordinate that is not finite, or a number out of range.
    """
    scene = make_scene(observed, recording=recording, frame=frame)
    steps = scene.observed.shape[1]
    if steps != model.config.obs_len:
        raise InputError(f"observed has {steps} steps; the model observes {model.config.obs_len}")
    forecast = SceneForecaster(model.forecaster, model.params, samples=samples, seed=seed)
    return forecast(scene)
