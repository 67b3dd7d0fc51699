"""Fetch ETH/UCY or SGAN's checkpoints, or show how to get THÖR."""

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from neurosym_jax.commands import inspect
from neurosym_jax.commands._options import refuse_unused
from neurosym_jax.data.published import HOME, data_folder, download

__all__ = ["Options", "run"]

THOR = """THÖR's recordings have to be fetched by hand:
  1. download https://zenodo.org/records/3382145 (THÖR: files such as Exp_1_run_1_6D.tsv) or
     https://zenodo.org/records/10407223 (THÖR-MAGNI: CSV files), and unpack what is an archive;
  2. put the recordings into {folder}
     (any of them; each file is a scene of its own);
  3. run this command again: it lists the files and whether they can be read."""


@dataclasses.dataclass(frozen=True)
class Options:
    """Fetch ETH/UCY or SGAN's checkpoints; show how to get THÖR, and check the files put there.

    evaluate.py and train.py find downloaded data by themselves.
    """

    what: Annotated[Literal["eth-ucy", "sgan-checkpoints", "thor"], tyro.conf.Positional]
    """Recordings of ETH/UCY (5.4 MB), SGAN's 20 published checkpoints (2.6 MB), or THÖR."""
    to: Path | None = None
    """Folder for the collection's own folder; default: $NEUROSYM_DATA, else
    neurosym_jax in $XDG_DATA_HOME or ~/.local/share."""
    mirror: str = HOME
    """Address of a copy of the files, with the same paths below it."""
    timeout: float = 20.0
    """Seconds without an answer after which a connection is given up."""


def run(options: Options) -> int:
    """Fetch the collection; return 2 if no file of THÖR is there yet.

    Raises:
        InputError: naming the file or address and what is wrong with it.
    """
    base = data_folder() if options.to is None else options.to
    folder = base / options.what
    if options.what == "thor":
        refuse_unused(options, ("mirror", "timeout"), "on THÖR, which is fetched by hand")
        there = folder.is_dir() and any(folder.iterdir())
        print(
            THOR.format(folder=folder.resolve()) + ("\n" if there else "\n\nNothing is there yet.")
        )
        return inspect.run(inspect.Options(folder)) if there else 2
    count, came = download(options.what, folder, options.mirror, options.timeout)
    print(f"{folder}: {count} files, every SHA-256 as published, {came} of them fetched now")
    if base.resolve() != data_folder().resolve():
        print(f"To have it found by name: export NEUROSYM_DATA={options.to}")
    return 0
