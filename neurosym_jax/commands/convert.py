"""Convert a torch checkpoint to a model's folder, or back."""

from pathlib import Path
from typing import Any

from tyro.conf import Positional

from neurosym_jax.commands._options import refuse_given
from neurosym_jax.errors import InputError, printable
from neurosym_jax.interop.checkpoint import (
    export_torch_checkpoint,
    left_out,
    model_from_torch,
)
from neurosym_jax.interop.pickles import read_torch_file
from neurosym_jax.models.disk import find_model, load_model, save_model
from neurosym_jax.models.forecast import Model
from neurosym_jax.runtime.foreign import reading

__all__ = ["run"]


def run(
    model: Positional[Path],
    to: Positional[Path],
    ignore_arg: tuple[str, ...] = (),
    generator_only: bool = False,
) -> None:
    """Write a torch checkpoint as a model's folder, or a model as a torch checkpoint.

    Args:
        model: A .pt file of SGAN or NeuroSyM, or a model's folder or name.
        to: The new folder, or a new .pt file, which torch writes.
        ignore_arg: Unknown arguments of the checkpoint that do not change its network.
        generator_only: Leave behind what is no part of the generator: the
            discriminator, losses, optimisers, arguments of the training.

    Raises:
        InputError: for a file that cannot be read or written; without `generator_only`
            for a checkpoint that could not be written again as it is, naming what would
            be lost.
    """
    source = find_model(model)
    if source.is_file():
        contents = read_torch_file(source)
        with reading(source):
            loaded = model_from_torch(contents, ignore_arg)
        if not generator_only:
            _refuse_loss(source, contents, to, loaded)
    else:
        refuse_given("on a model's folder", ignore_arg=ignore_arg or None)
        loaded = load_model(source)
    if to.suffix == ".pt":
        export_torch_checkpoint(to, loaded)
    else:
        save_model(to, loaded)
    print(f"{to}: {loaded.name}")


def _refuse_loss(source: Path, contents: Any, to: Path, model: Model) -> None:
    """Refuse a checkpoint that holds more than `model` gives back."""
    try:
        lost = ", ".join(left_out(contents, model))
    except InputError as error:  # SGAN's arguments do not express every network.
        lost = f"its form for torch ({error})"
    if lost:
        hint = "--generator-only leaves it behind"
        raise InputError(f"{source}: {to} would lose {printable(lost)}: {hint}")
