"""Export a model as a StableHLO program, to run without this package."""

from pathlib import Path

from tyro.conf import Positional

from neurosym_jax.errors import InputError
from neurosym_jax.forecasting.model_folder import load_model
from neurosym_jax.interop.export import export_model
from neurosym_jax.runtime.files import new_file

__all__ = ["run"]


def run(model: Positional[Path], to: Positional[Path], samples: int = 20) -> None:
    """Export a model as one StableHLO program for any number of people.

    Args:
        model: A model's folder or name, or a .pt file.
        to: The new file, which `jax.export.deserialize` reads (examples/run_exported.py).
        samples: Number of forecasts of each call, k.

    Raises:
        InputError: as `export_model`, and for a file that exists or cannot be written.
    """
    if to.exists():
        raise InputError(f"{to}: exists already")
    found = load_model(model)
    program = export_model(found, samples)
    with new_file(to) as beside:
        beside.write_bytes(program)
    print(f"{to}: {found.name}, {samples} forecasts of any number of people")
