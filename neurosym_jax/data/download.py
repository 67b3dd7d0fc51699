"""Fetch published collections with pooch, checked against their pinned SHA-256.

A collection appears in its folder whole; until then it grows in `NAME.part` beside it, and the next
call fetches the files that are still missing.
"""

from pathlib import Path
from typing import Any

from tqdm import tqdm

from neurosym_jax.data.published import HOME, published_files
from neurosym_jax.errors import InputError, printable

__all__ = ["download"]

RETRIES = 2
"""Further tries of a file that did not arrive, or arrived wrong."""


def download(what: str, folder: Path, mirror: str = HOME, timeout: float = 20.0) -> tuple[int, int]:
    """Fetch the files of a collection that `folder` lacks; existing files are never overwritten.

    Args:
        what: name of the collection, see `published.COLLECTIONS`.
        folder: the collection's own.
        mirror: address of a copy of the files, with the same paths below it.
        timeout: seconds without an answer after which a connection is given up.

    Returns:
        How many files the collection has, and how many were fetched now.

    Raises:
        InputError: naming the file or address and what is wrong with it.
    """
    import pooch
    import requests

    if not 0 < timeout < float("inf"):
        raise InputError(f"--timeout must be positive, not {timeout}")
    if not mirror.startswith(("https://", "http://")):
        raise InputError(f"--mirror {mirror}: not an address of http or https")
    pooch.get_logger().setLevel("WARNING")
    base = mirror.rstrip("/") + "/"
    wanted = {file.path.as_posix(): file for file in published_files(what)}
    into = folder if folder.exists() else folder.with_name(f"{folder.name}.part")
    collection = pooch.create(
        into,
        base_url=base,
        registry={name: f"sha256:{file.sha256}" for name, file in wanted.items()},
        urls={name: base + file.address for name, file in wanted.items()},
        retry_if_failed=RETRIES,
    )
    receive: Any = pooch.HTTPDownloader(timeout=timeout)
    try:
        there = {name for name in wanted if (into / name).exists()}
        for name in there:
            if pooch.file_hash(str(into / name)) != wanted[name].sha256:
                raise InputError(f"{into / name}: is not the published file; move it away")
        for name in tqdm(wanted.keys() - there, desc=folder.name, unit=" files", disable=None):
            try:
                collection.fetch(name, downloader=receive)
            except (requests.RequestException, ValueError) as error:
                reason = printable(str(error))[:300]
                raise InputError(
                    f"{base}{wanted[name].address}: {reason} (what has arrived is kept: run this "
                    "again, or name another place with --mirror)"
                ) from None
        if into != folder:
            for path in into.rglob("*"):
                if path.is_file() and path.relative_to(into).as_posix() not in wanted:
                    path.unlink()  # A killed process leaves pooch's temporary files.
            into.rename(folder)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from None
    return len(wanted), len(wanted) - len(there)
