"""Models that forecast side by side, by the names they are shown under."""

import re
from collections.abc import Sequence
from pathlib import Path

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model import Model
from neurosym_jax.forecasting.model_folder import load_model

__all__ = ["load_models"]


def load_models(paths: Sequence[Path]) -> dict[str, Model]:
    """Models by how their tables' names begin ("NeuroSyM", "SGAN"), else by their files' names.

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
