"""A trained model, and the forecast of one scene with it."""

import dataclasses
from typing import Any

import jax
import numpy as np
from jax.typing import ArrayLike

from neurosym_jax.configuration import differences
from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.forecaster import Forecaster
from neurosym_jax.forecasting.forecasters import FORECASTERS
from neurosym_jax.forecasting.scene_forecaster import SceneForecaster
from neurosym_jax.scene import AnyArray, make_scene
from neurosym_jax.symbolic.weighting import Weighting

__all__ = ["Model", "predict", "refuse_other_length"]


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A forecaster's configuration and parameters, and what is known of where they came from."""

    config: Any
    """Of the type that its kind of forecaster has: `GeneratorConfig` for SGAN and NeuroSyM."""
    params: Any
    """Nested dictionaries of arrays."""
    dataset: str | None = None
    """The dataset to test it on, where known: left out of its training, or `simulations`, of which
    others are for training."""
    kind: str = "generator"
    """Of forecaster, by name: see `register_forecaster`."""
    plugins: tuple[str, ...] = ()
    """What `--plugin` named when it was trained, for people: it is never imported from here."""

    @property
    def name(self) -> str:
        """What tables call this model."""
        return self.forecaster.title

    @property
    def forecaster(self) -> Forecaster:
        """The forecaster of this model's parameters."""
        return FORECASTERS[self.kind](self.config)

    @property
    def weighting(self) -> Weighting | None:
        """How it weights pairs of agents; None for a model without symbols."""
        weighting = getattr(self.config, "weighting", None)
        return weighting if isinstance(weighting, Weighting) else None

    def __repr__(self) -> str:
        """Five lines, without the parameters' numbers and the config's defaults."""
        count = sum(np.size(leaf) for leaf in jax.tree.leaves(self.params))
        lines = [
            f"Model {self.name}",
            f"  kind: {self.kind}",
            f"  to be tested on: {self.dataset or 'not known'}",
            f"  config: {type(self.config).__name__}({', '.join(differences(self.config))})",
            f"  params: {count:,} numbers",
        ]
        return "\n".join(lines)


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
    refuse_other_length(model, scene.observed, "observed")
    forecast = SceneForecaster(model.forecaster, model.params, samples=samples, seed=seed)
    return forecast(scene)


def refuse_other_length(model: Model, observed: AnyArray, name: str) -> None:
    """Refuse `observed [N, T, 2]`, called `name`, of more or fewer steps than the model observes.

    Raises:
        InputError: with both numbers.
    """
    steps, wanted = observed.shape[1], model.config.obs_len
    if steps != wanted:
        raise InputError(f"{name} has {steps} steps; the model observes {wanted}")
