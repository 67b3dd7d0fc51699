"""Bring an older model folder, or a torch file, to today's format."""

import dataclasses
import shutil
import warnings
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.errors import InputError, InputWarning
from neurosym_jax.forecasting.model_folder import load_model, replace_model, save_model

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Write a model as a folder of config.json, params.safetensors and README.md.

    A folder of format 1 is converted in place where no other folder is named.
    """

    model: Annotated[Path, tyro.conf.Positional]
    """A model's folder, or a .pt file of SGAN or NeuroSyM."""
    to: Annotated[Path | None, tyro.conf.Positional] = None
    """The new folder; needed for a .pt file."""


def run(options: Options) -> None:
    """Convert.

    Raises:
        InputError: for what is no model, or a place that is taken or missing.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", InputWarning)  # which would tell of this command
        model = load_model(options.model)
    folder = options.to
    if folder is not None:
        card = options.model / "README.md"
        save_model(folder, model, card.read_text(encoding="utf-8") if card.is_file() else None)
    elif not options.model.is_dir():
        raise InputError(f"{options.model}: is a file; name the new folder as well")
    else:
        folder = options.model
        replace_model(folder, model)
        shutil.rmtree(folder / "params", ignore_errors=True)
    print(f"{folder}: {model.name}")
