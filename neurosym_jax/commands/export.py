"""Export a model as a StableHLO program, to run without this package."""

import dataclasses
from pathlib import Path
from typing import Annotated

import tyro

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.interop.export import export_model
from neurosym_jax.runtime.files import new_file

__all__ = ["Options", "run"]


@dataclasses.dataclass(frozen=True)
class Options:
    """Export a model as one StableHLO program for any number of people."""

    model: Annotated[Path, tyro.conf.Positional]
    """A model's folder or name, or a .pt file."""
    to: Annotated[Path, tyro.conf.Positional]
    """The new file, which `jax.export.deserialize` reads (examples/run_exported.py)."""
    samples: int = 20
    """Number of forecasts of each call, k."""


def run(options: Options) -> None:
    """Export.

    Raises:
        InputError: as `export_model`, and for a file that exists or cannot be written.
    """
    if options.to.exists():
        raise InputError(f"{options.to}: exists already")
    model = load_model(options.model)
    program = export_model(model, options.samples)
    with new_file(options.to) as beside:
        beside.write_bytes(program)
    print(f"{options.to}: {model.name}, {options.samples} forecasts of any number of people")
