"""The options that every command that forecasts a stream has, and the predictor they describe."""

import dataclasses
import re
from pathlib import Path

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.online.predictor import Predictor

__all__ = ["LiveOptions", "load_models", "make_predictor"]


@dataclasses.dataclass(frozen=True)
class LiveOptions:
    """Which models forecast a stream, and how."""

    model: tuple[Path, ...]
    """Folders of models, or torch checkpoints; several forecast side by side."""
    period: float | None = None
    """Seconds between steps; default: those that the models were trained on."""
    max_people: int = 64
    """In a forecast; of more, the nearest to the middle are taken."""
    samples: int = 20
    """Futures that each model draws."""
    seed: int = 0
    """Of the noise."""


def load_models(paths: tuple[Path, ...]) -> dict[str, Model]:
    """Models by the name they are shown under: how the tables' name begins ("NeuroSyM", "SGAN"),
    or their files' names.

    Raises:
        InputError: for no path, what is no model, or two of one kind whose files are named alike.
    """
    if not paths:
        raise InputError("--model needs at least one model")
    models = [load_model(path) for path in paths]
    names = [re.split(r",| \(", model.name)[0] for model in models]
    if len(set(names)) < len(names):
        names = [path.resolve().stem for path in paths]
    if len(set(names)) < len(names):
        raise InputError(f"models must differ in kind or name: {', '.join(map(str, paths))}")
    return dict(zip(names, models))


def make_predictor(options: LiveOptions, recording: str = "") -> Predictor:
    """Load the models and compile.

    Raises:
        InputError: as `load_models` and `Predictor` do.
    """
    return Predictor(
        load_models(options.model),
        options.period,
        options.max_people,
        options.samples,
        options.seed,
        recording=recording,
    )
