"""Convert a torch checkpoint to a model's folder, or back."""

from pathlib import Path

from tyro.conf import Positional

from neurosym_jax.forecasting.model_folder import load_model, save_model
from neurosym_jax.interop.checkpoint import export_torch_checkpoint, load_torch_checkpoint

__all__ = ["run"]


def run(model: Positional[Path], to: Positional[Path], ignore_arg: tuple[str, ...] = ()) -> None:
    """Write a torch checkpoint as a model's folder, or a model as a torch checkpoint.

    Args:
        model: A .pt file of SGAN or NeuroSyM, or a model's folder or name.
        to: The new folder, or a new .pt file, which torch writes.
        ignore_arg: Unknown arguments of the checkpoint that do not change its network.
    """
    found = load_torch_checkpoint(model, ignore_arg) if ignore_arg else load_model(model)
    if to.suffix == ".pt":
        export_torch_checkpoint(to, found)
    else:
        save_model(to, found)
    print(f"{to}: {found.name}")
