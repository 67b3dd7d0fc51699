"""Fetch ETH/UCY, SGAN's checkpoints; say how to get THÖR.

`data/published.tsv` pins every file. Until a collection is whole it grows in
`NAME.part` beside its folder, and the next call fetches the files that are still
missing.
"""

from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import polars as pl
import tyro
from tqdm import tqdm

from neurosym_jax.commands import inspect
from neurosym_jax.commands._options import refuse_given
from neurosym_jax.data.recordings import data_folder
from neurosym_jax.errors import InputError, printable

__all__ = ["download", "published_files", "run"]

HOME = (
    "https://raw.githubusercontent.com/sariahmghames/NeuroSyM-prediction/"
    "711d66fe63b13633cb47c7db6a7d96892ebefba3/NeuroSyM-sgan/scripts/"
)
"""Address of the files, at a fixed commit."""

PATIENCE = 20.0
"""Seconds."""

THOR = """THÖR's recordings have to be fetched by hand:
  1. download https://zenodo.org/records/3382145 (THÖR: files such as Exp_1_run_1_6D.tsv) or
     https://zenodo.org/records/10407223 (THÖR-MAGNI: CSV files), and unpack what is an archive;
  2. put the recordings into {folder}
     (any of them; each file is a scene of its own);
  3. run this command again: it lists the files and whether they can be read."""


def run(
    collection: Annotated[
        Literal["eth-ucy", "sgan-checkpoints", "thor"], tyro.conf.Positional
    ],
    to: Path | None = None,
    mirror: str = HOME,
    timeout: float = PATIENCE,
) -> int:
    """Fetch ETH/UCY or SGAN's checkpoints; show how to get THÖR, and check the files put there.

    evaluate.py and train.py find downloaded data by themselves.

    Args:
        collection: Recordings of ETH/UCY (5.4 MB), SGAN's 20 published checkpoints (2.6
            MB), or THÖR.
        to: Folder for the collection's own folder; default: $NEUROSYM_DATA, else
            neurosym_jax in $XDG_DATA_HOME or ~/.local/share.
        mirror: Address of a copy of the files, with the same paths below it (default:
            GitHub).
        timeout: Seconds without an answer after which a connection is given up.

    Returns:
        The exit status: 2 if no file of THÖR is there yet.
    """
    base = data_folder() if to is None else to
    folder = base / collection
    if collection == "thor":
        refuse_given(
            "on THÖR, which is fetched by hand",
            mirror=mirror != HOME,
            timeout=timeout != PATIENCE,
        )
        is_filled = folder.is_dir() and any(folder.iterdir())
        end = "\n" if is_filled else "\n\nNothing is there yet."
        print(THOR.format(folder=folder.resolve()) + end)
        return inspect.run(folder, figure=None) if is_filled else 2
    count, came = download(collection, folder, mirror, timeout)
    print(
        f"{folder}: {count} files, every SHA-256 as published, {came} of them fetched now"
    )
    if base.resolve() != data_folder().resolve():
        print(f"To have it found by name: export NEUROSYM_DATA={to}")
    return 0


def published_files(collection: str) -> dict[str, dict[str, str]]:
    """Address, bytes and SHA-256 of each file of a collection, by path below its folder."""
    content = files("neurosym_jax.data").joinpath("published.tsv").read_bytes()
    rows = pl.read_csv(content, separator="\t", infer_schema=False).iter_rows(
        named=True
    )
    return {row["path"]: row for row in rows if row["collection"] == collection}


def download(
    collection: str, folder: Path, mirror: str = HOME, timeout: float = 20.0
) -> tuple[int, int]:
    """Fetch what `folder` lacks of a collection; return the number of its files and of those.

    Files are never overwritten. `mirror` is the address of a copy of `HOME`; a
    connection is given up after `timeout` seconds without an answer.

    Raises:
        InputError: naming the file or address and what is wrong with it.
    """
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    base = mirror.rstrip("/") + "/"
    names = published_files(collection)
    into = folder if folder.exists() else folder.with_name(f"{folder.name}.part")
    fetcher = pooch.create(
        into,
        base_url=base,
        registry={name: f"sha256:{row['sha256']}" for name, row in names.items()},
        urls={name: base + row["address"] for name, row in names.items()},
        retry_if_failed=2,
    )
    receive: Any = pooch.HTTPDownloader(timeout=timeout)
    present = {name for name in names if (into / name).exists()}
    for name in present:
        if pooch.file_hash(str(into / name)) != names[name]["sha256"]:
            raise InputError(f"{into / name}: is not the published file; move it away")
    try:
        for name in tqdm(
            names.keys() - present, desc=folder.name, unit=" files", disable=None
        ):
            fetcher.fetch(name, downloader=receive)
        if into != folder:
            into.rename(folder)
    except (requests.RequestException, ValueError) as error:
        raise InputError(
            f"{base}: {printable(str(error))[:300]} (what has arrived is kept: run this again, or "
            "name another place with --mirror)"
        ) from None
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from None
    return len(names), len(names) - len(present)
