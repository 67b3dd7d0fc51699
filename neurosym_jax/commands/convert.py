"""Convert a torch checkpoint to a model's folder, or back."""

import contextlib
from pathlib import Path

from tyro.conf import Positional

from neurosym_jax.errors import InputError, printable
from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.forecasting.model_places import find_model
from neurosym_jax.interop.checkpoint import (
    export_torch_checkpoint,
    left_out,
    load_torch_checkpoint,
)
from neurosym_jax.interop.pickles import read_torch_file

__all__ = ["run"]


def run(model: Positional[Path], to: Positional[Path], ignore_arg: tuple[str, ...] = ()) -> None:
    """Write a torch checkpoint as a model's folder, or a model as a torch checkpoint.

    Args:
        model: A .pt file of SGAN or NeuroSyM, or a model's folder or name.
        to: The new folder, or a new .pt file, which torch writes.
        ignore_arg: Unknown arguments of the checkpoint that do not change its network.
    """
    source = find_model(model)
    loaded = load_torch_checkpoint(source, ignore_arg) if ignore_arg else load_model(source)
    if to.suffix == ".pt":
        export_torch_checkpoint(to, loaded)
    else:
        save_model(to, loaded)
    print(f"{to}: {loaded.name}")
    if source.is_file():
        with contextlib.suppress(InputError):  # SGAN's arguments do not express every network.
            if names := left_out(read_torch_file(source), loaded):
                print(f"not kept: {printable(', '.join(names))}")
