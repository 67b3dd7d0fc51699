"""Convert a torch checkpoint of SGAN or NeuroSyM to a model's folder."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.forecasting.model_folder import load_model, save_model

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Write a model as a folder of config.json, params.safetensors and README.md."""

    model: Annotated[Path, tyro.conf.Positional]
    """A .pt file of SGAN or NeuroSyM."""
    to: Annotated[Path, tyro.conf.Positional]
    """The new folder."""


def run(options: Options) -> None:
    """Convert.

    Raises:
        InputError: for a file that is no such checkpoint, or a folder that is there already.
    """
    model = load_model(options.model)
    save_model(options.to, model)
    print(f"{options.to}: {model.name}")
