"""Published collections that this project reads: fetching, their place here, their licences.

`published.tsv` pins every file. Until a collection is whole it grows in `NAME.part` beside its
folder, and the next call fetches the files that are still missing.
"""

import os
from collections.abc import Iterable
from importlib.resources import files
from pathlib import Path
from typing import Any

import polars as pl
from tqdm import tqdm

from neurosym_jax.errors import InputError, printable

__all__ = ["COLLECTIONS", "HOME", "data_folder", "download", "find", "licences_of"]

HOME = (
    "https://raw.githubusercontent.com/sariahmghames/NeuroSyM-prediction/"
    "711d66fe63b13633cb47c7db6a7d96892ebefba3/NeuroSyM-sgan/scripts/"
)
"""Address of the files, at a fixed commit."""

COLLECTIONS = ("eth-ucy", "sgan-checkpoints", "thor")  # folders in `data_folder()`

_LICENCES = {
    # What forbids a use is called restricted, and learned from by no model that ships.
    **dict.fromkeys(("sdd", "stanford"), ("SDD", "CC BY-NC-SA 3.0, restricted")),
    "simulations": ("simulations", "MIT"),
}


def licences_of(names: Iterable[str]) -> dict[str, str]:
    """The licence of each data set, "unstated" where its publisher states none or it is unknown."""
    return dict(_LICENCES.get(name.casefold(), (name, "unstated")) for name in names)


def published_files(collection: str) -> dict[str, dict[str, str]]:
    """Address, bytes and SHA-256 of each file of a collection, by path below its folder."""
    content = files("neurosym_jax.data").joinpath("published.tsv").read_bytes()
    rows = pl.read_csv(content, separator="\t", infer_schema=False).iter_rows(named=True)
    return {row["path"]: row for row in rows if row["collection"] == collection}


def download(what: str, folder: Path, mirror: str = HOME, timeout: float = 20.0) -> tuple[int, int]:
    """Fetch what `folder` lacks of a collection; return the number of its files and of those.

    Files are never overwritten. `mirror` is the address of a copy of `HOME`; a connection is given
    up after `timeout` seconds without an answer.

    Raises:
        InputError: naming the file or address and what is wrong with it.
    """
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    base, wanted = mirror.rstrip("/") + "/", published_files(what)
    into = folder if folder.exists() else folder.with_name(f"{folder.name}.part")
    collection = pooch.create(
        into,
        base_url=base,
        registry={name: f"sha256:{row['sha256']}" for name, row in wanted.items()},
        urls={name: base + row["address"] for name, row in wanted.items()},
        retry_if_failed=2,
    )
    receive: Any = pooch.HTTPDownloader(timeout=timeout)
    there = {name for name in wanted if (into / name).exists()}
    for name in there:
        if pooch.file_hash(str(into / name)) != wanted[name]["sha256"]:
            raise InputError(f"{into / name}: is not the published file; move it away")
    try:
        for name in tqdm(wanted.keys() - there, desc=folder.name, unit=" files", disable=None):
            collection.fetch(name, downloader=receive)
        if into != folder:
            into.rename(folder)
    except (requests.RequestException, ValueError) as error:
        raise InputError(
            f"{base}: {printable(str(error))[:300]} (what has arrived is kept: run this again, or "
            "name another place with --mirror)"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from None
    return len(wanted), len(wanted) - len(there)


def data_folder() -> Path:
    """`$NEUROSYM_DATA`, else `neurosym_jax` in `$XDG_DATA_HOME` (default `~/.local/share`)."""
    if own := os.environ.get("NEUROSYM_DATA"):
        return Path(own)
    base = os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share")
    return Path(base) / "neurosym_jax"


def find(path: Path) -> Path:
    """`path`, or where it is below the data folder or a collection in it, if it is anywhere."""
    base = data_folder()
    places = (path, base / path, *(base / name / path for name in COLLECTIONS))
    return next(filter(os.path.exists, places), path)
