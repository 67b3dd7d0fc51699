"""Fetch published collections with pooch, checked against their pinned SHA-256.

A collection appears in its folder whole; until then it grows in `NAME.part` beside it, and the next
call fetches the files that are still missing.
"""

import functools
import shutil
import time
from pathlib import Path
from typing import Any

from tqdm import tqdm

from neurosym_jax.data.published import HOME, PublishedFile, published_files
from neurosym_jax.errors import InputError, printable

__all__ = ["download"]

RETRIES = 2
"""Further tries of a file that did not arrive, or arrived wrong."""

LEAST = 2000.0
"""Bytes per second; a slower server is given up, after `timeout` at the earliest."""


def download(what: str, folder: Path, mirror: str = HOME, timeout: float = 20.0) -> tuple[int, int]:
    """Fetch the files of a collection that `folder` lacks; existing files are never overwritten.

    Args:
        what: name of the collection, see `published.COLLECTIONS`.
        folder: the collection's own.
        mirror: address, or folder, of a copy of the files, with the same paths below it.
        timeout: seconds without an answer after which a connection is given up.

    Returns:
        How many files the collection has, and how many were fetched now.

    Raises:
        InputError: naming the file or address and what is wrong with it.
    """
    if not 0 < timeout < float("inf"):
        raise InputError(f"--timeout must be positive, not {timeout}")
    if not mirror.startswith(("https://", "http://")) and not Path(mirror).is_dir():
        raise InputError(f"--mirror {mirror}: neither a folder nor an address of http or https")
    wanted = published_files(what)
    try:
        return len(wanted), _fetch(folder, wanted, mirror.rstrip("/") + "/", timeout)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror or error}") from None


def _fetch(folder: Path, wanted: list[PublishedFile], mirror: str, timeout: float) -> int:
    import pooch
    import requests

    for file in wanted:
        path = folder / file.path
        if path.exists() and pooch.file_hash(str(path)) != file.sha256:
            raise InputError(f"{path}: is not the published file; move it away to fetch that")
    into = folder if folder.exists() else folder.with_name(f"{folder.name}.part")
    missing = [file for file in wanted if not (into / file.path).exists()]
    pooch.get_logger().setLevel("WARNING")
    names = {file: file.path.as_posix() for file in missing}
    collection = pooch.create(
        into,
        base_url=mirror,
        registry={name: f"sha256:{file.sha256}" for file, name in names.items()},
        urls={name: mirror + file.address for file, name in names.items()},
        retry_if_failed=RETRIES,
    )
    for file in tqdm(missing, desc=folder.name, unit=" files", disable=None):
        receive: Any = functools.partial(_receive, size=file.size, timeout=timeout)
        try:
            collection.fetch(names[file], downloader=receive)
        except (requests.RequestException, ValueError, FileNotFoundError) as error:
            reason = printable(str(error))[:300]
            raise InputError(
                f"{mirror}{file.address}: {reason} (what has arrived is kept: run this again, or "
                "name another place with --mirror)"
            ) from None
    if into != folder:
        for path in {path for path in into.rglob("*") if path.is_file()} - {
            into / file.path for file in wanted
        }:
            path.unlink()  # A killed process leaves pooch's temporary files.
        into.rename(folder)
    return len(missing)


def _receive(url: str, output: str, _: Any, size: int, timeout: float) -> None:
    """Download at most `size` bytes, or copy a file of a local mirror.

    Raises:
        ValueError: for more bytes, or a server that is too slow.
    """
    import requests

    if not url.startswith(("https://", "http://")):
        shutil.copyfile(url, output)
        return
    start, received = time.monotonic(), 0
    with requests.get(url, stream=True, timeout=timeout) as response, open(output, "wb") as file:
        response.raise_for_status()
        for chunk in response.iter_content(512):
            received += file.write(chunk)
            if received > size:
                raise ValueError(f"more than the {size} bytes that are published")
            if received < LEAST * (time.monotonic() - start - timeout):
                raise ValueError(f"less than {LEAST:g} bytes per second arrive")
