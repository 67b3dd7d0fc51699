"""Published collections that this project reads, and where they lie on this computer.

`published.tsv` pins every file: collection, path in it, address below `HOME`, bytes, SHA-256.
"""

import contextlib
import csv
import os
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

__all__ = ["COLLECTIONS", "HOME", "PublishedFile", "data_folder", "find", "published_files"]

HOME = (
    "https://raw.githubusercontent.com/sariahmghames/NeuroSyM-prediction/"
    "711d66fe63b13633cb47c7db6a7d96892ebefba3/NeuroSyM-sgan/scripts/"
)
"""Address of the files, at a fixed commit."""

COLLECTIONS = ("eth-ucy", "sgan-checkpoints", "thor")
"""Folders in `data_folder()`."""


class PublishedFile(NamedTuple):
    """One file."""

    path: Path
    """Below the collection's folder."""
    address: str
    """Below `HOME`, or a mirror of it."""
    size: int
    """Bytes."""
    sha256: str


def published_files(collection: str) -> list[PublishedFile]:
    """The files of a collection, in order of path; none of one that is fetched by hand."""
    with files("neurosym_jax.data").joinpath("published.tsv").open(encoding="utf-8") as table:
        return [
            PublishedFile(Path(row["path"]), row["address"], int(row["bytes"]), row["sha256"])
            for row in csv.DictReader(table, delimiter="\t")
            if row["collection"] == collection
        ]


def data_folder() -> Path:
    """Folder of the user's data: `$NEUROSYM_DATA`, else `neurosym_jax` in `$XDG_DATA_HOME`
    (default `~/.local/share`)."""
    if own := os.environ.get("NEUROSYM_DATA"):
        return Path(own)
    try:
        base = Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share")
    except RuntimeError:  # A user without a home, as in containers.
        base = Path()
    return base / "neurosym_jax"


def find(path: Path) -> Path:
    """`path`, or where it is below the data folder or a collection in it.

    A path that is nowhere is returned unchanged, so that messages name what the user wrote.
    """
    base = data_folder()
    for candidate in (path, base / path, *(base / name / path for name in COLLECTIONS)):
        with contextlib.suppress(OSError):  # A name that is too long is nowhere.
            if candidate.exists():
                return candidate
    return path
