"""A trained model, and the forecast of one scene with it."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
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

__all__ = ["Model", "predict", "predict_distribution", "refuse_other_length"]


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """A forecaster's configuration and parameters, and their origin."""

    config: Any
    """The forecaster's `Config`: `GeneratorConfig` for SGAN and NeuroSyM."""
    params: Any
    """Nested dictionaries of arrays."""
    dataset: str | None = None
    """The data set to test it on, where known: left out of its training, or `simulations`, which
    has other recordings for training."""
    kind: str = "generator"
    """The forecaster's name, see `register_forecaster`."""
    plugins: tuple[str, ...] = ()
    """Plugins it was trained with, for messages: none is imported because of them."""
    neighbours: float | None = None
    """Share of people with somebody within 2 m whose forecast their neighbours change, on the
    validation windows; None where nobody measured it."""
    assumed: tuple[str, ...] = ()
    """What its torch checkpoint does not say and was taken to be so, in words."""
    seen: str = ""
    """Fingerprint of its training windows, see `data.leakage`; empty where it is not known."""
    data: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """Licence of each data set that it learned from, by name; empty where not known."""

    @property
    def name(self) -> str:
        """Name in tables: the forecaster's title."""
        return self.forecaster.title

    @property
    def forecaster(self) -> Forecaster:
        """The forecaster of this model's parameters."""
        return FORECASTERS[self.kind](self.config)

    @property
    def weighting(self) -> Weighting | None:
        """The weighting of pairs; None for a model without symbols."""
        weighting = getattr(self.config, "weighting", None)
        return weighting if isinstance(weighting, Weighting) else None

    @staticmethod
    def from_pretrained(name: Path | str, *, revision: str | None = None) -> "Model":
        """See `forecasting.from_pretrained`: a path, a shipped name, or the Hub's `owner/name`."""
        from neurosym_jax.forecasting.hub import from_pretrained

        return from_pretrained(name, revision=revision)

    def save_pretrained(self, folder: Path | str, card: str | None = None) -> None:
        """See `save_model`."""
        from neurosym_jax.forecasting.model_folder import save_model

        save_model(folder, self, card)

    def push_to_hub(self, name: str, *, private: bool = False, card: str | None = None) -> str:
        """See `forecasting.push_to_hub`: to the Hub's repository `owner/name`."""
        from neurosym_jax.forecasting.hub import push_to_hub

        return push_to_hub(self, name, private=private, card=card)

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
        samples: number of futures k; a deterministic model makes one.
        seed: with `recording` and `frame`, determines the noise.
        recording: name of the recording.
        frame: index of the first observed step in the recording.

    Returns:
        [k, N, pred_len, 2] float64 metres.

    Raises:
        InputError: for a wrong shape, an unusable coordinate, or a number out of range.
    """
    return predict_distribution(
        model, observed, samples=samples, seed=seed, recording=recording, frame=frame
    )[0]


def predict_distribution(
    model: Model,
    observed: ArrayLike,
    *,
    samples: int = 20,
    seed: int = 0,
    recording: str = "",
    frame: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """The futures that `predict` returns, and their probabilities [k].

    `anchors` learns the probabilities; the samples of other models have 1 / k each. Asked for fewer
    samples than it has, `anchors` gives the most probable one and those that with it represent all
    of them best, and the probabilities given that the future is one of these.

    Arguments are those of `predict`: `observed` is [N, obs_len, 2] metres.
    """
    scene = make_scene(observed, recording=recording, frame=frame)
    refuse_other_length(model, scene.observed, "observed")
    forecaster = SceneForecaster(model.forecaster, model.params, samples=samples, seed=seed)
    futures, probability = forecaster.finish(forecaster.start(scene), scene)
    return futures, np.full(len(futures), 1 / len(futures)) if probability is None else probability


def refuse_other_length(model: Model, observed: AnyArray, name: str) -> None:
    """Refuse `observed [N, T, 2]`, called `name`, if the model does not observe T steps.

    Raises:
        InputError: with both numbers.
    """
    steps, wanted = observed.shape[1], model.config.obs_len
    if steps != wanted:
        raise InputError(f"{name} has {steps} steps; the model observes {wanted}")
