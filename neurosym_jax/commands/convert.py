"""Convert a torch checkpoint to a model's folder, or back."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.interop.checkpoint import export_torch_checkpoint, load_torch_checkpoint

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Write a torch checkpoint as a model's folder, or a model as a torch checkpoint."""

    model: Annotated[Path, tyro.conf.Positional]
    """A .pt file of SGAN or NeuroSyM; or a model's folder or name."""
    to: Annotated[Path, tyro.conf.Positional]
    """The new folder; or a new .pt file, which torch writes."""
    ignore_arg: tuple[str, ...] = ()
    """Unknown arguments of the checkpoint that do not change its network."""


def run(options: Options) -> None:
    """Convert.

    Raises:
        InputError: for a model that cannot be read or that torch does not have, and a path that is
            there already.
    """
    if options.ignore_arg:
        model = load_torch_checkpoint(options.model, options.ignore_arg)
    else:
        model = load_model(options.model)
    if options.to.suffix == ".pt":
        export_torch_checkpoint(options.to, model)
    else:
        save_model(options.to, model)
    print(f"{options.to}: {model.name}")
