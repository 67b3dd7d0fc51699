"""Fetch ETH/UCY or SGAN's checkpoints, or show how to get THÖR."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from neurosym_jax.commands import inspect
from neurosym_jax.commands._options import refuse_given
from neurosym_jax.data.published import HOME, data_folder, download

__all__ = ["run"]

PATIENCE = 20.0
"""Seconds."""

THOR = """THÖR's recordings have to be fetched by hand:
  1. download https://zenodo.org/records/3382145 (THÖR: files such as Exp_1_run_1_6D.tsv) or
     https://zenodo.org/records/10407223 (THÖR-MAGNI: CSV files), and unpack what is an archive;
  2. put the recordings into {folder}
     (any of them; each file is a scene of its own);
  3. run this command again: it lists the files and whether they can be read."""


def run(
    what: Annotated[Literal["eth-ucy", "sgan-checkpoints", "thor"], tyro.conf.Positional],
    to: Path | None = None,
    mirror: str = HOME,
    timeout: float = PATIENCE,
) -> int:
    """Fetch ETH/UCY or SGAN's checkpoints; show how to get THÖR, and check the files put there.

    evaluate.py and train.py find downloaded data by themselves.

    Args:
        what: Recordings of ETH/UCY (5.4 MB), SGAN's 20 published checkpoints (2.6 MB), or THÖR.
        to: Folder for the collection's own folder; default: $NEUROSYM_DATA, else
            neurosym_jax in $XDG_DATA_HOME or ~/.local/share.
        mirror: Address of a copy of the files, with the same paths below it.
        timeout: Seconds without an answer after which a connection is given up.

    Returns:
        The exit status: 2 if no file of THÖR is there yet.
    """
    base = data_folder() if to is None else to
    folder = base / what
    if what == "thor":
        given = {"mirror": mirror != HOME, "timeout": timeout != PATIENCE}
        refuse_given("on THÖR, which is fetched by hand", **given)
        there = folder.is_dir() and any(folder.iterdir())
        end = "\n" if there else "\n\nNothing is there yet."
        print(THOR.format(folder=folder.resolve()) + end)
        return inspect.run(folder) if there else 2
    count, came = download(what, folder, mirror, timeout)
    print(f"{folder}: {count} files, every SHA-256 as published, {came} of them fetched now")
    if base.resolve() != data_folder().resolve():
        print(f"To have it found by name: export NEUROSYM_DATA={to}")
    return 0
